//! Tri-linear interpolation in one cell.

use crate::vec3::{self, Vec3};

/// Tri-linear estimate of the reaction force inside one grid cell.
///
/// h(p) = sum_c w_c(t) h_c,   c over the cell's 8 corners
///
/// Shapes: `force[axis]` has one f32 per slot, z fastest; `slot` is the cell's low corner.   Units: newtons.
/// Cost: 8 loads per component as 4 pairs; the only branches are the never-taken ends of the plane.
/// Source: Peterlik 2010, section 4.4, Fig. 1(a). Deviation: missing corners hold ghosts, so the force never jumps.
#[inline]
pub fn interpolate(force: &[&[f32]; 3], side: usize, slot: usize, t: Vec3) -> Vec3 {
    checked(force, side as u32, slot as u32, t).unwrap_or(vec3::ZERO)
}

/// `None` past the end of the planes, which a checked table never reaches.
#[inline]
fn checked(force: &[&[f32]; 3], side: u32, slot: u32, [tx, ty, tz]: Vec3) -> Option<Vec3> {
    let planes = Planes::new(force)?;
    let row = |offset: u32| {
        let [[x0, x1], [y0, y1], [z0, z1]] = planes.run(slot.wrapping_add(offset))?;
        Some([x0 + tz * (x1 - x0), y0 + tz * (y1 - y0), z0 + tz * (z1 - z0)])
    };
    let sheet = side.wrapping_mul(side);
    let near = lerp(row(0)?, row(side)?, ty);
    let far = lerp(row(sheet)?, row(sheet.wrapping_add(side))?, ty);
    Some(lerp(near, far, tx))
}

/// dh_i/dt_j as rows i.
pub fn slopes(force: &[&[f32]; 3], side: usize, slot: usize, [tx, ty, tz]: Vec3) -> [Vec3; 3] {
    // Linear along each axis: the slope is the difference of the two ends.
    let rise = |axis: fn(f32, Vec3) -> Vec3| {
        let [low, high] = [0.0, 1.0].map(|end| interpolate(force, side, slot, axis(end, [tx, ty, tz])));
        vec3::sub(high, low)
    };
    let columns =
        [rise(|t, [_, y, z]| [t, y, z]), rise(|t, [x, _, z]| [x, t, z]), rise(|t, [x, y, _]| [x, y, t])];
    vec3::transposed(columns)
}

#[inline]
fn lerp([ax, ay, az]: Vec3, [bx, by, bz]: Vec3, t: f32) -> Vec3 {
    [ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az)]
}

/// Three planes known to be equally long, so that one bounds check serves all three.
pub(crate) struct Planes<'a> {
    x: &'a [f32],
    y: &'a [f32],
    z: &'a [f32],
}

impl<'a> Planes<'a> {
    #[inline]
    pub(crate) fn new(&[x, y, z]: &[&'a [f32]; 3]) -> Option<Self> {
        Some(Self { x, y: y.get(..x.len())?, z: z.get(..x.len())? })
    }

    /// N neighbours along z from a slot on. A u32 slot cannot overflow in the addition, which halves the check.
    #[inline]
    pub(crate) fn run<const N: usize>(&self, at: u32) -> Option<[&'a [f32; N]; 3]> {
        let at = at as usize;
        let range = at..at.saturating_add(N);
        Some([
            self.x.get(range.clone())?.first_chunk()?,
            self.y.get(range.clone())?.first_chunk()?,
            self.z.get(range)?.first_chunk()?,
        ])
    }
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
