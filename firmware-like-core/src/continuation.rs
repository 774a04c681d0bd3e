//! How the force goes on beyond the ball: in a straight line at first, then constant. Continuous and bounded, and C1 at the rim where the
//! method itself is smooth.
//!
//! h(p) = h(q) + phi(s) S(q) u,   q = r u on the rim, u = p / |p|, s = |p| - r
//!
//! phi(s) = s - s^2 / 2c up to s = c, c / 2 beyond; c is the grid's spacing. Half a cell's worth of rise later the force stays what it is,
//! whatever a hand does out there.
//!
//! S must not jump where q crosses a face, or h would, the further out the more. So it is dh/dd of the tri-cubic force for all methods of
//! the lattice of forces, and for `energy` that of its two parts without the turn of their shares (`Space::rim_slopes`).

use crate::vec3::{self, Vec3};

/// phi.
fn rise_m(pulled_m: f32, spacing_m: f32) -> f32 {
    if pulled_m < spacing_m { pulled_m - 0.5 * pulled_m * pulled_m / spacing_m } else { 0.5 * spacing_m }
}

/// Force beyond the rim from that at the rim.
pub fn force(
    at_rim_n: Vec3,
    stiffness_n_m: &[Vec3; 3],
    outward: Vec3,
    pulled_m: f32,
    spacing_m: f32,
) -> Vec3 {
    let rise_m = rise_m(pulled_m, spacing_m);
    vec3::add(at_rim_n, vec3::scale(vec3::transform(stiffness_n_m, outward), rise_m))
}
