//! Tri-cubic interpolation on the 64-point super-cell: tensor Catmull-Rom.
//!
//! Why this cubic: its slopes at a node are the central differences of the neighbours on that axis, the same whichever cell
//! asks, so the force is C1 and the hand feels no kink at a cell face. Lekien and Marsden's tri-cubic (the paper's
//! reference) with central-difference derivatives is the same polynomial; the paper does not say which derivatives it used.
//! Tensor Lagrange is a little more accurate but only C0: its slope jumps at every face.

use crate::vec3::Vec3;

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
    let sheet = side.wrapping_mul(side);
    let first = slot.wrapping_sub(sheet.wrapping_add(side).wrapping_add(1));
    let [wx, wy, wz] = t.map(weights);
    force.map(|plane| {
        let mut sums = [0.0_f32; 4];
        let mut start = first;
        for a in wx {
            let mut at = start;
            for b in wy {
                let weight = a * b;
                let row: [f32; 4] =
                    plane.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or_default();
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += weight * value;
                }
                at = at.wrapping_add(side);
            }
            start = start.wrapping_add(sheet);
        }
        let [s0, s1, s2, s3] = sums;
        let [w0, w1, w2, w3] = wz;
        (s0 * w0 + s1 * w1) + (s2 * w2 + s3 * w3)
    })
}
