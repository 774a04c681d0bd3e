//! Linear elasticity: small strain, no rotation.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Lame, Law, SymmetricThird, Tangent};
use crate::kinematics::Kinematics;

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

impl Law for LinearElastic {
    #[inline(always)]
    fn stress(&self, k: &Kinematics, _q_pa: f64) -> (f64, Matrix3<f64>) {
        let h = &k.displacement_gradient;
        let Lame { lambda_pa, mu_pa } = self.lame;
        let strain = 0.5 * (h + h.transpose());
        let trace = h.trace();
        let energy = 0.5 * lambda_pa * trace * trace + mu_pa * strain.norm_squared();
        (energy, Matrix3::identity() * (lambda_pa * trace) + strain * (2.0 * mu_pa))
    }

    /// dsigma/dH: g_a . A . g_b = lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I.
    #[inline(always)]
    fn response(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>, Tangent) {
        let (energy, stress) = self.stress(k, q_pa);
        let Lame { lambda_pa, mu_pa } = self.lame;
        let tangent = Tangent {
            map: Matrix3::identity(),
            forward: lambda_pa,
            crosswise: mu_pa,
            left: Matrix3::zeros(),
            stretch: 0.0,
            isotropic: mu_pa,
            determinant: 0.0,
            fibre: Vector3::zeros(),
            along_fibre: 0.0,
            second: [[0.0; 4]; 4],
            slopes: [Matrix3::zeros(); 4],
            rows: [false; 4],
        };
        (energy, stress, tangent)
    }

    #[inline(always)]
    fn third_along(
        &self,
        _k: &Kinematics,
        _q_pa: f64,
        _gradients: &[Matrix3<f64>; 3],
        _dq_pa: &[f64; 3],
    ) -> SymmetricThird {
        [0.0; 10]
    }
}
