//! Compressible neo-Hookean with a logarithmic barrier.

use super::Lame;
use super::invariants::{Derivatives, I1, Invariants, J, OfInvariants, Third, no_third};
use super::parameters::OfLame;
use crate::num::lanes::Real;

/// W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2
///
/// S = dW/dgamma = mu (I - C^-1) + lambda ln J C^-1
///
/// dS/dgamma = lambda C^-1 (x) C^-1 + 2 (mu - lambda ln J) C^-1 o C^-1
///
/// In invariants, with l = ln J:
///
/// f1 = mu/2,   fJ = (lambda l - mu) / J,   fJJ = (mu + lambda - lambda l) / J^2,
///
/// fJJJ = (2 lambda l - 2 mu - 3 lambda) / J^3.
///
/// W -> infinity as J -> 0, so no element can collapse. For J <= 0 the energy is NaN, and Newton's line
/// search shortens the step. The law agrees with linear elasticity at small strain. Source: Bonet and Wood
/// 2008, section 6.4.3. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeoHookean {
    /// Lame's constants at rest.
    pub lame: Lame,
}

impl OfLame for NeoHookean {
    fn lame(&self) -> Lame {
        self.lame
    }

    fn with_lame(lame: Lame) -> Self {
        Self { lame }
    }
}

impl OfInvariants for NeoHookean {
    const CURVED: [bool; 4] = [false, false, true, false];
    const THIRD: bool = true;
    const SECOND_INVARIANT: bool = false;

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let (log, inverse) = (at.j.map(libm::log1p), (at.j + 1.0).recip());
        let energy = at.i1 * (0.5 * mu_pa) - log * mu_pa + log * (0.5 * lambda_pa) * log;
        let mut d = Derivatives::of_energy(energy);
        d.first[I1] = energy.constant(0.5 * mu_pa);
        d.first[J] = (log * lambda_pa - mu_pa) * inverse;
        d.second[J][J] = (-(log * lambda_pa) + (mu_pa + lambda_pa)) * inverse * inverse;
        d
    }

    #[inline(always)]
    fn third<R: Real>(&self, at: &Invariants<R>) -> Third<R> {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let (log, inverse) = (at.j.map(libm::log1p), (at.j + 1.0).recip());
        let mut third = no_third(at.j);
        let numerator = log * (2.0 * lambda_pa) - 2.0 * mu_pa - 3.0 * lambda_pa;
        third[J][J][J] = numerator * (inverse * (inverse * inverse));
        third
    }
}
