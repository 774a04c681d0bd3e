//! Lame's constants, the parameters of four laws.

/// Lame's constants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lame {
    /// First Lame coefficient, Pa.
    pub lambda_pa: f64,
    /// Second Lame coefficient (shear modulus), Pa.
    pub mu_pa: f64,
}

impl Lame {
    /// Converts Young's modulus E and Poisson's ratio nu:
    /// lambda = E nu / ((1 + nu)(1 - 2 nu)),  mu = E / (2 (1 + nu)).
    pub fn from_young_poisson(young_pa: f64, poisson: f64) -> Self {
        Self {
            lambda_pa: young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
            mu_pa: young_pa / (2.0 * (1.0 + poisson)),
        }
    }
}
