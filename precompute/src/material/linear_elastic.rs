//! Linear elasticity: small strain, no rotation.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::{Elasticity, Lame};

/// With eps = (H + H^T) / 2,
///
/// W = lambda/2 (tr eps)^2 + mu eps:eps
///
/// sigma = dW/dH = lambda (tr eps) I + 2 mu eps
///
/// dsigma/deps = lambda I (x) I + 2 mu Is, constant; d3W = 0.
///
/// At small strain the stress measures agree, so sigma stands for the first and the second Piola stress. The law is not
/// objective: a rotation strains it. It is here to be compared with (paper, Fig. 5). Source: any textbook. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LinearElastic {
    /// Lame's constants.
    pub lame: Lame,
}

impl LinearElastic {
    /// W and sigma at the displacement gradient `h`.
    #[inline]
    pub fn stress(&self, h: &Matrix3<f64>) -> (f64, Matrix3<f64>) {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let strain = 0.5 * (h + h.transpose());
        let trace = h.trace();
        let energy = 0.5 * lambda_pa * trace * trace + mu_pa * strain.norm_squared();
        (energy, Matrix3::identity() * (lambda_pa * trace) + strain * (2.0 * mu_pa))
    }

    /// dsigma/dH.
    #[inline]
    pub fn elasticity(&self) -> Elasticity {
        let Lame { lambda_pa, mu_pa } = self.lame;
        let mut elasticity = [[0.0; 9]; 9];
        for k in 0..3 {
            for i in 0..3 {
                elasticity[3 * k + i][3 * k + i] += mu_pa;
                elasticity[3 * k + i][3 * i + k] += mu_pa;
            }
        }
        for i in 0..3 {
            for j in 0..3 {
                elasticity[4 * i][4 * j] += lambda_pa;
            }
        }
        elasticity
    }
}
