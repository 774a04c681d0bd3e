//! St. Venant-Kirchhoff: linear elasticity extended to large rotations (paper, Eq. 6).

use super::Lame;
use super::invariants::{Derivatives, I1, I2, Invariants, OfInvariants};
use super::parameters::OfLame;
use crate::num::lanes::Real;

/// W = lambda/2 (tr gamma)^2 + mu gamma:gamma
///
/// S = dW/dgamma = lambda (tr gamma) I + 2 mu gamma
///
/// dS/dgamma = lambda I (x) I + 2 mu Is, constant.
///
/// In invariants, with i1 = I1 - 3 = 2 tr gamma, i2 = I2 - 3 and gamma:gamma = i1^2/4 + i1 - i2/2:
///
/// f = lambda/8 i1^2 + mu (i1^2/4 + i1 - i2/2),
///
/// f1 = (lambda/4 + mu/2) i1 + mu,   f2 = -mu/2,   f11 = lambda/4 + mu/2.
///
/// It has no barrier at J -> 0: a compressed element can collapse. Therefore half of the paper's loading
/// paths end early with this law. Source: Peterlik 2010, section 2.1. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StVenantKirchhoff {
    /// Lame's constants.
    pub lame: Lame,
}

impl OfLame for StVenantKirchhoff {
    fn lame(&self) -> Lame {
        self.lame
    }

    fn with_lame(lame: Lame) -> Self {
        Self { lame }
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

/// [`StVenantKirchhoff`] with J = 1: it adds the multiplier q (1 - J) and keeps lambda; the rest pressure is
/// zero. The paper's "modified St. Venant". Source: Peterlik 2010, section 2.1. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModifiedStVenantKirchhoff {
    /// Lame's constants.
    pub lame: Lame,
}

impl OfLame for ModifiedStVenantKirchhoff {
    const REST_PRESSURE_PA: Option<f64> = Some(0.0);

    fn lame(&self) -> Lame {
        self.lame
    }

    fn with_lame(lame: Lame) -> Self {
        Self { lame }
    }
}

impl OfInvariants for ModifiedStVenantKirchhoff {
    const CURVED: [bool; 4] = StVenantKirchhoff::CURVED;

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        StVenantKirchhoff { lame: self.lame }.derivatives(at)
    }
}
