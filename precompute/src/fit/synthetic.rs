//! An energy in closed form, for tests.

use nalgebra::Matrix3;

use crate::num::jet::{EnergyJet, THIRD_INDICES};
use crate::num::sequence::in_ball;

/// The jet at `p` of W = p.D p / 2 + c (exp(g.p) - 1 - g.p), an anisotropic energy with increasing stiffness.
pub(crate) fn jet(p: [f64; 3]) -> EnergyJet {
    let (d, g, c) = ([200.0, 150.0, 300.0], [20.0, -12.0, 16.0], 0.02);
    let along: f64 = (0..3).map(|i| g[i] * p[i]).sum();
    let e = c * along.exp();
    let third = std::array::from_fn(|n| THIRD_INDICES[n].iter().map(|&i| g[i]).product::<f64>() * e);
    EnergyJet {
        control_m: p,
        energy_j: (0..3).map(|i| 0.5 * d[i] * p[i] * p[i]).sum::<f64>() + e - c - c * along,
        force_n: std::array::from_fn(|i| d[i] * p[i] + (e - c) * g[i]),
        stiffness_n_m: Matrix3::from_fn(|i, j| e * g[i] * g[j] + if i == j { d[i] } else { 0.0 }),
        third_n_m2: third,
    }
}

/// Point `n` of an even distribution in a ball of `radius_m`.
pub(crate) fn spread(n: u32, radius_m: f64) -> [f64; 3] {
    in_ball(n + 1, 0.0, radius_m)
}
