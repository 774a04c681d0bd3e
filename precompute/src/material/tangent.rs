//! The elasticity A = dP/dF in the form the assembly takes it.

use nalgebra::{Matrix3, Vector3};

/// The elasticity A = dP/dF, kept as the few numbers from which a block g_a . A . g_b is made.
///
/// With x_a = F g_a and m = F (g_a x g_b), term by term of the A of [`super`]:
///
/// g_a . A . g_b = forward x_a x_b^T + crosswise x_b x_a^T + left (g_a . g_b) + determinant e_ijk m_k
///   + [ isotropic (g_a . g_b) + stretch (x_a . x_b) + along_fibre (a . g_a)(a . g_b) ] I
///   + sum_mn f_mn (I_m' g_a) (I_n' g_b)^T
#[derive(Debug, Clone, Copy)]
pub struct Tangent {
    pub(super) map: Matrix3<f64>,
    pub(super) forward: f64,
    pub(super) crosswise: f64,
    pub(super) left: Matrix3<f64>,
    pub(super) stretch: f64,
    pub(super) isotropic: f64,
    pub(super) determinant: f64,
    pub(super) fibre: Vector3<f64>,
    pub(super) along_fibre: f64,
    pub(super) second: [[f64; 4]; 4],
    pub(super) slopes: [Matrix3<f64>; 4],
    /// Rows of `second` that are not zero.
    pub(super) rows: [bool; 4],
}

/// What a [`Tangent`] needs of one shape function.
#[derive(Debug, Clone, Copy)]
pub struct TangentNode {
    gradient: Vector3<f64>,
    mapped: Vector3<f64>,
    along: f64,
    /// I_m' g and sum_n f_mn I_n' g.
    slopes: [Vector3<f64>; 4],
    weighted: [Vector3<f64>; 4],
}

impl Tangent {
    /// Prepares the gradient of one shape function.
    #[inline(always)]
    pub fn node(&self, gradient: &Vector3<f64>) -> TangentNode {
        let mut node = TangentNode {
            gradient: *gradient,
            mapped: self.map * gradient,
            along: self.fibre.dot(gradient),
            slopes: [Vector3::zeros(); 4],
            weighted: [Vector3::zeros(); 4],
        };
        for m in 0..4 {
            if self.rows[m] {
                node.slopes[m] = self.slopes[m] * gradient;
            }
        }
        for m in 0..4 {
            for n in 0..4 {
                if self.rows[m] && self.rows[n] {
                    node.weighted[m] += node.slopes[n] * self.second[m][n];
                }
            }
        }
        node
    }

    /// The block g_a . A . g_b, row-major.
    #[inline(always)]
    pub fn block(&self, a: &TangentNode, b: &TangentNode) -> [f64; 9] {
        let (x, y) = (&a.mapped, &b.mapped);
        let gradients = a.gradient.dot(&b.gradient);
        let m = self.map * a.gradient.cross(&b.gradient) * self.determinant;
        let mut block = [0.0, m[2], -m[1], -m[2], 0.0, m[0], m[1], -m[0], 0.0];
        for i in 0..3 {
            for j in 0..3 {
                block[3 * i + j] +=
                    self.forward * x[i] * y[j] + self.crosswise * y[i] * x[j] + self.left[(i, j)] * gradients;
            }
        }
        let diagonal =
            self.isotropic * gradients + self.stretch * x.dot(y) + self.along_fibre * a.along * b.along;
        for i in 0..3 {
            block[4 * i] += diagonal;
        }
        for k in 0..4 {
            if self.rows[k] {
                let (left, right) = (&a.slopes[k], &b.weighted[k]);
                for i in 0..3 {
                    for j in 0..3 {
                        block[3 * i + j] += left[i] * right[j];
                    }
                }
            }
        }
        block
    }
}
