//! Tri-linear interpolation in one cell.

use crate::vec3::Vec3;

/// Tri-linear estimate of the reaction force inside one grid cell.
///
/// h(p) = sum_c w_c(t) h_c,   c over the cell's 8 corners
///
/// Shapes: `force[axis]` has one f32 per slot, z fastest; `slot` is the cell's low corner.   Units: newtons.
/// Cost: 8 loads per component as 4 pairs; the only branches are the never-taken ends of the plane.
/// Source: Peterlik 2010, section 4.4, Fig. 1(a). Deviation: missing corners hold ghosts, so the force never jumps.
#[inline]
pub fn interpolate(force: &[&[f32]; 3], side: usize, slot: usize, t: Vec3) -> Vec3 {
    let sheet = side.wrapping_mul(side);
    let [tx, ty, tz] = t;
    force.map(|plane| {
        let row = |offset: usize| {
            let [low, high] = pair(plane, slot.wrapping_add(offset));
            low + tz * (high - low)
        };
        let (near, far) = (row(0), row(sheet));
        let near = near + ty * (row(side) - near);
        let far = far + ty * (row(sheet.wrapping_add(side)) - far);
        near + tx * (far - near)
    })
}

/// Two neighbours along z; zeros beyond the plane, which a checked table never reaches.
#[inline]
fn pair(plane: &[f32], at: usize) -> [f32; 2] {
    plane.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or_default()
}

/// The 8 corners of a cell as (slot, weight), for tables other than the force.
#[inline]
pub fn corners(side: usize, slot: usize, t: Vec3) -> [(usize, f32); 8] {
    let sheet = side.wrapping_mul(side);
    let [tx, ty, tz] = t;
    let (sx, sy, sz) = (1.0 - tx, 1.0 - ty, 1.0 - tz);
    let far = slot.wrapping_add(sheet);
    [
        (slot, sx * sy * sz),
        (slot.wrapping_add(1), sx * sy * tz),
        (slot.wrapping_add(side), sx * ty * sz),
        (slot.wrapping_add(side).wrapping_add(1), sx * ty * tz),
        (far, tx * sy * sz),
        (far.wrapping_add(1), tx * sy * tz),
        (far.wrapping_add(side), tx * ty * sz),
        (far.wrapping_add(side).wrapping_add(1), tx * ty * tz),
    ]
}
