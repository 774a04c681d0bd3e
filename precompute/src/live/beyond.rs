//! How the loop continues the expansion of a jet beyond its trust radius.

use crate::num::jet::EnergyJet;
use crate::num::vector::{distance, dot};

/// Smallest distance over which the force levels off beyond it, m.
pub(super) const MIN_LEVELLING_M: f64 = 5e-3;

/// The share of its force that a root has at this distance from its control, m.
pub(super) fn nearness(radius_m: f64, away_m: f64) -> f64 {
    (1.5 - 0.5 * (away_m - radius_m) / radius_m.max(MIN_LEVELLING_M)).clamp(0.0, 1.0)
}

/// Value and gradient of the expansion of a root; beyond the trust radius straight on.
pub(super) fn straight_on(root: &EnergyJet, radius_m: f64, control_m: [f64; 3]) -> (f64, [f64; 3]) {
    let away_m = distance(control_m, root.control_m);
    let share = (radius_m / away_m.max(f64::MIN_POSITIVE)).min(1.0);
    let way: [f64; 3] = std::array::from_fn(|k| control_m[k] - root.control_m[k]);
    let rim_m = std::array::from_fn(|k| root.control_m[k] + share * way[k]);
    let slope = root.taylor_force_n(rim_m);
    (root.taylor_value(rim_m) + (1.0 - share) * dot(slope, way), slope)
}

/// Value and gradient of an expansion; beyond the trust radius straight on and levelling off.
pub(super) fn continued(jet: &EnergyJet, radius_m: f64, control_m: [f64; 3]) -> (f64, [f64; 3]) {
    let away_m = distance(control_m, jet.control_m);
    if away_m <= radius_m {
        return (jet.taylor_value(control_m), jet.taylor_force_n(control_m));
    }
    let outward: [f64; 3] = std::array::from_fn(|k| (control_m[k] - jet.control_m[k]) / away_m);
    let at = |r_m: f64| -> [f64; 3] { std::array::from_fn(|k| jet.control_m[k] + r_m * outward[k]) };
    let [start_n, rim_n, twice_n] = [0.0, radius_m, 2.0 * radius_m].map(|r_m| jet.taylor_force_n(at(r_m)));
    // The gradient is of second order along the ray, so this difference is its derivative at the rim.
    let slope_n_m: [f64; 3] = std::array::from_fn(|k| (twice_n[k] - start_n[k]) / (2.0 * radius_m));
    let (length_m, beyond_m) = (radius_m.max(MIN_LEVELLING_M), away_m - radius_m);
    let bent_m = beyond_m.min(length_m);
    let levelled_m = bent_m - 0.5 * bent_m * bent_m / length_m;
    let risen_m2 =
        0.5 * bent_m * bent_m * (1.0 - bent_m / (3.0 * length_m)) + 0.5 * length_m * (beyond_m - bent_m);
    let value = jet.taylor_value(at(radius_m)) + dot(rim_n, outward) * beyond_m;
    let gradient = std::array::from_fn(|k| rim_n[k] + levelled_m * slope_n_m[k]);
    (value + dot(slope_n_m, outward) * risen_m2, gradient)
}
/// Distance of two second controls, m. That of one from none is larger than any other.
pub(super) fn parted_m(one: Option<[f64; 3]>, other: Option<[f64; 3]>) -> f64 {
    match (one, other) {
        (None, None) => 0.0,
        (Some(one), Some(other)) => distance(one, other),
        _ => f64::from(palpate_core::Jet::PARTED_M),
    }
}
