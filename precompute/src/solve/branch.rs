//! Whether two solutions lie on one smooth branch of the condensed potential.
//!
//! Along the edge d from a to b, with W, h = dW/dd and S = dh/dd at both ends, the quintic through the data of W and the cubic
//! through those of h leave
//!
//! rho   = |W_b - W_a - (h_a + h_b).d/2 + d.(S_b - S_a).d/12| / |d|,
//!
//! rho_h = |h_b - h_a - (S_a + S_b) d/2|,
//!
//! both of higher order in |d| on a smooth branch, and of the order of the jump across a fold, a change of branch or a wrong
//! solution. rho is blind to a jump of h at mid-edge, where its energy cancels; rho_h sees it. No counterpart in the paper.

use nalgebra::{Matrix3, Vector3};

/// Excess over the smooth law beyond which there is a jump, N ...
pub const LEAST_N: f64 = 0.1;
/// ... and as a share of the larger |h| of the two. A jump smaller than the just noticeable difference of force, some 7 %,
/// is hardly one for the hand.
pub const SHARE: f64 = 0.1;

/// The condensed potential and its derivatives at a displacement of the handle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Potential {
    /// Displacement, m.
    pub displacement_m: [f64; 3],
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S, N/m.
    pub stiffness_n_m: Matrix3<f64>,
}

/// How far two solutions are from one smooth branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Excess {
    /// Excess of the energy over its quintic, by length, N.
    pub rho_n: f64,
    /// Excess of the force over its trapezium, N.
    pub rho_h_n: f64,
    /// Beyond this either is a jump, N.
    limit_n: f64,
}

impl Excess {
    /// Excess between two solutions at different displacements.
    pub fn between(a: &Potential, b: &Potential) -> Self {
        let d = Vector3::from(b.displacement_m) - Vector3::from(a.displacement_m);
        let (ha, hb) = (Vector3::from(a.force_n), Vector3::from(b.force_n));
        let bend = d.dot(&((b.stiffness_n_m - a.stiffness_n_m) * d));
        Self {
            rho_n: (b.energy_j - a.energy_j - 0.5 * (ha + hb).dot(&d) + bend / 12.0).abs() / d.norm(),
            rho_h_n: (hb - ha - (a.stiffness_n_m + b.stiffness_n_m) * d * 0.5).norm(),
            limit_n: LEAST_N.max(SHARE * ha.norm().max(hb.norm())),
        }
    }

    /// Whether the two lie on different branches, as far as the data tell.
    pub fn is_jump(&self) -> bool {
        // A NaN is no smooth branch either.
        !(self.rho_n <= self.limit_n && self.rho_h_n <= self.limit_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// W = k d^2/2 + c d^4/4 along x, and the same with a jump of the force by `jump` N beyond `at_m`.
    fn sample(x: f64, at_m: f64, jump: f64) -> Potential {
        let (k, c) = (300.0, 4e4);
        let beyond = (x - at_m).max(0.0);
        let here = if x > at_m { jump } else { 0.0 };
        Potential {
            displacement_m: [x, 0.0, 0.0],
            energy_j: 0.5 * k * x * x + 0.25 * c * x.powi(4) + jump * beyond,
            force_n: [k * x + c * x.powi(3) + here, 0.0, 0.0],
            stiffness_n_m: Matrix3::from_diagonal(&Vector3::new(k + 3.0 * c * x * x, 0.0, 0.0)),
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
        assert!(scaled(0.0) && !scaled(6.0), "0.8 N is a jump at 7 N and none at 9 N");
        let broken = Potential { energy_j: f64::NAN, ..sample(0.02, 1.0, 0.0) };
        assert!(Excess::between(&sample(0.01, 1.0, 0.0), &broken).is_jump());
    }
}
