//! Tri-linear interpolation in one cell.

use crate::grid::Strides;
use crate::lanes::F32x4;
use crate::vec3::{self, Vec3};

/// Tri-linear estimate of the reaction force inside one grid cell.
///
/// h(p) = sum_c w_c(t) h_c,   c over the cell's 8 corners
///
/// Shapes: one force per slot, z fastest; `slot` is the cell's low corner.   Units: newtons.
/// Cost: 8 loads of three components each, 7 steps (1 - t) a + t b, one check of the table's end.
/// Source: Peterlik 2010, section 4.4, Fig. 1(a). Deviation: missing corners hold ghosts, so the force never jumps.
#[inline(always)]
pub fn interpolate(force: &[Vec3], strides: Strides, slot: usize, t: Vec3) -> Vec3 {
    checked(force, strides, slot as u32, t).unwrap_or(vec3::ZERO)
}

/// `None` past the end of the table, which a checked table never reaches.
#[inline(always)]
fn checked(force: &[Vec3], strides: Strides, slot: u32, t: Vec3) -> Option<Vec3> {
    // From the far end: once that is in the table, so are the others, and the compiler sees it.
    let (slot, side, sheet) = (slot as usize, strides.side as usize, strides.sheet as usize);
    let d = edge(force, slot.wrapping_add(sheet).wrapping_add(side))?;
    let c = edge(force, slot.wrapping_add(sheet))?;
    let b = edge(force, slot.wrapping_add(side))?;
    let a = edge(force, slot)?;
    let [tx, ty, tz] = t;
    let t = F32x4::new([tx, ty, tz, tz]);
    let s = F32x4::splat(1.0) - t;
    let (x, y, z) = (
        (s.spread::<0>(), t.spread::<0>()),
        (s.spread::<1>(), t.spread::<1>()),
        (s.spread::<2>(), t.spread::<2>()),
    );
    let near = mix([mix(a, z), mix(b, z)], y);
    let far = mix([mix(c, z), mix(d, z)], y);
    let h = mix([near, far], x);
    Some([h.get::<0>(), h.get::<1>(), h.get::<2>()])
}

/// N neighbours along z from a slot on. A u32 slot cannot overflow in the addition, which halves the check.
#[inline(always)]
pub(crate) fn run<const N: usize>(force: &[Vec3], at: usize) -> Option<&[Vec3; N]> {
    force.get(at..at.saturating_add(N))?.first_chunk()
}

/// dh_i/dt_j as rows i.
pub fn slopes(force: &[Vec3], strides: Strides, slot: usize, [tx, ty, tz]: Vec3) -> [Vec3; 3] {
    // Linear along each axis: the slope is the difference of the two ends.
    let rise = |axis: fn(f32, Vec3) -> Vec3| {
        let [low, high] = [0.0, 1.0].map(|end| interpolate(force, strides, slot, axis(end, [tx, ty, tz])));
        vec3::sub(high, low)
    };
    let columns =
        [rise(|t, [_, y, z]| [t, y, z]), rise(|t, [x, _, z]| [x, t, z]), rise(|t, [x, y, _]| [x, y, t])];
    vec3::transposed(columns)
}

/// The two ends of an edge along z. The fourth lane holds what comes next, and is thrown away.
#[inline(always)]
fn edge(force: &[Vec3], at: usize) -> Option<[F32x4; 2]> {
    let values = run::<3>(force, at)?.as_flattened();
    Some([F32x4::load(values.first_chunk()?), F32x4::load(values.get(3..)?.first_chunk()?)])
}

/// (1 - t) a + t b
#[inline(always)]
fn mix([a, b]: [F32x4; 2], (s, t): (F32x4, F32x4)) -> F32x4 {
    s * a + t * b
}

/// The 8 corners of a cell as (slot, weight), for tables other than the force.
pub fn corners(strides: Strides, slot: usize, t: Vec3) -> [(usize, f32); 8] {
    let (side, sheet) = (strides.side as usize, strides.sheet as usize);
    let [a, b, c, d, e, f, g, h] = corner_weights(t);
    let far = slot.wrapping_add(sheet);
    [
        (slot, a),
        (slot.wrapping_add(1), b),
        (slot.wrapping_add(side), c),
        (slot.wrapping_add(side).wrapping_add(1), d),
        (far, e),
        (far.wrapping_add(1), f),
        (far.wrapping_add(side), g),
        (far.wrapping_add(side).wrapping_add(1), h),
    ]
}

/// Tri-linear weights of the corners, z fastest.
#[inline(always)]
pub fn corner_weights([tx, ty, tz]: Vec3) -> [f32; 8] {
    let (sx, sy, sz) = (1.0 - tx, 1.0 - ty, 1.0 - tz);
    [
        sx * sy * sz,
        sx * sy * tz,
        sx * ty * sz,
        sx * ty * tz,
        tx * sy * sz,
        tx * sy * tz,
        tx * ty * sz,
        tx * ty * tz,
    ]
}
