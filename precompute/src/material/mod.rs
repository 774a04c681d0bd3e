//! Hyperelastic laws: strain energy density W, second Piola stress S = dW/dgamma, material tangent dS/dgamma.
//!
//! Each law has its own file with the derivation. All are functions of the Green-St. Venant strain gamma; an
//! incompressible law adds the multiplier term p (1 - J), which lives in [`crate::incompressibility`] because it
//! is the same for all of them.

mod mooney_rivlin;
mod st_venant_kirchhoff;

pub use mooney_rivlin::MooneyRivlin;
pub use st_venant_kirchhoff::StVenantKirchhoff;

use nalgebra::Matrix3;

use crate::scene::MaterialLaw;

/// Constant isotropic material tangent dS/dgamma = alpha I (x) I + beta (symmetric identity):
/// dS = alpha tr(dgamma) I + beta dgamma.
///
/// Both laws here are quadratic in gamma, so their tangent is constant and isotropic; the element stiffness
/// then has the closed form of [`crate::assembly`], four times fewer operations than a 6 x 6 contraction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IsotropicTangent {
    /// Coefficient of I (x) I, Pa.
    pub alpha_pa: f64,
    /// Coefficient of the symmetric identity, Pa.
    pub beta_pa: f64,
}

/// A hyperelastic law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Material {
    /// Geometrically nonlinear, linear material (paper, Eq. 6).
    StVenantKirchhoff(StVenantKirchhoff),
    /// Nonlinear material, incompressible (paper, Eq. 7 with its misprint mended).
    MooneyRivlin(MooneyRivlin),
}

impl Material {
    /// The law of a scene, or `None` if this version cannot solve it (the scene's own check says so to the user).
    pub fn of_scene(law: &MaterialLaw) -> Option<Self> {
        match *law {
            MaterialLaw::StVenantKirchhoff { lambda_pa, mu_pa } => {
                Some(Self::StVenantKirchhoff(StVenantKirchhoff { lambda_pa, mu_pa }))
            }
            MaterialLaw::MooneyRivlin { c10_pa, c01_pa } => {
                Some(Self::MooneyRivlin(MooneyRivlin { c10_pa, c01_pa }))
            }
            _ => None,
        }
    }

    /// Strain energy density W(gamma), J/m^3, zero at rest.
    #[inline]
    pub fn strain_energy_density(&self, green_strain: &Matrix3<f64>) -> f64 {
        match self {
            Self::StVenantKirchhoff(law) => law.strain_energy_density(green_strain),
            Self::MooneyRivlin(law) => law.strain_energy_density(green_strain),
        }
    }

    /// Second Piola-Kirchhoff stress S = dW/dgamma, Pa, without the pressure part.
    #[inline]
    pub fn second_piola(&self, green_strain: &Matrix3<f64>) -> Matrix3<f64> {
        match self {
            Self::StVenantKirchhoff(law) => law.second_piola(green_strain),
            Self::MooneyRivlin(law) => law.second_piola(green_strain),
        }
    }

    /// Material tangent dS/dgamma, Pa.
    #[inline]
    pub fn tangent(&self) -> IsotropicTangent {
        match self {
            Self::StVenantKirchhoff(law) => law.tangent(),
            Self::MooneyRivlin(law) => law.tangent(),
        }
    }

    /// Pressure multiplier at rest if the law is incompressible (J = 1 by a multiplier), Pa.
    pub fn rest_pressure_pa(&self) -> Option<f64> {
        match self {
            Self::StVenantKirchhoff(_) => None,
            Self::MooneyRivlin(law) => Some(law.rest_pressure_pa()),
        }
    }

    /// Shear modulus at rest, Pa: the scale by which residuals and pressures are made dimensionless.
    pub fn shear_modulus_pa(&self) -> f64 {
        match self {
            Self::StVenantKirchhoff(law) => law.mu_pa,
            Self::MooneyRivlin(law) => 2.0 * (law.c10_pa + law.c01_pa),
        }
    }

    /// Name in the scene file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::StVenantKirchhoff(_) => "st-venant-kirchhoff",
            Self::MooneyRivlin(_) => "mooney-rivlin",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn laws() -> [Material; 2] {
        [
            Material::StVenantKirchhoff(StVenantKirchhoff::from_young_poisson(15480.0, 0.49)),
            Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 }),
        ]
    }

    fn strain() -> Matrix3<f64> {
        Matrix3::new(0.21, -0.07, 0.03, -0.07, -0.18, 0.11, 0.03, 0.11, 0.09)
    }

    /// A symmetric unit change of strain; off-diagonal entries move in pairs, so W changes by 2 S_ij.
    fn unit(i: usize, j: usize) -> Matrix3<f64> {
        let mut e = Matrix3::zeros();
        e[(i, j)] = 1.0;
        e[(j, i)] = 1.0;
        e
    }

    #[test]
    fn stress_is_the_derivative_of_the_energy() {
        for law in laws() {
            let (gamma, step) = (strain(), 1e-5);
            let s = law.second_piola(&gamma);
            for (i, j) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
                let e = unit(i, j) * step;
                let slope = (law.strain_energy_density(&(gamma + e))
                    - law.strain_energy_density(&(gamma - e)))
                    / (2.0 * step);
                let want = if i == j { s[(i, j)] } else { 2.0 * s[(i, j)] };
                assert!((slope - want).abs() < 1e-6 * s.norm(), "{} S[{i},{j}]: {slope} {want}", law.name());
            }
        }
    }

    #[test]
    fn tangent_is_the_derivative_of_the_stress() {
        for law in laws() {
            let (gamma, step) = (strain(), 1e-4);
            let t = law.tangent();
            for (i, j) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
                let e = unit(i, j);
                let slope = (law.second_piola(&(gamma + e * step)) - law.second_piola(&(gamma - e * step)))
                    / (2.0 * step);
                let want = Matrix3::identity() * (t.alpha_pa * e.trace()) + e * t.beta_pa;
                assert!(
                    (slope - want).norm() < 1e-8 * (t.alpha_pa.abs() + t.beta_pa.abs()),
                    "{}",
                    law.name()
                );
            }
        }
    }
}
