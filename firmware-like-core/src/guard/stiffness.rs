//! The factor that keeps the stiffness of an organ below the largest that the device can render.
//!
//! A sampled device can render only a limited stiffness (Colgate and Schenkel 1997). The forces of a stiffer
//! organ are multiplied by one factor below 1, the same for all its spaces. Thus the force does not jump from
//! space to space, a conservative force remains conservative, and the whole organ feels softer.

use crate::grid::flags::{SMOOTH, SOLVED};
use crate::method::Method;
use crate::num::math;
use crate::num::vec3::{Vec3, ZERO, dot, norm, transposed};
use crate::space::Space;

/// Largest number of bands of force examined; the stiffness increases from each band to the next, or the
/// search ends.
const MAX_BANDS: usize = 16;

/// Largest number of grid points at which radial basis functions are evaluated: each costs a pass over all
/// centres.
const RADIAL_POINTS: usize = 2_000;

/// Largest stiffness of a space by a method, N/m: the largest singular value of dh/dd over the solved grid
/// points away from folds with `above_n` < |h| <= `to_n`. 0 if there is none, or if the planes of the method
/// are absent.
///
/// At a fold the force jumps, which a stiffness does not describe; there the slew limit applies. For
/// start-up, not for the tick.
fn stiffest_n_m(space: &Space<'_>, method: Method, (above_n, to_n): (f32, f32)) -> f32 {
    let radial = matches!(method, Method::RbfLinear | Method::RbfCubic);
    let (lattice, flags) = (space.lattice(), space.planes().flags);
    let stride = if radial { flags.len().div_ceil(RADIAL_POINTS).max(1) } else { 1 };
    let counts = |bits: u8| bits & (SOLVED | SMOOTH) == SOLVED | SMOOTH;
    let points = flags.iter().enumerate().filter(|(_, bits)| counts(**bits)).step_by(stride);
    let stiffness = |(slot, _): (usize, &u8)| {
        let displacement_m = lattice.displacement_m(lattice.ijk(slot));
        let within = |h: Vec3| (above_n..=to_n).contains(&norm(h)) && norm(h) != above_n;
        // The force is evaluated first, because it costs a fraction of its derivatives.
        let force_n = space.force(method, displacement_m).map_or(ZERO, |answer| answer.force_n);
        let found = if within(force_n) { space.estimate(method, displacement_m) } else { None };
        found.map_or(0.0, |found| largest_singular_value(&found.stiffness_n_m))
    };
    points.map(stiffness).fold(0.0, f32::max)
}

/// Largest stiffness that a hand reaches, N/m, and the factor of all forces that keeps it at `cap_n_m` for
/// the hand.
///
/// With a smaller factor the hand gets deeper before the largest force stops it, at |h| = limit / factor,
/// where tissue is stiffer. Therefore the additional band of forces is examined too, until none is added.
pub(crate) fn hand_scale(spaces: &[Space<'_>], method: Method, cap_n_m: f32, limit_n: f32) -> (f32, f32) {
    let (mut stiffest_n_m, mut scale) = (0.0_f32, 1.0_f32);
    let mut band_n = (-1.0_f32, limit_n);
    for _ in 0..MAX_BANDS {
        let within = |space| self::stiffest_n_m(space, method, band_n);
        stiffest_n_m = spaces.iter().map(within).fold(stiffest_n_m, f32::max);
        // An infinite stiffness gives the factor 0.
        scale = if stiffest_n_m > cap_n_m { cap_n_m / stiffest_n_m } else { 1.0 };
        let reached_n = if scale > 0.0 { limit_n / scale } else { f32::INFINITY };
        if reached_n <= band_n.1 {
            break;
        }
        band_n = (band_n.1, reached_n);
    }
    (stiffest_n_m, scale)
}

/// Upper bound of the largest singular value of a matrix, given by its rows, tight to 1 %.
///
/// sigma^2 <= trace(M^128)^(1/128),   M = A^T A
///
/// Seven squarings need neither an iteration limit nor trigonometry.
fn largest_singular_value(a: &[Vec3; 3]) -> f32 {
    let scale = a.as_flattened().iter().fold(0.0_f32, |most, x| most.max(x.abs()));
    if scale <= 0.0 || !scale.is_finite() {
        return scale;
    }
    let unit = transposed(*a).map(|column| column.map(|x| x / scale));
    let mut m = product(&unit, &unit);
    // The factor taken out so far, as a product of roots of traces.
    let mut found = 1.0_f32;
    for squaring in 0..8 {
        let trace = trace(&m);
        let mut root = trace;
        for _ in 0..squaring {
            root = math::sqrt(root);
        }
        found *= root;
        let shrunk = m.map(|row| row.map(|x| x / trace));
        m = product(&shrunk, &shrunk);
    }
    scale * math::sqrt(found)
}

/// a b^T from the rows of both; equal to a b for a symmetric b.
fn product(a: &[Vec3; 3], b: &[Vec3; 3]) -> [Vec3; 3] {
    a.map(|row| b.map(|other| dot(row, other)))
}

fn trace(m: &[Vec3; 3]) -> f32 {
    let [[xx, ..], [_, yy, _], [.., zz]] = *m;
    xx + yy + zz
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn singular_values_are_bounded_from_above() {
        let diagonal = [[3.0, 0.0, 0.0], [0.0, -250.0, 0.0], [0.0, 0.0, 40.0]];
        let rank_one = [[2.0, 4.0, 4.0], [1.0, 2.0, 2.0], [2.0, 4.0, 4.0]];
        let shear = [[0.0, 700.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let same = [[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]];
        for (a, want) in
            [(diagonal, 250.0), (rank_one, 9.0), (shear, 700.0), (same, 1e-3), ([[0.0; 3]; 3], 0.0)]
        {
            let found = largest_singular_value(&a);
            assert!(found >= want * (1.0 - 1e-5) && found <= want * 1.01, "{found} for {want}");
        }
    }
}
