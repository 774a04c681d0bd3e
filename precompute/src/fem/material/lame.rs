//! Lame's constants, the parameters of four laws.

use serde::{Deserialize, Serialize};

use super::Value;
use super::parameters::{ParameterError, Parameters};

/// Lame's constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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

    pub(super) fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("lambda_pa", self.lambda_pa.into()), ("mu_pa", self.mu_pa.into())]
    }

    /// Reads Lame's constants, or converts Young's modulus and Poisson's ratio.
    pub(super) fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError> {
        if given.has("young_pa") || given.has("poisson") {
            given.only(&["young_pa", "poisson"])?;
            let [young, poisson] = given.numbers(["young_pa", "poisson"])?;
            if young <= 0.0 {
                let fix = "give Young's modulus in pascals";
                return Err(given.wrong("young_pa", young, "must be positive", fix));
            }
            if !(-1.0 < poisson && poisson < 0.5) {
                let fix =
                    "give a ratio below 0.5 (0.49 is nearly incompressible), or take an incompressible law";
                return Err(given.wrong("poisson", poisson, "must be above -1 and below 0.5", fix));
            }
            return Ok(Self::from_young_poisson(young, poisson));
        }
        given.only(&["lambda_pa", "mu_pa"])?;
        let [lambda_pa, mu_pa] = given.numbers(["lambda_pa", "mu_pa"])?;
        if mu_pa <= 0.0 {
            return Err(given.wrong("mu_pa", mu_pa, "must be positive", "give the shear modulus in pascals"));
        }
        if 3.0 * lambda_pa + 2.0 * mu_pa <= 0.0 {
            let rule = "makes the bulk modulus lambda + 2 mu / 3 negative or zero";
            return Err(given.wrong("lambda_pa", lambda_pa, rule, "give a larger `lambda_pa`"));
        }
        Ok(Self { lambda_pa, mu_pa })
    }
}
