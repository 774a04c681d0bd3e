//! Kinematics of a material point: F, J, strain invariants, and their derivatives along given directions.
//!
//! Everything is written in the displacement gradient H = F - I rather than in F, so that small strains do not drown in
//! the rounding of 1 + H: at 1 um of touch the strain is 1e-5 and its square still has eleven digits. Nothing divides by J:
//! all of it is a polynomial in H, finite and exact through inverted elements.

use nalgebra::{Matrix3, Vector3};

/// Deformation of one material point.
#[derive(Debug, Clone, Copy)]
pub struct Kinematics {
    /// Displacement gradient H = du/dX.
    pub displacement_gradient: Matrix3<f64>,
    /// Deformation gradient F = I + H.
    pub deformation_gradient: Matrix3<f64>,
    /// Cofactor matrix cof F = J F^-T = dJ/dF, defined for J <= 0 too.
    pub cofactor: Matrix3<f64>,
    /// I1 - 3 = 2 tr H + H:H, with I1 = tr C.
    pub first_invariant: f64,
    /// I2 - 3 = 2 tr K + K:K with K = cof F - I, because I2 = cof F : cof F.
    pub second_invariant: f64,
    /// J - 1 = tr H + tr cof H + det H.
    pub volume_change: f64,
}

impl Kinematics {
    /// Kinematics of the displacement gradient `h` = du/dX.
    #[inline(always)]
    pub fn new(h: &Matrix3<f64>) -> Self {
        let cofactor_of_h = cofactor(h);
        let (trace, cofactor_trace) = (h.trace(), cofactor_of_h.trace());
        // cof(I + H) - I = tr(H) I - H^T + cof H.
        let mut shift = cofactor_of_h - h.transpose();
        for axis in 0..3 {
            shift[(axis, axis)] += trace;
        }
        let determinant = h.column(0).dot(&cofactor_of_h.column(0));
        Self {
            displacement_gradient: *h,
            deformation_gradient: h + Matrix3::identity(),
            cofactor: shift + Matrix3::identity(),
            first_invariant: 2.0 * trace + h.norm_squared(),
            second_invariant: 2.0 * shift.trace() + shift.norm_squared(),
            volume_change: trace + cofactor_trace + determinant,
        }
    }

    /// Jacobian J = det F.
    #[inline(always)]
    pub fn jacobian(&self) -> f64 {
        1.0 + self.volume_change
    }

    /// Green-St. Venant strain gamma = (H + H^T + H^T H) / 2 (paper, Eq. 1).
    #[inline(always)]
    pub fn green_strain(&self) -> Matrix3<f64> {
        let h = &self.displacement_gradient;
        0.5 * (h + h.transpose() + h.transpose() * h)
    }
}

/// Cofactor matrix: its columns are the cross products of the columns of `f`.
#[inline(always)]
pub fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let [c0, c1, c2] = [0, 1, 2].map(|k| Vector3::from(f.column(k)));
    Matrix3::from_columns(&[c1.cross(&c2), c2.cross(&c0), c0.cross(&c1)])
}

/// Bilinear form of the cofactor: cof(A + B) = cof A + `mixed_cofactor`(A, B) + cof B. It is the derivative of cof at A
/// along B, and `mixed_cofactor`(A, B) : C is the second derivative of det at C along A and B.
#[inline(always)]
pub fn mixed_cofactor(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    let [a0, a1, a2] = [0, 1, 2].map(|k| Vector3::from(a.column(k)));
    let [b0, b1, b2] = [0, 1, 2].map(|k| Vector3::from(b.column(k)));
    Matrix3::from_columns(&[
        a1.cross(&b2) + b1.cross(&a2),
        a2.cross(&b0) + b2.cross(&a0),
        a0.cross(&b1) + b0.cross(&a1),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Matrix3<f64> {
        Matrix3::new(0.2, -0.3, 0.1, 0.05, -0.4, 0.25, 0.3, 0.15, 0.1)
    }

    #[test]
    fn invariants_are_those_of_the_right_cauchy_green_tensor() {
        let k = Kinematics::new(&sample());
        let c = k.deformation_gradient.transpose() * k.deformation_gradient;
        let (first, squared) = (c.trace(), (c * c).trace());
        assert!((k.first_invariant - (first - 3.0)).abs() < 1e-15);
        assert!((k.second_invariant - (0.5 * (first * first - squared) - 3.0)).abs() < 1e-14);
        assert!((k.jacobian() - k.deformation_gradient.determinant()).abs() < 1e-15);
        assert!((k.cofactor - cofactor(&k.deformation_gradient)).norm() < 1e-15);
        assert!((2.0 * k.green_strain() - (c - Matrix3::identity())).norm() < 1e-15);
    }

    #[test]
    fn the_cofactor_is_the_derivative_of_j() {
        let (h, step) = (sample(), 1e-6);
        let k = Kinematics::new(&h);
        for i in 0..3 {
            for j in 0..3 {
                let (mut plus, mut minus) = (h, h);
                plus[(i, j)] += step;
                minus[(i, j)] -= step;
                let slope = (Kinematics::new(&plus).volume_change - Kinematics::new(&minus).volume_change)
                    / (2.0 * step);
                assert!((slope - k.cofactor[(i, j)]).abs() < 1e-9, "dJ/dF[{i},{j}]");
            }
        }
    }

    #[test]
    fn the_mixed_cofactor_is_what_a_sum_has_beyond_its_parts() {
        let (a, b) = (sample(), sample().transpose() * 3.0);
        assert!((cofactor(&(a + b)) - cofactor(&a) - cofactor(&b) - mixed_cofactor(&a, &b)).norm() < 1e-14);
    }

    #[test]
    fn a_rotation_has_no_strain() {
        let turn = *nalgebra::Rotation3::from_euler_angles(0.7, -1.1, 2.0).matrix();
        let k = Kinematics::new(&(turn - Matrix3::identity()));
        assert!(k.green_strain().norm() < 1e-15);
        for invariant in [k.first_invariant, k.second_invariant, k.volume_change] {
            assert!(invariant.abs() < 2e-15);
        }
    }

    #[test]
    fn tiny_strains_keep_their_digits() {
        let h = sample() * 1e-9;
        let exact = h.trace();
        assert!((Kinematics::new(&h).volume_change / exact - 1.0).abs() < 1e-8);
        assert!((Kinematics::new(&h).second_invariant / (4.0 * exact) - 1.0).abs() < 1e-8);
    }
}
