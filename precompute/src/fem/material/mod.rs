//! Hyperelastic laws: strain energy density W, stress, material tangent, and the third derivative along given directions.
//!
//! Every law but the linear one is a function of invariants,
//!
//! W = f(I1, I2, J, I4),   I1 = tr C,  I2 = cof F : cof F,  J = det F,  I4 = |F a|^2,
//!
//! and has its own file with f, its derivatives, the second Piola stress and the material tangent they make. `invariants`
//! turns derivatives of f into those of W by the chain rule:
//!
//! - second Piola stress S = dW/dgamma = 2 f1 I + 2 f2 (I1 I - C) + fJ J C^-1 + 2 f4 a (x) a,
//! - material tangent dS/dgamma = sum_mn f_mn (dI_m/dgamma) (x) (dI_n/dgamma) + 4 f2 (I (x) I - Is)
//!   + fJ J (C^-1 (x) C^-1 - 2 C^-1 o C^-1), Is the symmetric identity, o the symmetrised product;
//!
//! the assembly takes them in their F form, first Piola P = F S and elasticity A = dP/dF, which divide by nothing:
//!
//! - P = 2 f1 F + 2 f2 (I1 F - F F^T F) + fJ cof F + 2 f4 (F a) (x) a
//! - A = sum_mn f_mn (dI_m/dF) (x) (dI_n/dF) + f1 I1'' + f2 I2'' + fJ J'' + f4 I4''
//!
//! with I1'' = 2 d_ij d_KL,  I4'' = 2 d_ij a_K a_L,  J'' = e_ijm e_KLM F_mM  and
//! I2'' = 4 F_iK F_jL + 2 I1 d_ij d_KL - 2 (d_ij C_KL + F_iL F_jK + (F F^T)_ij d_KL).
//!
//! An incompressible law carries the multiplier term (p0 + q)(1 - J): the rest pressure p0, which makes the undeformed
//! state free of stress, is part of f; the excess q over it comes from [`crate::fem::pressure`].

mod holzapfel_gasser_ogden;
mod invariants;
mod linear_elastic;
mod mooney_rivlin;
mod neo_hookean;
mod st_venant_kirchhoff;
mod tangent;

#[cfg(test)]
mod tests;

pub use holzapfel_gasser_ogden::HolzapfelGasserOgden;
pub use linear_elastic::LinearElastic;
pub use mooney_rivlin::{MooneyRivlin, ReducedMooneyRivlin};
pub use neo_hookean::NeoHookean;
pub use st_venant_kirchhoff::{Lame, StVenantKirchhoff};
pub use tangent::{Tangent, TangentNode};

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::fem::kinematics::Kinematics;
use crate::num::jet::SymmetricThird;
use crate::num::lanes::Real;
use crate::num::tensor::Mat3;
use invariants::{Derivatives, I1, I2, I4, Invariants, J, OfInvariants, Third, no_third};

/// What the assembly asks of a law at a point, or at the points of several elements side by side.
pub(crate) trait Law {
    /// Energy density with the multiplier term of the excess pressure `q`, J/m^3, and first Piola stress, Pa.
    fn stress<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>);

    /// [`Law::stress`] with the tangent dP/dF at fixed pressure.
    fn response<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>, Tangent<R>);

    /// Third derivatives of W + q (1 - J) along three directions of (F, q), in the order of [`crate::num::jet::THIRD_INDICES`], J/m^3.
    fn third_along<R: Real>(
        &self,
        k: &Kinematics<R>,
        q_pa: R,
        gradients: &[Mat3<R>; 3],
        dq_pa: &[R; 3],
    ) -> [R; 10];
}

/// Evaluates an expression with the law inside a [`Material`], once compiled for each law.
macro_rules! with_law {
    ($material:expr, $law:ident => $work:expr) => {
        match $material {
            $crate::fem::material::Material::LinearElastic($law) => $work,
            $crate::fem::material::Material::StVenantKirchhoff($law)
            | $crate::fem::material::Material::ModifiedStVenantKirchhoff($law) => $work,
            $crate::fem::material::Material::MooneyRivlin($law) => $work,
            $crate::fem::material::Material::ReducedMooneyRivlin($law) => $work,
            $crate::fem::material::Material::NeoHookean($law) => $work,
            $crate::fem::material::Material::HolzapfelGasserOgden($law) => $work,
        }
    };
}
pub(crate) use with_law;

/// A hyperelastic law with its parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Material {
    /// Small strain, linear.
    LinearElastic(LinearElastic),
    /// Geometrically nonlinear, linear material (paper, Eq. 6).
    StVenantKirchhoff(StVenantKirchhoff),
    /// The same with J = 1 by a multiplier (the paper's "modified St. Venant").
    ModifiedStVenantKirchhoff(StVenantKirchhoff),
    /// Incompressible, unreduced invariants (paper, Eq. 7 with its misprint mended).
    MooneyRivlin(MooneyRivlin),
    /// Incompressible, reduced invariants.
    ReducedMooneyRivlin(ReducedMooneyRivlin),
    /// Compressible, with a barrier at J -> 0.
    NeoHookean(NeoHookean),
    /// Incompressible with one family of fibres.
    HolzapfelGasserOgden(HolzapfelGasserOgden),
}

impl Material {
    /// Name in the scene file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::LinearElastic(_) => "linear",
            Self::StVenantKirchhoff(_) => "st-venant-kirchhoff",
            Self::ModifiedStVenantKirchhoff(_) => "modified-st-venant-kirchhoff",
            Self::MooneyRivlin(_) => "mooney-rivlin",
            Self::ReducedMooneyRivlin(_) => "mooney-rivlin-reduced",
            Self::NeoHookean(_) => "neo-hookean",
            Self::HolzapfelGasserOgden(_) => "holzapfel-gasser-ogden",
        }
    }

    /// Every parameter of the law, in a fixed order: what a hash of the model takes in.
    pub fn parameters(&self) -> Vec<f64> {
        match self {
            Self::LinearElastic(LinearElastic { lame })
            | Self::StVenantKirchhoff(StVenantKirchhoff { lame })
            | Self::ModifiedStVenantKirchhoff(StVenantKirchhoff { lame })
            | Self::NeoHookean(NeoHookean { lame }) => vec![lame.lambda_pa, lame.mu_pa],
            Self::MooneyRivlin(MooneyRivlin { c10_pa, c01_pa })
            | Self::ReducedMooneyRivlin(ReducedMooneyRivlin { c10_pa, c01_pa }) => vec![*c10_pa, *c01_pa],
            Self::HolzapfelGasserOgden(HolzapfelGasserOgden { c10_pa, k1_pa, k2, dispersion, fibre }) => {
                vec![*c10_pa, *k1_pa, *k2, *dispersion, fibre[0], fibre[1], fibre[2]]
            }
        }
    }

    /// Pressure at rest of an incompressible law, Pa; `None` if the law needs no multiplier.
    pub fn rest_pressure_pa(&self) -> Option<f64> {
        match self {
            Self::LinearElastic(_) | Self::StVenantKirchhoff(_) | Self::NeoHookean(_) => None,
            Self::ModifiedStVenantKirchhoff(_) | Self::ReducedMooneyRivlin(_) => Some(0.0),
            Self::MooneyRivlin(law) => Some(law.rest_pressure_pa()),
            Self::HolzapfelGasserOgden(law) => Some(law.rest_pressure_pa()),
        }
    }

    /// Shear modulus at rest, Pa (of the matrix, where there are fibres): the scale of residuals and pressures.
    pub fn shear_modulus_pa(&self) -> f64 {
        match self {
            Self::LinearElastic(law) => law.lame.mu_pa,
            Self::StVenantKirchhoff(law) | Self::ModifiedStVenantKirchhoff(law) => law.lame.mu_pa,
            Self::NeoHookean(law) => law.lame.mu_pa,
            Self::MooneyRivlin(law) => 2.0 * (law.c10_pa + law.c01_pa),
            Self::ReducedMooneyRivlin(law) => 2.0 * (law.c10_pa + law.c01_pa),
            Self::HolzapfelGasserOgden(law) => 2.0 * law.c10_pa,
        }
    }
}

/// A law at one point, for callers that do not care about the last nanosecond.
impl Material {
    /// Energy density with the multiplier term of the excess pressure `q`, J/m^3, and first Piola stress, Pa.
    pub fn stress(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>) {
        let (energy, stress) = with_law!(self, law => law.stress(k, q_pa));
        (energy, stress.into())
    }

    /// [`Material::stress`] with the tangent dP/dF at fixed pressure.
    pub fn response(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>, Tangent) {
        let (energy, stress, tangent) = with_law!(self, law => law.response(k, q_pa));
        (energy, stress.into(), tangent)
    }

    /// Third derivatives of W + q (1 - J) along three directions of (F, q), in the order of [`crate::num::jet::THIRD_INDICES`], J/m^3.
    pub fn third_along(
        &self,
        k: &Kinematics,
        q_pa: f64,
        gradients: &[Matrix3<f64>; 3],
        dq_pa: &[f64; 3],
    ) -> SymmetricThird {
        let gradients = gradients.map(|g| Mat3::from(&g));
        with_law!(self, law => law.third_along(k, q_pa, &gradients, dq_pa))
    }
}
