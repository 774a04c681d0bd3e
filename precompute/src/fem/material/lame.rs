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

    /// E and nu of these constants:  E = mu (3 lambda + 2 mu) / (lambda + mu),  nu = lambda / (2 (lambda + mu)).
    fn young_poisson(self) -> (f64, f64) {
        let Self { lambda_pa, mu_pa } = self;
        let sum_pa = lambda_pa + mu_pa;
        (mu_pa * (3.0 * lambda_pa + 2.0 * mu_pa) / sum_pa, 0.5 * lambda_pa / sum_pa)
    }

    /// d(lambda, mu)/dE at constant nu, dimensionless: both are proportional to E.
    pub(super) fn by_young(self) -> Self {
        let (young_pa, _) = self.young_poisson();
        Self { lambda_pa: self.lambda_pa / young_pa, mu_pa: self.mu_pa / young_pa }
    }

    /// d(lambda, mu)/dnu at constant E, Pa:
    ///
    /// dlambda/dnu = E (1 + 2 nu^2) / ((1 + nu)^2 (1 - 2 nu)^2),   dmu/dnu = -E / (2 (1 + nu)^2).
    pub(super) fn by_poisson(self) -> Self {
        let (young_pa, nu) = self.young_poisson();
        let (sum, less) = (1.0 + nu, 1.0 - 2.0 * nu);
        Self {
            lambda_pa: young_pa * (1.0 + 2.0 * nu * nu) / (sum * sum * less * less),
            mu_pa: -0.5 * young_pa / (sum * sum),
        }
    }
}
