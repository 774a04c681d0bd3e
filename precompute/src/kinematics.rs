//! Kinematics of a material point: F, J and the Green-St. Venant strain, from the displacement gradient H.
//!
//! Everything is written in H = F - I rather than in F, so that small strains do not drown in the rounding of
//! 1 + H: at 1 um of touch the strain is 1e-5 and its square still has eleven digits.

use nalgebra::{Matrix3, Vector3};

/// Deformation of one material point.
#[derive(Debug, Clone, Copy)]
pub struct Kinematics {
    /// Deformation gradient F = I + H.
    pub deformation_gradient: Matrix3<f64>,
    /// Green-St. Venant strain gamma = (H + H^T + H^T H) / 2 (paper, Eq. 1).
    pub green_strain: Matrix3<f64>,
    /// Cofactor matrix cof F = J F^-T = dJ/dF, defined for J <= 0 too (no division).
    pub cofactor: Matrix3<f64>,
    /// J - 1 = tr H + (second invariant of H) + det H, without cancellation.
    pub volume_change: f64,
}

impl Kinematics {
    /// Kinematics of the displacement gradient `h` = du/dX.
    #[inline]
    pub fn new(h: &Matrix3<f64>) -> Self {
        let f = h + Matrix3::identity();
        let green_strain = 0.5 * (h + h.transpose() + h.transpose() * h);
        let second_invariant = h[(0, 0)] * h[(1, 1)] - h[(0, 1)] * h[(1, 0)] + h[(1, 1)] * h[(2, 2)]
            - h[(1, 2)] * h[(2, 1)]
            + h[(0, 0)] * h[(2, 2)]
            - h[(0, 2)] * h[(2, 0)];
        let volume_change = h.trace() + second_invariant + h.determinant();
        Self { deformation_gradient: f, green_strain, cofactor: cofactor(&f), volume_change }
    }

    /// Jacobian J = det F.
    #[inline]
    pub fn jacobian(&self) -> f64 {
        1.0 + self.volume_change
    }
}

/// Cofactor matrix: its columns are the cross products of the columns of `f`.
#[inline]
fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let [c0, c1, c2] = [0, 1, 2].map(|k| Vector3::from(f.column(k)));
    Matrix3::from_columns(&[c1.cross(&c2), c2.cross(&c0), c0.cross(&c1)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Matrix3<f64> {
        Matrix3::new(0.2, -0.3, 0.1, 0.05, -0.4, 0.25, 0.3, 0.15, 0.1)
    }

    #[test]
    fn the_cofactor_is_the_derivative_of_j() {
        let h = sample();
        let k = Kinematics::new(&h);
        assert!((k.jacobian() - (h + Matrix3::identity()).determinant()).abs() < 1e-15);
        let step = 1e-6;
        for i in 0..3 {
            for j in 0..3 {
                let mut plus = h;
                let mut minus = h;
                plus[(i, j)] += step;
                minus[(i, j)] -= step;
                let slope = (Kinematics::new(&plus).volume_change - Kinematics::new(&minus).volume_change)
                    / (2.0 * step);
                assert!((slope - k.cofactor[(i, j)]).abs() < 1e-9, "dJ/dF[{i},{j}]");
            }
        }
    }

    #[test]
    fn a_rotation_has_no_strain() {
        let turn = *nalgebra::Rotation3::from_euler_angles(0.7, -1.1, 2.0).matrix();
        let k = Kinematics::new(&(turn - Matrix3::identity()));
        assert!(k.green_strain.norm() < 1e-15);
        assert!(k.volume_change.abs() < 1e-15);
    }

    #[test]
    fn tiny_strains_keep_their_digits() {
        let h = sample() * 1e-9;
        let exact = h.trace();
        assert!((Kinematics::new(&h).volume_change / exact - 1.0).abs() < 1e-8);
    }
}
