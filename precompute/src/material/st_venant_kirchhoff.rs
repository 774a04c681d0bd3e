//! St. Venant-Kirchhoff: linear elasticity carried to large rotations (paper, Eq. 6).

use nalgebra::Matrix3;

use super::IsotropicTangent;

/// W = lambda/2 (tr gamma)^2 + mu gamma:gamma
///
/// S = dW/dgamma = lambda (tr gamma) I + 2 mu gamma
///
/// dS/dgamma = lambda I (x) I + 2 mu (symmetric identity), constant.
///
/// It has no barrier at J -> 0: a compressed element can collapse, which is why half of the paper's loading paths
/// end early with this law. Source: Peterlik 2010, section 2.1. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StVenantKirchhoff {
    /// First Lame coefficient, Pa.
    pub lambda_pa: f64,
    /// Second Lame coefficient (shear modulus), Pa.
    pub mu_pa: f64,
}

impl StVenantKirchhoff {
    /// From Young's modulus E and Poisson's ratio nu:
    /// lambda = E nu / ((1 + nu)(1 - 2 nu)),  mu = E / (2 (1 + nu)).
    pub fn from_young_poisson(young_pa: f64, poisson: f64) -> Self {
        Self {
            lambda_pa: young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
            mu_pa: young_pa / (2.0 * (1.0 + poisson)),
        }
    }

    /// W(gamma), J/m^3.
    #[inline]
    pub fn strain_energy_density(&self, green_strain: &Matrix3<f64>) -> f64 {
        let trace = green_strain.trace();
        0.5 * self.lambda_pa * trace * trace + self.mu_pa * green_strain.norm_squared()
    }

    /// S(gamma), Pa.
    #[inline]
    pub fn second_piola(&self, green_strain: &Matrix3<f64>) -> Matrix3<f64> {
        Matrix3::identity() * (self.lambda_pa * green_strain.trace()) + green_strain * (2.0 * self.mu_pa)
    }

    /// dS/dgamma, Pa.
    #[inline]
    pub fn tangent(&self) -> IsotropicTangent {
        IsotropicTangent { alpha_pa: self.lambda_pa, beta_pa: 2.0 * self.mu_pa }
    }
}
