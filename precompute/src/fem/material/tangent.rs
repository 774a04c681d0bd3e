//! The elasticity A = dP/dF in the form that the assembly uses.

use crate::num::lanes::Real;
use crate::num::tensor::{Mat3, Vec3};

/// The elasticity A = dP/dF, stored as the few numbers that define a block g_a . A . g_b.
///
/// With x_a = F g_a and m = F (g_a x g_b), in the order of the terms of A in [`super`]:
///
/// g_a . A . g_b = forward x_a x_b^T + crosswise x_b x_a^T + left (g_a . g_b) + determinant e_ijk m_k
///   + [ isotropic (g_a . g_b) + stretch (x_a . x_b) + along_fibre (a . g_a)(a . g_b) ] I
///   + sum_mn f_mn (I_m' g_a) (I_n' g_b)^T
///
/// Every law of [`super::OfInvariants`] has an elasticity of this form.
#[derive(Debug, Clone, Copy)]
pub struct Tangent<R = f64> {
    /// F in x_a = F g_a and m; the identity for a law of small strain.
    pub map: Mat3<R>,
    /// Factor of x_a x_b^T, Pa.
    pub forward: R,
    /// Factor of x_b x_a^T, Pa.
    pub crosswise: R,
    /// Matrix multiplied by g_a . g_b, Pa.
    pub left: Mat3<R>,
    /// Factor of (x_a . x_b) I, Pa.
    pub stretch: R,
    /// Factor of (g_a . g_b) I, Pa.
    pub isotropic: R,
    /// Factor of e_ijk m_k, Pa: the derivative of W with respect to J.
    pub determinant: R,
    /// Fibre direction a.
    pub fibre: Vec3<R>,
    /// Factor of (a . g_a)(a . g_b) I, Pa.
    pub along_fibre: R,
    /// f_mn, Pa, symmetric.
    pub second: [[R; 4]; 4],
    /// I_m' = dI_m/dF.
    pub slopes: [Mat3<R>; 4],
    /// Nonzero rows of `second`; the others are not read. The same for every deformation.
    pub rows: [bool; 4],
}

/// The data of one shape function for the blocks of a [`Tangent`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct TangentNode<R = f64> {
    gradient: Vec3<R>,
    mapped: Vec3<R>,
    along: R,
    /// I_m' g and sum_n f_mn I_n' g.
    slopes: [Vec3<R>; 4],
    weighted: [Vec3<R>; 4],
}

impl<R: Real> Tangent<R> {
    /// Zero elasticity, with F the identity; `like` is any number.
    #[inline(always)]
    pub fn zero(like: R) -> Self {
        let zero = like.constant(0.0);
        Self {
            map: Mat3::identity(zero),
            forward: zero,
            crosswise: zero,
            left: Mat3::zeros(zero),
            stretch: zero,
            isotropic: zero,
            determinant: zero,
            fibre: Vec3::constant(zero, [0.0; 3]),
            along_fibre: zero,
            second: [[zero; 4]; 4],
            slopes: [Mat3::zeros(zero); 4],
            rows: [false; 4],
        }
    }

    /// The elasticity with the lanes `value(lane)`; `like` is any number.
    pub(super) fn from_lanes<'t>(like: R, value: impl Fn(usize) -> &'t Tangent) -> Self {
        let number = |of: &dyn Fn(&Tangent) -> f64| like.with_lanes(|lane| of(value(lane)));
        Self {
            map: Mat3::from_lanes(like, |lane| &value(lane).map),
            forward: number(&|t| t.forward),
            crosswise: number(&|t| t.crosswise),
            left: Mat3::from_lanes(like, |lane| &value(lane).left),
            stretch: number(&|t| t.stretch),
            isotropic: number(&|t| t.isotropic),
            determinant: number(&|t| t.determinant),
            fibre: Vec3([0, 1, 2].map(|i| number(&|t| t.fibre.0[i]))),
            along_fibre: number(&|t| t.along_fibre),
            second: [0, 1, 2, 3].map(|m| [0, 1, 2, 3].map(|n| number(&|t| t.second[m][n]))),
            slopes: [0, 1, 2, 3].map(|m| Mat3::from_lanes(like, |lane| &value(lane).slopes[m])),
            rows: value(0).rows,
        }
    }

    /// Prepares the gradient of one shape function.
    #[inline(always)]
    pub(crate) fn node(&self, gradient: Vec3<R>) -> TangentNode<R> {
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

    /// Blocks (k, l), l <= k, of four gradients. The loop is unrolled by hand. With indices known at compile
    /// time the nodes (1 kB each) are not copied to an indexable array, which saves a tenth of the time.
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
    pub(crate) fn block(&self, a: &TangentNode<R>, b: &TangentNode<R>) -> [R; 9] {
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
