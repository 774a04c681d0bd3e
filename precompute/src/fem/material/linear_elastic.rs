//! Linear elasticity: small strain, no rotation.

use super::parameters::OfLame;
use super::{Lame, Law, Tangent};
use crate::fem::kinematics::Kinematics;
use crate::num::lanes::Real;
use crate::num::tensor::Mat3;

/// With eps = (H + H^T) / 2,
///
/// W = lambda/2 (tr eps)^2 + mu eps:eps
///
/// sigma = dW/dH = lambda (tr eps) I + 2 mu eps
///
/// dsigma/deps = lambda I (x) I + 2 mu Is, constant; d3W = 0.
///
/// All stress measures agree at small strain, so sigma is both the first and the second Piola stress. The law
/// is not objective: a rotation causes strain. It serves for comparisons (paper, Fig. 5). Source: any
/// textbook. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearElastic {
    /// Lame's constants.
    pub lame: Lame,
}

impl OfLame for LinearElastic {
    fn lame(&self) -> Lame {
        self.lame
    }

    fn with_lame(lame: Lame) -> Self {
        Self { lame }
    }
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
        let tangent = Tangent {
            forward: q_pa.constant(lambda_pa),
            crosswise: q_pa.constant(mu_pa),
            isotropic: q_pa.constant(mu_pa),
            ..Tangent::zero(q_pa)
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
