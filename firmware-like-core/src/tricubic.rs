//! Tri-cubic interpolation on the 64-point super-cell: tensor Catmull-Rom.
//!
//! Why this cubic: its slopes at a node are the central differences of the neighbours on that axis, the same whichever cell
//! asks, so the force is C1 and the hand feels no kink at a cell face. Lekien and Marsden's tri-cubic (the paper's
//! reference) with central-difference derivatives is the same polynomial; the paper does not say which derivatives it used.
//! Tensor Lagrange is a little more accurate but only C0: its slope jumps at every face.

use crate::trilinear::Planes;
use crate::vec3::{self, Vec3};

/// Catmull-Rom weights of the points -1, 0, 1, 2 at t in [0, 1]. Sum 1; reproduces quadratics.
#[inline]
pub fn weights(t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    [-0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t]
}

/// Tri-cubic estimate of the reaction force inside one grid cell, C1 across cells.
///
/// h(p) = sum_abc w_a(tx) w_b(ty) w_c(tz) h_abc,   a, b, c in -1..=2 round the cell's low corner
///
/// Shapes: `force[axis]` has one f32 per slot, z fastest; `slot` is the cell's low corner.   Units: newtons.
/// Cost: 16 rows of 4 per component, summed along z last so that the rows stay whole vectors.
/// Source: Peterlik 2010, section 4.4, Fig. 1(b). Deviation: missing points hold ghosts, so the force never jumps.
#[inline]
pub fn interpolate(force: &[&[f32]; 3], side: usize, slot: usize, t: Vec3) -> Vec3 {
    contract(force, side, slot, &t.map(weights))
}

/// Derivatives of [`weights`].
fn weight_slopes(t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    [-0.5 * s * (1.0 - 3.0 * t), t * (4.5 * t - 5.0), -s * (4.5 * s - 5.0), 0.5 * t * (1.0 - 3.0 * s)]
}

/// dh_i/dt_j as rows i.
pub fn slopes(force: &[&[f32]; 3], side: usize, slot: usize, [tx, ty, tz]: Vec3) -> [Vec3; 3] {
    let [wx, wy, wz] = [weights(tx), weights(ty), weights(tz)];
    vec3::transposed([
        contract(force, side, slot, &[weight_slopes(tx), wy, wz]),
        contract(force, side, slot, &[wx, weight_slopes(ty), wz]),
        contract(force, side, slot, &[wx, wy, weight_slopes(tz)]),
    ])
}

#[inline]
fn contract(force: &[&[f32]; 3], side: usize, slot: usize, [wx, wy, wz]: &[[f32; 4]; 3]) -> Vec3 {
    let mut rows = [[0.0; 4]; 3];
    // Past the end of the planes, which a checked table never reaches, the rows stay zero.
    let _ = contract_xy(force, side as u32, slot as u32, wx, wy, &mut rows);
    let [x, y, z] = rows;
    [dot(x, *wz), dot(y, *wz), dot(z, *wz)]
}

/// Contracts x and y; leaves four values along z per component.
///
/// Not inlined, so that the compiler sees whole rows stored and keeps each in one vector. Inlined into the last contraction it
/// packs values of different rows and components together, and shuffles more than it computes (measured: 1.6 times slower).
#[inline(never)]
fn contract_xy(
    force: &[&[f32]; 3],
    side: u32,
    slot: u32,
    wx: &[f32; 4],
    wy: &[f32; 4],
    rows: &mut [[f32; 4]; 3],
) -> Option<()> {
    let planes = Planes::new(force)?;
    let sheet = side.wrapping_mul(side);
    let mut start = slot.wrapping_sub(sheet.wrapping_add(side).wrapping_add(1));
    let [mut x, mut y, mut z] = *rows;
    for a in wx {
        let mut at = start;
        for b in wy {
            let [row_x, row_y, row_z] = planes.run(at)?;
            add_scaled(&mut x, row_x, a * b);
            add_scaled(&mut y, row_y, a * b);
            add_scaled(&mut z, row_z, a * b);
            at = at.wrapping_add(side);
        }
        start = start.wrapping_add(sheet);
    }
    *rows = [x, y, z];
    Some(())
}

#[inline]
fn add_scaled(sums: &mut [f32; 4], row: &[f32; 4], weight: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += weight * value;
    }
}

#[inline]
fn dot([s0, s1, s2, s3]: [f32; 4], [w0, w1, w2, w3]: [f32; 4]) -> f32 {
    (s0 * w0 + s1 * w1) + (s2 * w2 + s3 * w3)
}
