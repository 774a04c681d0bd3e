//! St. Venant-Kirchhoff: linear elasticity carried to large rotations (paper, Eq. 6).

use serde::{Deserialize, Serialize};

use super::{Derivatives, I1, I2, Invariants, OfInvariants};
use crate::num::lanes::Real;

/// Lame's constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lame {
    /// First Lame coefficient, Pa.
    pub lambda_pa: f64,
    /// Second Lame coefficient (shear modulus), Pa.
    pub mu_pa: f64,
}

impl Lame {
    /// From Young's modulus E and Poisson's ratio nu:
    /// lambda = E nu / ((1 + nu)(1 - 2 nu)),  mu = E / (2 (1 + nu)).
    pub fn from_young_poisson(young_pa: f64, poisson: f64) -> Self {
        Self {
            lambda_pa: young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
            mu_pa: young_pa / (2.0 * (1.0 + poisson)),
        }
    }
}

/// W = lambda/2 (tr gamma)^2 + mu gamma:gamma
///
/// S = dW/dgamma = lambda (tr gamma) I + 2 mu gamma
///
/// dS/dgamma = lambda I (x) I + 2 mu Is, constant.
///
/// In invariants, with i1 = I1 - 3 = 2 tr gamma, i2 = I2 - 3 and gamma:gamma = i1^2/4 + i1 - i2/2:
///
/// f = lambda/8 i1^2 + mu (i1^2/4 + i1 - i2/2),   f1 = (lambda/4 + mu/2) i1 + mu,   f2 = -mu/2,   f11 = lambda/4 + mu/2.
///
/// It has no barrier at J -> 0: a compressed element can collapse, which is why half of the paper's loading paths
/// end early with this law. The "modified" law of the paper adds the multiplier term q (1 - J) and keeps lambda; its
/// rest pressure is zero. Source: Peterlik 2010, section 2.1. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StVenantKirchhoff {
    /// Lame's constants.
    pub lame: Lame,
}

impl StVenantKirchhoff {
    /// From Young's modulus and Poisson's ratio.
    pub fn from_young_poisson(young_pa: f64, poisson: f64) -> Self {
        Self { lame: Lame::from_young_poisson(young_pa, poisson) }
    }
}

impl OfInvariants for StVenantKirchhoff {
    const CURVED: [bool; 4] = [true, false, false, false];

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let slope = 0.25 * lambda_pa + 0.5 * mu_pa;
        let energy = at.i1 * (0.5 * slope) * at.i1 + (at.i1 - at.i2 * 0.5) * mu_pa;
        let mut d = Derivatives::of_energy(energy);
        d.first[I1] = at.i1 * slope + mu_pa;
        d.first[I2] = energy.constant(-0.5 * mu_pa);
        d.second[I1][I1] = energy.constant(slope);
        d
    }
}
