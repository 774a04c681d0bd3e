//! The elasticity A = dP/dF in the form the assembly takes it.

use crate::num::lanes::Real;
use crate::num::tensor::{Mat3, Vec3};

/// The elasticity A = dP/dF, kept as the few numbers from which a block g_a . A . g_b is made.
///
/// With x_a = F g_a and m = F (g_a x g_b), term by term of the A of [`super`]:
///
/// g_a . A . g_b = forward x_a x_b^T + crosswise x_b x_a^T + left (g_a . g_b) + determinant e_ijk m_k
///   + [ isotropic (g_a . g_b) + stretch (x_a . x_b) + along_fibre (a . g_a)(a . g_b) ] I
///   + sum_mn f_mn (I_m' g_a) (I_n' g_b)^T
#[derive(Debug, Clone, Copy)]
pub struct Tangent<R = f64> {
    pub(super) map: Mat3<R>,
    pub(super) forward: R,
    pub(super) crosswise: R,
    pub(super) left: Mat3<R>,
    pub(super) stretch: R,
    pub(super) isotropic: R,
    pub(super) determinant: R,
    pub(super) fibre: Vec3<R>,
    pub(super) along_fibre: R,
    pub(super) second: [[R; 4]; 4],
    pub(super) slopes: [Mat3<R>; 4],
    /// Rows of `second` that are not zero.
    pub(super) rows: [bool; 4],
}

/// What a [`Tangent`] needs of one shape function.
#[derive(Debug, Clone, Copy)]
pub struct TangentNode<R = f64> {
    gradient: Vec3<R>,
    mapped: Vec3<R>,
    along: R,
    /// I_m' g and sum_n f_mn I_n' g.
    slopes: [Vec3<R>; 4],
    weighted: [Vec3<R>; 4],
}

impl<R: Real> Tangent<R> {
    /// Prepares the gradient of one shape function.
    #[inline(always)]
    pub fn node(&self, gradient: Vec3<R>) -> TangentNode<R> {
        let zero = Vec3::constant(self.forward, [0.0; 3]);
        let mut node = TangentNode {
            gradient,
            mapped: self.map * gradient,
            along: self.fibre.dot(gradient),
            slopes: [zero; 4],
            weighted: [zero; 4],
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

    /// Blocks (k, l), l <= k, of four gradients. Written out: with indices known at compile time the nodes, a kilobyte each,
    /// need not be copied to where a loop could index them (a tenth of the time).
    #[inline(always)]
    pub(crate) fn blocks(&self, gradients: &[Vec3<R>; 4], mut put: impl FnMut(usize, usize, [R; 9])) {
        let [a, b, c, d] = *gradients;
        let a = self.node(a);
        put(0, 0, self.block(&a, &a));
        let b = self.node(b);
        put(1, 0, self.block(&b, &a));
        put(1, 1, self.block(&b, &b));
        let c = self.node(c);
        put(2, 0, self.block(&c, &a));
        put(2, 1, self.block(&c, &b));
        put(2, 2, self.block(&c, &c));
        let d = self.node(d);
        put(3, 0, self.block(&d, &a));
        put(3, 1, self.block(&d, &b));
        put(3, 2, self.block(&d, &c));
        put(3, 3, self.block(&d, &d));
    }

    /// The block g_a . A . g_b, row-major.
    #[inline(always)]
    pub fn block(&self, a: &TangentNode<R>, b: &TangentNode<R>) -> [R; 9] {
        let (x, y) = (a.mapped.0, b.mapped.0);
        let gradients = a.gradient.dot(b.gradient);
        let m = (self.map * a.gradient.cross(b.gradient) * self.determinant).0;
        let zero = self.forward.constant(0.0);
        let mut block = [zero, m[2], -m[1], -m[2], zero, m[0], m[1], -m[0], zero];
        for i in 0..3 {
            for j in 0..3 {
                block[3 * i + j] += self.forward * x[i] * y[j]
                    + self.crosswise * y[i] * x[j]
                    + self.left.at(i, j) * gradients;
            }
        }
        let diagonal = self.isotropic * gradients
            + self.stretch * a.mapped.dot(b.mapped)
            + self.along_fibre * a.along * b.along;
        for i in 0..3 {
            block[4 * i] += diagonal;
        }
        for k in 0..4 {
            if self.rows[k] {
                let (left, right) = (a.slopes[k].0, b.weighted[k].0);
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
