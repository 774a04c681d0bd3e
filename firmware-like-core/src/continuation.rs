//! How the force goes on beyond the ball: in a straight line at first, then constant. C1, bounded.
//!
//! h(p) = h(q) + phi(s) S(q) u,   q = r u on the rim, u = p / |p|, s = |p| - r
//!
//! phi(s) = s - s^2 / 2c up to s = c, c / 2 beyond; c is the grid's spacing. At the rim the value and all slopes are those of the
//! inside (phi = 0, phi' = 1); half a cell's worth of rise later the force stays what it is, whatever a hand does out there.

use crate::vec3::{self, Vec3};

/// phi and its derivative.
fn course(pulled_m: f32, spacing_m: f32) -> (f32, f32) {
    if pulled_m < spacing_m {
        (pulled_m - 0.5 * pulled_m * pulled_m / spacing_m, 1.0 - pulled_m / spacing_m)
    } else {
        (0.5 * spacing_m, 0.0)
    }
}

/// Force beyond the rim from that at the rim.
pub fn force(
    at_rim_n: Vec3,
    stiffness_n_m: &[Vec3; 3],
    outward: Vec3,
    pulled_m: f32,
    spacing_m: f32,
) -> Vec3 {
    let (rise_m, _) = course(pulled_m, spacing_m);
    vec3::add(at_rim_n, vec3::scale(vec3::transform(stiffness_n_m, outward), rise_m))
}

/// Stiffness beyond the rim from that at the rim, but for the change of S along the rim:
/// S [phi' u u^T + (r + phi) / (r + s) (I - u u^T)].
pub fn stiffness(
    at_rim_n_m: &[Vec3; 3],
    outward: Vec3,
    pulled_m: f32,
    spacing_m: f32,
    radius_m: f32,
) -> [Vec3; 3] {
    let (rise_m, slope) = course(pulled_m, spacing_m);
    let across = (radius_m + rise_m) / (radius_m + pulled_m);
    at_rim_n_m.map(|row| {
        let along = vec3::dot(row, outward);
        vec3::add(vec3::scale(row, across), vec3::scale(outward, along * (slope - across)))
    })
}
