//! Incompressible Mooney-Rivlin with unreduced invariants (paper, Eq. 7).

use nalgebra::Matrix3;

use super::IsotropicTangent;

/// W = C10 (I1 - 3) + C01 (I2 - 3), with C = I + 2 gamma, so that
///
/// I1 - 3 = 2 tr gamma,   I2 - 3 = 4 tr gamma + 2 (tr^2 gamma - tr gamma^2),
///
/// W = 2 [ (C10 + 2 C01) tr gamma + C01 (tr^2 gamma - tr gamma^2) ]
///
/// S = dW/dgamma = 2 (C10 + 2 C01) I + 4 C01 ((tr gamma) I - gamma)
///
/// dS/dgamma = 4 C01 (I (x) I - symmetric identity), constant.
///
/// Deviation: the paper prints 2 C01 before the bracket of Eq. (7); the standard form above is what gives its
/// own E = 6 (C10 + C01) = 15.48 kPa and what its tool, GetFEM, computes.
///
/// The law is meant with J = 1, kept by a pressure multiplier: W + p (1 - J). At rest S is not zero but
/// 2 (C10 + 2 C01) I; the rest pressure p0 = 2 C10 + 4 C01 balances it (S - p0 J C^-1 = 0 at gamma = 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MooneyRivlin {
    /// Coefficient of I1 - 3, Pa.
    pub c10_pa: f64,
    /// Coefficient of I2 - 3, Pa.
    pub c01_pa: f64,
}

impl MooneyRivlin {
    /// W(gamma), J/m^3.
    #[inline]
    pub fn strain_energy_density(&self, green_strain: &Matrix3<f64>) -> f64 {
        let trace = green_strain.trace();
        2.0 * ((self.c10_pa + 2.0 * self.c01_pa) * trace
            + self.c01_pa * (trace * trace - green_strain.norm_squared()))
    }

    /// S(gamma), Pa, without the pressure part.
    #[inline]
    pub fn second_piola(&self, green_strain: &Matrix3<f64>) -> Matrix3<f64> {
        let spherical = 2.0 * (self.c10_pa + 2.0 * self.c01_pa) + 4.0 * self.c01_pa * green_strain.trace();
        Matrix3::identity() * spherical - green_strain * (4.0 * self.c01_pa)
    }

    /// dS/dgamma, Pa.
    #[inline]
    pub fn tangent(&self) -> IsotropicTangent {
        IsotropicTangent { alpha_pa: 4.0 * self.c01_pa, beta_pa: -4.0 * self.c01_pa }
    }

    /// p0 = 2 C10 + 4 C01, Pa.
    #[inline]
    pub fn rest_pressure_pa(&self) -> f64 {
        2.0 * self.c10_pa + 4.0 * self.c01_pa
    }
}
