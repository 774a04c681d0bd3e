//! Hyperelastic laws: strain energy density W, stress, material tangent, and the third derivative along given
//! directions.
//!
//! A law implements two traits: [`Describe`] (its parameters and moduli) and [`Law`] (its derivatives).
//! [`check`] tests them. [`Material::own`] accepts a law from outside this crate. A law for scene files is
//! one file with both traits and `BuiltIn` (the input of its parameters). The present file names it three
//! times: as a module, in the exports and in the list [`LAWS`].
//!
//! Every law of the list except the linear one is a function of invariants,
//!
//! W = f(I1, I2, J, I4),   I1 = tr C,  I2 = cof F : cof F,  J = det F,  I4 = |F a|^2,
//!
//! Its file contains f, the derivatives of f, the second Piola stress and the material tangent.
//! [`OfInvariants`] converts derivatives of f to those of W by the chain rule:
//!
//! - second Piola stress S = dW/dgamma = 2 f1 I + 2 f2 (I1 I - C) + fJ J C^-1 + 2 f4 a (x) a,
//! - material tangent dS/dgamma = sum_mn f_mn (dI_m/dgamma) (x) (dI_n/dgamma) + 4 f2 (I (x) I - Is)
//!   + fJ J (C^-1 (x) C^-1 - 2 C^-1 o C^-1), Is the symmetric identity, o the symmetrised product;
//!
//! The assembly uses them in terms of F, first Piola stress P = F S and elasticity A = dP/dF, without
//! divisions:
//!
//! - P = 2 f1 F + 2 f2 (I1 F - F F^T F) + fJ cof F + 2 f4 (F a) (x) a
//! - A = sum_mn f_mn (dI_m/dF) (x) (dI_n/dF) + f1 I1'' + f2 I2'' + fJ J'' + f4 I4''
//!
//! with I1'' = 2 d_ij d_KL,  I4'' = 2 d_ij a_K a_L,  J'' = e_ijm e_KLM F_mM  and
//! I2'' = 4 F_iK F_jL + 2 I1 d_ij d_KL - 2 (d_ij C_KL + F_iL F_jK + (F F^T)_ij d_KL).
//!
//! An incompressible law has the multiplier term (p0 + q)(1 - J). The rest pressure p0, which makes the
//! undeformed state free of stress, is part of f. The excess pressure q comes from
//! [`crate::fem::PressurePair`].

mod check;
mod holzapfel_gasser_ogden;
mod invariants;
mod lame;
mod law;
mod linear_elastic;
mod list;
mod mooney_rivlin;
mod neo_hookean;
mod own;
mod parameters;
mod st_venant_kirchhoff;
mod tangent;

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::{livers, mooney_rivlin};

pub use crate::fem::kinematics::Kinematics;
pub use crate::num::lanes::Real;
pub use crate::num::tensor::Mat3;
pub use check::{LawCheck, check};
pub(crate) use holzapfel_gasser_ogden::HolzapfelGasserOgden;
pub use invariants::{Derivatives, I1, I2, I4, Invariants, J, OfInvariants, Third, no_third};
pub use lame::Lame;
pub use law::{Describe, Law, Value};
pub use linear_elastic::LinearElastic;
pub use mooney_rivlin::{MooneyRivlin, ReducedMooneyRivlin};
pub use neo_hookean::NeoHookean;
use own::{ErasedLaw, OwnLaw};
pub use parameters::ParameterError;
pub use st_venant_kirchhoff::{ModifiedStVenantKirchhoff, StVenantKirchhoff};
pub use tangent::Tangent;

use std::sync::Arc;

use list::laws;
pub(crate) use parameters::{Key, SmallStrain};

laws! {
    /// Small strain, linear.
    "linear" => LinearElastic,
    /// Geometrically nonlinear, linear material (paper, Eq. 6).
    "st-venant-kirchhoff" => StVenantKirchhoff,
    /// St. Venant-Kirchhoff with J = 1 by a multiplier (the paper's "modified St. Venant").
    "modified-st-venant-kirchhoff" => ModifiedStVenantKirchhoff,
    /// Incompressible, unreduced invariants (paper, Eq. 7 with its misprint corrected).
    "mooney-rivlin" => MooneyRivlin,
    /// Incompressible, reduced invariants.
    "mooney-rivlin-reduced" => ReducedMooneyRivlin,
    /// Compressible, with a barrier at J -> 0.
    "neo-hookean" => NeoHookean,
    /// Incompressible with one family of fibres.
    "holzapfel-gasser-ogden" => HolzapfelGasserOgden,
}

impl Material {
    /// A user-defined law; `name` is used in messages and tables.
    ///
    /// [`crate::fem::Solver`] solves such a material like any other. It is code: a scene with it has no
    /// `.space` file, and no scene file can name it.
    pub fn own(name: &'static str, law: impl Law) -> Self {
        Self::Own(OwnLaw { name, law: Arc::new(law) })
    }

    /// The law behind dynamic dispatch: compiled once for all laws, with the bits of [`with_law`].
    pub(crate) fn erased(&self) -> &dyn ErasedLaw {
        with_law!(self, law => law)
    }

    /// Every parameter of the law by name, in a fixed order, as input of [`Material::from_parameters`].
    pub fn parameters(&self) -> Vec<(&'static str, Value)> {
        self.erased().parameters()
    }

    /// The numbers of [`Material::parameters`], for the hash of the model.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        self.parameters().iter().flat_map(|(_, value)| value.numbers().to_vec()).collect()
    }

    /// Pressure at rest of an incompressible law, Pa; `None` if the law needs no multiplier.
    pub(crate) fn rest_pressure_pa(&self) -> Option<f64> {
        self.erased().rest_pressure_pa()
    }

    /// Shear modulus at rest, Pa (of the matrix, for a law with fibres): the scale of residuals and
    /// pressures.
    pub(crate) fn shear_modulus_pa(&self) -> f64 {
        self.erased().shear_modulus_pa()
    }
}
