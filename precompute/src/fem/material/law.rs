//! The traits of a law: its energy with derivatives, and its description.

use std::fmt::Debug;

use super::Tangent;
use crate::fem::kinematics::Kinematics;
use crate::num::lanes::Real;
use crate::num::tensor::Mat3;

/// Value of a parameter of a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A number in the unit at the end of the parameter's name.
    Number(f64),
    /// A direction in the undeformed body.
    Vector([f64; 3]),
}

impl Value {
    /// The numbers of the value.
    pub(crate) fn numbers(&self) -> &[f64] {
        match self {
            Self::Number(number) => std::slice::from_ref(number),
            Self::Vector(vector) => vector,
        }
    }
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<[f64; 3]> for Value {
    fn from(vector: [f64; 3]) -> Self {
        Self::Vector(vector)
    }
}

/// Parameters and moduli of a law.
pub trait Describe: Debug + Send + Sync + 'static {
    /// Every parameter by name, in a fixed order. Two laws of one type are equal if these are equal.
    fn parameters(&self) -> Vec<(&'static str, Value)>;

    /// Shear modulus at rest, Pa (of the matrix, for a law with fibres): the scale of residuals and
    /// pressures.
    fn shear_modulus_pa(&self) -> f64;

    /// Pressure p0 at rest of an incompressible law, Pa; `None` if the law needs no pressure field.
    fn rest_pressure_pa(&self) -> Option<f64> {
        None
    }
}

/// A hyperelastic law at one point, or at the points of several elements in parallel ([`Real`]).
///
/// W is the strain energy density. q is the excess of the pressure over the rest pressure, zero for a law
/// without a pressure. A law of invariants implements [`super::OfInvariants`], which provides
/// this trait. [`super::check`] tests the implementation of either.
pub trait Law: Describe {
    /// W + q (1 - J), J/m^3, and its derivative with respect to F, the first Piola stress, Pa.
    fn stress<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>);

    /// [`Law::stress`] with the elasticity dP/dF at fixed pressure.
    fn response<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>, Tangent<R>);

    /// Third derivatives of W + q (1 - J) along three directions of (F, q), in the order of
    /// [`crate::num::jet::THIRD_INDICES`], J/m^3.
    fn third_along<R: Real>(
        &self,
        k: &Kinematics<R>,
        q_pa: R,
        gradients: &[Mat3<R>; 3],
        dq_pa: &[R; 3],
    ) -> [R; 10];
}
