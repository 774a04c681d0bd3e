//! How stiff an organ may feel: what a device renders stably, and the one factor that keeps an organ below it.
//!
//! A sampled device cannot render any stiffness. With its own damping b, virtual damping B and a cycle T it is passive for
//!
//! K < 2 (b - |B|) / T                     (Colgate and Schenkel 1997)
//!
//! and, more weakly, stable with a delay d of the loop for K < (b + B) / (T / 2 + d). K is what the hand feels: a workspace that makes the
//! model s times as large makes it s times as stiff.
//!
//! Where an organ is stiffer than that, every force for the hand is scaled by one factor below 1, the same for all its spaces: nothing
//! jumps at a hand-over, a conservative force stays one, and the organ feels softer as a whole, which the caller is told.

use crate::flags::{SMOOTH, SOLVED};
use crate::math;
use crate::method::Method;
use crate::table::Space;
use crate::vec3::{Vec3, ZERO, norm};

/// Largest stiffness at which a device is passive, N/m: 2 (b - |B|) / T. Not positive where B is larger than b.
pub fn passive_n_m(damping_ns_m: f32, virtual_damping_ns_m: f32, cycle_s: f32) -> f32 {
    2.0 * (damping_ns_m - virtual_damping_ns_m.abs()) / cycle_s
}

/// Largest stiffness at which a device with a delay is stable, N/m: (b + B) / (T / 2 + d).
pub fn stable_n_m(damping_ns_m: f32, virtual_damping_ns_m: f32, cycle_s: f32, delay_s: f32) -> f32 {
    (damping_ns_m + virtual_damping_ns_m) / (0.5 * cycle_s + delay_s)
}

/// Bands of force that are looked at, at most: each is stiffer than the one before, or the last.
const MOST_BANDS: usize = 16;

/// Grid points that radial basis functions are asked at, at most: each of them costs a pass over all centres.
const RADIAL_POINTS: usize = 2_000;

/// Largest stiffness of a space by a method, N/m: the largest singular value of dh/dd over the solved grid points away from folds with
/// `above_n` < |h| <= `to_n`. 0 if there is none, or the method is not in the blob.
///
/// At folds the body jumps: no stiffness says how that feels, and the slew limit stands there. For start-up, not for the tick.
pub fn stiffest_n_m(space: &Space<'_>, method: Method, (above_n, to_n): (f32, f32)) -> f32 {
    let radial = matches!(method, Method::RbfLinear | Method::RbfCubic);
    let stride = if radial { space.flags.len().div_ceil(RADIAL_POINTS).max(1) } else { 1 };
    let counts = |bits: u8| bits & (SOLVED | SMOOTH) == SOLVED | SMOOTH;
    let points = space.flags.iter().enumerate().filter(|(_, bits)| counts(**bits)).step_by(stride);
    let stiffness = |(slot, _): (usize, &u8)| {
        let displacement_m = space.lattice.displacement_m(space.lattice.ijk(slot));
        let within = |h: Vec3| (above_n..=to_n).contains(&norm(h)) && norm(h) != above_n;
        // The force first: it costs a fraction of its slopes.
        let force_n = space.force(method, displacement_m).map_or(ZERO, |answer| answer.force_n);
        let found = if within(force_n) { space.estimate(method, displacement_m) } else { None };
        found.map_or(0.0, |found| largest_singular_value(&found.stiffness_n_m))
    };
    points.map(stiffness).fold(0.0, f32::max)
}

/// Largest stiffness that a hand reaches, N/m, and the share that every force is to be scaled by so that it is felt as `cap_n_m` at most.
///
/// A force that is scaled down lets the hand go deeper before the largest force stops it, to |h| = limit / share, where tissue is
/// stiffer still. So the band that this opens is looked at too, until it opens no more.
pub fn share(spaces: &[Space<'_>], method: Method, cap_n_m: f32, limit_n: f32) -> (f32, f32) {
    let (mut stiffest_n_m, mut share) = (0.0_f32, 1.0_f32);
    let mut band_n = (-1.0_f32, limit_n);
    for _ in 0..MOST_BANDS {
        let within = |space| self::stiffest_n_m(space, method, band_n);
        stiffest_n_m = spaces.iter().map(within).fold(stiffest_n_m, f32::max);
        // Infinite is far too stiff, and no organ that moves.
        share = if stiffest_n_m > cap_n_m { cap_n_m / stiffest_n_m } else { 1.0 };
        let reached_n = if share > 0.0 { limit_n / share } else { f32::MAX };
        if reached_n <= band_n.1 {
            break;
        }
        band_n = (band_n.1, reached_n);
    }
    (stiffest_n_m, share)
}

/// From above, by less than 1 %: trace(M^128)^(1/128) with M = A^T A, whose root is the singular value.
///
/// Squaring seven times needs neither a bound on iterations nor trigonometry.
pub fn largest_singular_value(a: &[Vec3; 3]) -> f32 {
    let column = |j: usize| a.map(|row| row.get(j).copied().unwrap_or(0.0));
    let columns = [column(0), column(1), column(2)];
    let scale = a.as_flattened().iter().fold(0.0_f32, |most, x| most.max(x.abs()));
    if scale <= 0.0 || !scale.is_finite() {
        return scale;
    }
    let unit = columns.map(|column| column.map(|x| x / scale));
    let mut m = product(&unit, &unit);
    // log of the trace taken out so far, as a product of roots.
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

/// Rows of a times rows of b: a b^T, which is a b for what is symmetric.
fn product(a: &[Vec3; 3], b: &[Vec3; 3]) -> [Vec3; 3] {
    a.map(|row| b.map(|other| crate::vec3::dot(row, other)))
}

fn trace(m: &[Vec3; 3]) -> f32 {
    let [[xx, ..], [_, yy, _], [.., zz]] = *m;
    xx + yy + zz
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn singular_values_are_met_from_above() {
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

    #[test]
    fn limits_of_colgate_and_schenkel() {
        // At 1 kHz K < 2000 N/m per N s/m.
        assert!((passive_n_m(1.0, 0.0, 1e-3) - 2000.0).abs() < 1e-2);
        assert!(
            (passive_n_m(1.0, -0.5, 1e-3) - 1000.0).abs() < 1e-2,
            "virtual damping costs, whatever its sign"
        );
        assert!((stable_n_m(1.0, 0.5, 1e-3, 1e-3) - 1000.0).abs() < 1e-2);
    }
}
