//! Linear elasticity: small strain, no rotation.

use serde::{Deserialize, Serialize};

use super::{Lame, Law, Tangent};
use crate::fem::kinematics::Kinematics;
use crate::num::lanes::Real;
use crate::num::tensor::{Mat3, Vec3};

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
    fn stress<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>) {
        let h = k.displacement_gradient;
        let Lame { lambda_pa, mu_pa } = self.lame;
        let strain = (h + h.transpose()) * q_pa.constant(0.5);
        let trace = h.trace();
        let energy = trace * (0.5 * lambda_pa) * trace + strain.norm_squared() * mu_pa;
        (energy, (strain * q_pa.constant(2.0 * mu_pa)).plus_diagonal(trace * lambda_pa))
    }

    /// dsigma/dH: g_a . A . g_b = lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I.
    #[inline(always)]
    fn response<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>, Tangent<R>) {
        let (energy, stress) = self.stress(k, q_pa);
        let Lame { lambda_pa, mu_pa } = self.lame;
        let zero = q_pa.constant(0.0);
        let tangent = Tangent {
            map: Mat3::identity(zero),
            forward: q_pa.constant(lambda_pa),
            crosswise: q_pa.constant(mu_pa),
            left: Mat3::zeros(zero),
            stretch: zero,
            isotropic: q_pa.constant(mu_pa),
            determinant: zero,
            fibre: Vec3::constant(zero, [0.0; 3]),
            along_fibre: zero,
            second: [[zero; 4]; 4],
            slopes: [Mat3::zeros(zero); 4],
            rows: [false; 4],
        };
        (energy, stress, tangent)
    }

    #[inline(always)]
    fn third_along<R: Real>(
        &self,
        _k: &Kinematics<R>,
        q_pa: R,
        _gradients: &[Mat3<R>; 3],
        _dq_pa: &[R; 3],
    ) -> [R; 10] {
        [q_pa.constant(0.0); 10]
    }
}
