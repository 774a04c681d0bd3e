//! Test whether two solutions lie on one smooth branch of the condensed potential.
//!
//! The edge d leads from a to b, with W, h = dW/dd and S = dh/dd given at both ends. The residuals of the
//! quintic Hermite interpolation of W and of the cubic one of h are
//!
//! rho   = |W_b - W_a - (h_a + h_b).d/2 + d.(S_b - S_a).d/12| / |d|,
//!
//! rho_h = |h_b - h_a - (S_a + S_b) d/2|.
//!
//! Both are of higher order in |d| on a smooth branch. At a fold, a branch jump or a wrong solution they are
//! of the order of the jump. rho does not detect a jump of h at mid-edge, where the jump's energy cancels;
//! rho_h detects it. The paper has no counterpart.
//!
//! If the third derivatives T are given too, both residuals gain one order. They then distinguish curvature
//! from jumps on cells as large as those of the table:
//!
//! rho   = |W_b - W_a - (h_a + h_b).d/2 + d.(S_b - S_a).d/10 - (T_a + T_b)[d, d, d]/120| / |d|,
//!
//! rho_h = |h_b - h_a - (S_a + S_b) d/2 + (T_b - T_a)[d, d]/12|.

use nalgebra::Vector3;

use super::jet::{EnergyJet, SymmetricThird, THIRD_INDICES};

/// Lower bound of the limit max(`MIN_N`, `SHARE` |h|), N.
const MIN_N: f64 = 0.1;
/// Limit as a share of the larger |h|. A jump below the just noticeable difference of force (about 7 %) is
/// hardly perceptible.
const SHARE: f64 = 0.1;

/// Residuals of two solutions against one smooth branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Excess {
    /// Residual rho of the energy, divided by the length of the edge, N.
    pub(crate) rho_n: f64,
    /// Residual rho_h of the force, N.
    pub(crate) rho_h_n: f64,
    /// A residual above this limit is a jump, N.
    limit_n: f64,
}

impl Excess {
    /// Residuals of two solutions at different controls, without third derivatives.
    pub(crate) fn between(a: &EnergyJet, b: &EnergyJet) -> Self {
        let d = Vector3::from(b.control_m) - Vector3::from(a.control_m);
        let bend = d.dot(&((b.stiffness_n_m - a.stiffness_n_m) * d));
        Self::of(a, b, bend / 12.0, Vector3::zeros())
    }

    /// Residuals with the third derivatives of both solutions, one order finer.
    pub(crate) fn with_thirds(a: &EnergyJet, b: &EnergyJet) -> Self {
        let d = Vector3::from(b.control_m) - Vector3::from(a.control_m);
        let (ta, tb) = (twice_along(&a.third_n_m2, d), twice_along(&b.third_n_m2, d));
        let bend = d.dot(&((b.stiffness_n_m - a.stiffness_n_m) * d));
        Self::of(a, b, bend / 10.0 - (ta + tb).dot(&d) / 120.0, (tb - ta) / 12.0)
    }

    /// Residuals with these terms of the second and third derivatives in rho and rho_h.
    fn of(a: &EnergyJet, b: &EnergyJet, in_energy: f64, in_force: Vector3<f64>) -> Self {
        let d = Vector3::from(b.control_m) - Vector3::from(a.control_m);
        let (ha, hb) = (Vector3::from(a.force_n), Vector3::from(b.force_n));
        Self {
            rho_n: (b.energy_j - a.energy_j - 0.5 * (ha + hb).dot(&d) + in_energy).abs() / d.norm(),
            rho_h_n: (hb - ha - (a.stiffness_n_m + b.stiffness_n_m) * d * 0.5 + in_force).norm(),
            limit_n: MIN_N.max(SHARE * ha.norm().max(hb.norm())),
        }
    }

    /// Whether a residual exceeds the limit or is NaN.
    pub(crate) fn is_jump(&self) -> bool {
        self.exceeds(self.limit_n)
    }

    /// Whether a residual exceeds this limit or is NaN.
    pub(crate) fn exceeds(&self, limit_n: f64) -> bool {
        // The negated comparison is also true for NaN.
        !(self.rho_n <= limit_n && self.rho_h_n <= limit_n)
    }
}

/// T[d, d, .]
fn twice_along(third: &SymmetricThird, d: Vector3<f64>) -> Vector3<f64> {
    let mut sum = Vector3::zeros();
    for (triple, value) in THIRD_INDICES.iter().zip(third) {
        let [i, j, k] = *triple;
        // Each distinct permutation of the triple counts once.
        let mut orders = [[i, j, k], [i, k, j], [j, i, k], [j, k, i], [k, i, j], [k, j, i]];
        orders.sort_unstable();
        for (n, [p, q, r]) in orders.iter().enumerate() {
            if n == 0 || orders[n - 1] != orders[n] {
                sum[*p] += value * d[*q] * d[*r];
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    /// W = c cosh(u . x) and its derivatives.
    fn steep(x: Vector3<f64>) -> EnergyJet {
        let (u, c) = (Vector3::new(40.0, -25.0, 30.0), 0.03);
        let (cosh, sinh) = (u.dot(&x).cosh(), u.dot(&x).sinh());
        EnergyJet {
            control_m: x.into(),
            energy_j: c * cosh,
            force_n: (u * c * sinh).into(),
            stiffness_n_m: u * u.transpose() * (c * cosh),
            third_n_m2: THIRD_INDICES.map(|[i, j, k]| c * sinh * u[i] * u[j] * u[k]),
        }
    }

    #[test]
    fn thirds_tell_a_curved_branch_from_a_jump() {
        let (a, b) = (steep(Vector3::new(0.02, -0.01, 0.01)), steep(Vector3::new(0.04, -0.01, 0.03)));
        let rough = Excess::between(&a, &b);
        let fine = Excess::with_thirds(&a, &b);
        assert!(fine.rho_h_n < 0.05 * rough.rho_h_n && fine.rho_n < 0.1 * rough.rho_n, "{rough:?} {fine:?}");
        let mut beyond = b;
        beyond.force_n[1] += 2.0;
        let jump = Excess::with_thirds(&a, &beyond);
        assert!((jump.rho_h_n - 2.0).abs() < fine.rho_h_n + 1e-9, "{jump:?}");
        assert!(rough.is_jump() && !fine.is_jump() && jump.is_jump(), "{rough:?} {fine:?}");
    }

    /// Half the edge divides the force residual by 2^5 and the energy residual (per length) by 2^6.
    #[test]
    fn thirds_take_the_order_up() {
        let at = |d: f64| {
            let step = Vector3::new(0.6, -0.3, 0.5) * d;
            let middle = Vector3::new(0.01, -0.02, 0.015);
            let (a, b) = (steep(middle - step), steep(middle + step));
            Excess::with_thirds(&a, &b)
        };
        let (long, short) = (at(0.01), at(0.005));
        let orders = [long.rho_h_n / short.rho_h_n, long.rho_n / short.rho_n].map(f64::log2);
        assert!((orders[0] - 5.0).abs() < 0.2 && (orders[1] - 6.0).abs() < 0.3, "{orders:?}");
    }

    /// W = k d^2/2 + c d^4/4 along x, with a force jump of `jump` N beyond `at_m`.
    fn sample(x: f64, at_m: f64, jump: f64) -> EnergyJet {
        let (k, c) = (300.0, 4e4);
        let beyond = (x - at_m).max(0.0);
        let here = if x > at_m { jump } else { 0.0 };
        EnergyJet {
            control_m: [x, 0.0, 0.0],
            energy_j: 0.5 * k * x * x + 0.25 * c * x.powi(4) + jump * beyond,
            force_n: [k * x + c * x.powi(3) + here, 0.0, 0.0],
            stiffness_n_m: Matrix3::from_diagonal(&Vector3::new(k + 3.0 * c * x * x, 0.0, 0.0)),
            third_n_m2: [0.0; 10],
        }
    }

    #[test]
    fn a_smooth_branch_is_none_and_a_jump_anywhere_on_the_edge_is() {
        for i in 0..=20 {
            let at_m = 0.01 + 0.0005 * f64::from(i);
            let smooth = Excess::between(&sample(0.01, at_m, 0.0), &sample(0.02, at_m, 0.0));
            assert!(!smooth.is_jump() && smooth.rho_n < 1e-12, "{smooth:?}");
            let jump = Excess::between(&sample(0.01, at_m, 1.2), &sample(0.0201, at_m, 1.2));
            assert!(jump.is_jump(), "at {at_m}: {jump:?}");
        }
    }

    #[test]
    fn a_jump_at_mid_edge_is_seen_by_the_force_alone() {
        let mid = Excess::between(&sample(0.01, 0.015, 1.2), &sample(0.02, 0.015, 1.2));
        assert!(mid.rho_n < 1e-9 && mid.rho_h_n > 1.1, "{mid:?}");
    }

    #[test]
    fn the_threshold_scales_with_the_force_and_nan_is_a_jump() {
        let scaled = |factor: f64| {
            let mut both = [sample(0.01, 0.015, 0.8), sample(0.02, 0.015, 0.8)];
            for p in &mut both {
                p.force_n[1] += factor;
            }
            Excess::between(&both[0], &both[1]).is_jump()
        };
        assert!(scaled(0.0) && !scaled(6.0), "0.8 N is a jump at 7 N and not at 9 N");
        let broken = EnergyJet { energy_j: f64::NAN, ..sample(0.02, 1.0, 0.0) };
        assert!(Excess::between(&sample(0.01, 1.0, 0.0), &broken).is_jump());
    }
}
