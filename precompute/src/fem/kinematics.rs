//! Kinematics of a material point: F, J, strain invariants, and their derivatives along given directions.
//!
//! All quantities are functions of the displacement gradient H = F - I and not of F, because small strains
//! would be lost in the rounding of 1 + H. At a displacement of 1 um the strain is 1e-5, and its square still
//! has eleven digits. No formula divides by J: all quantities are polynomials in H, which are finite and
//! exact for inverted elements too.

use nalgebra::Matrix3;

use crate::num::lanes::Real;
use crate::num::tensor::Mat3;

/// Deformation of one material point.
#[derive(Debug, Clone, Copy)]
pub struct Kinematics<R = f64> {
    /// Displacement gradient H = du/dX.
    pub displacement_gradient: Mat3<R>,
    /// Deformation gradient F = I + H.
    pub deformation_gradient: Mat3<R>,
    /// Cofactor matrix cof F = J F^-T = dJ/dF; also defined for J <= 0.
    pub cofactor: Mat3<R>,
    /// I1 - 3 = 2 tr H + H:H, with I1 = tr C.
    pub first_invariant: R,
    /// I2 - 3 = 2 tr K + K:K with K = cof F - I, because I2 = cof F : cof F.
    pub second_invariant: R,
    /// J - 1 = tr H + tr cof H + det H.
    pub volume_change: R,
}

impl Kinematics {
    /// Kinematics of the displacement gradient `h` = du/dX, for one material point.
    pub(crate) fn of(h: &Matrix3<f64>) -> Self {
        Self::new(h.into())
    }
}

impl<R: Real> Kinematics<R> {
    /// Kinematics of the displacement gradient `h` = du/dX, lane by lane.
    #[inline(always)]
    pub(crate) fn new(h: Mat3<R>) -> Self {
        let cofactor_of_h = cofactor(h);
        let (trace, cofactor_trace) = (h.trace(), cofactor_of_h.trace());
        // cof(I + H) - I = tr(H) I - H^T + cof H.
        let shift = (cofactor_of_h - h.transpose()).plus_diagonal(trace);
        let determinant = h.0[0].dot(cofactor_of_h.0[0]);
        let one = trace.constant(1.0);
        Self {
            displacement_gradient: h,
            deformation_gradient: h.plus_diagonal(one),
            cofactor: shift.plus_diagonal(one),
            first_invariant: trace * 2.0 + h.norm_squared(),
            second_invariant: shift.trace() * 2.0 + shift.norm_squared(),
            volume_change: trace + cofactor_trace + determinant,
        }
    }

    /// The deformation of one lane.
    pub(crate) fn lane(&self, lane: usize) -> Kinematics {
        Kinematics::new(self.displacement_gradient.lane(lane))
    }

    /// Jacobian J = det F.
    #[inline(always)]
    pub(crate) fn jacobian(&self) -> R {
        self.volume_change + 1.0
    }
}

/// Cofactor matrix: its columns are the cross products of the columns of `f`.
#[inline(always)]
pub(crate) fn cofactor<R: Real>(f: Mat3<R>) -> Mat3<R> {
    let [a, b, c] = f.0;
    Mat3([b.cross(c), c.cross(a), a.cross(b)])
}

/// Bilinear form of the cofactor: cof(A + B) = cof A + `mixed_cofactor`(A, B) + cof B. It is the derivative
/// of cof at A along B, and `mixed_cofactor`(A, B) : C is the second derivative of det at C along A and B.
#[inline(always)]
pub(crate) fn mixed_cofactor<R: Real>(a: Mat3<R>, b: Mat3<R>) -> Mat3<R> {
    let ([a0, a1, a2], [b0, b1, b2]) = (a.0, b.0);
    Mat3([a1.cross(b2) + b1.cross(a2), a2.cross(b0) + b2.cross(a0), a0.cross(b1) + b0.cross(a1)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Matrix3<f64> {
        Matrix3::new(0.2, -0.3, 0.1, 0.05, -0.4, 0.25, 0.3, 0.15, 0.1)
    }

    /// Green-St. Venant strain gamma = (H + H^T + H^T H) / 2 (paper, Eq. 1).
    fn green_strain(k: &Kinematics) -> Mat3<f64> {
        let h = k.displacement_gradient;
        (h + h.transpose() + h.transpose() * h) * 0.5
    }

    #[test]
    fn invariants_are_those_of_the_right_cauchy_green_tensor() {
        let k = Kinematics::of(&sample());
        let f = Matrix3::from(k.deformation_gradient);
        let c = f.transpose() * f;
        let (first, squared) = (c.trace(), (c * c).trace());
        assert!((k.first_invariant - (first - 3.0)).abs() < 1e-15);
        assert!((k.second_invariant - (0.5 * (first * first - squared) - 3.0)).abs() < 1e-14);
        assert!((k.jacobian() - f.determinant()).abs() < 1e-15);
        assert!((k.cofactor - cofactor(k.deformation_gradient)).norm_squared() < 1e-30);
        assert!((2.0 * Matrix3::from(green_strain(&k)) - (c - Matrix3::identity())).norm() < 1e-15);
    }

    #[test]
    fn the_cofactor_is_the_derivative_of_j() {
        let (h, step) = (sample(), 1e-6);
        let k = Kinematics::of(&h);
        for i in 0..3 {
            for j in 0..3 {
                let (mut plus, mut minus) = (h, h);
                plus[(i, j)] += step;
                minus[(i, j)] -= step;
                let slope = (Kinematics::of(&plus).volume_change - Kinematics::of(&minus).volume_change)
                    / (2.0 * step);
                assert!((slope - k.cofactor.at(i, j)).abs() < 1e-9, "dJ/dF[{i},{j}]");
            }
        }
    }

    #[test]
    fn the_mixed_cofactor_is_what_a_sum_has_beyond_its_parts() {
        let (a, b) = (sample(), sample().transpose() * 3.0);
        let [a, b] = [a, b].map(|matrix| Mat3::from(&matrix));
        let rest = cofactor(a + b) - cofactor(a) - cofactor(b) - mixed_cofactor(a, b);
        assert!(rest.norm_squared() < 1e-28);
    }

    #[test]
    fn a_rotation_has_no_strain() {
        let turn = *nalgebra::Rotation3::from_euler_angles(0.7, -1.1, 2.0).matrix();
        let k = Kinematics::of(&(turn - Matrix3::identity()));
        assert!(green_strain(&k).norm_squared() < 1e-30);
        for invariant in [k.first_invariant, k.second_invariant, k.volume_change] {
            assert!(invariant.abs() < 2e-15);
        }
    }

    #[test]
    fn tiny_strains_keep_their_digits() {
        let h = sample() * 1e-9;
        let exact = h.trace();
        assert!((Kinematics::of(&h).volume_change / exact - 1.0).abs() < 1e-8);
        assert!((Kinematics::of(&h).second_invariant / (4.0 * exact) - 1.0).abs() < 1e-8);
    }
}
