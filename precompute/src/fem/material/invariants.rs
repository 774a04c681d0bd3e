//! Laws of invariants, W = f(I1, I2, J, I4): the trait for their derivatives, and the chain rule from the
//! derivatives of f to those of W.

use super::{Describe, Law, Tangent};
use crate::fem::kinematics::{Kinematics, mixed_cofactor};
use crate::num::jet::{SECOND_INDICES, THIRD_INDICES};
use crate::num::lanes::Real;
use crate::num::tensor::{Mat3, Vec3};

/// Position of I1 = tr C in [`Derivatives`] and [`Third`].
pub const I1: usize = 0;
/// Position of I2 = cof F : cof F.
pub const I2: usize = 1;
/// Position of J = det F.
pub const J: usize = 2;
/// Position of I4 = |F a|^2, a the fibre direction.
pub const I4: usize = 3;

/// Invariants of the deformation minus their values at rest.
#[derive(Debug, Clone, Copy)]
pub struct Invariants<R> {
    /// I1 - 3.
    pub i1: R,
    /// I2 - 3.
    pub i2: R,
    /// J - 1.
    pub j: R,
    /// I4 - 1; 0 for a law without fibres.
    pub i4: R,
}

/// f and its first and second derivatives with respect to (I1, I2, J, I4), Pa.
#[derive(Debug, Clone, Copy)]
pub struct Derivatives<R> {
    /// f, J/m^3, zero at rest.
    pub energy: R,
    /// First derivatives, by position.
    pub first: [R; 4],
    /// Second derivatives by two positions, symmetric.
    pub second: [[R; 4]; 4],
}

impl<R: Real> Derivatives<R> {
    /// f with all derivatives zero.
    #[inline(always)]
    pub fn of_energy(energy: R) -> Self {
        let zero = energy.constant(0.0);
        Self { energy, first: [zero; 4], second: [[zero; 4]; 4] }
    }
}

/// Third derivatives of f by three positions, Pa. Only the entries with m <= n <= o are read.
pub type Third<R> = [[[R; 4]; 4]; 4];

/// Third derivatives that are all zero; `like` is any number.
#[inline(always)]
pub fn no_third<R: Real>(like: R) -> Third<R> {
    [[[like.constant(0.0); 4]; 4]; 4]
}

/// A law that is a function f of invariants. Every such law is a [`Law`].
///
/// At rest f and its stress are zero: 2 f1 + 4 f2 + fJ = 0 and f4 = 0. A law with a pressure has the term
/// -p0 (J - 1) in f, with p0 its [`Describe::rest_pressure_pa`]. The solver adds the excess pressure. The
/// constants declare which terms are always zero, so that the compiler omits their products.
/// `precompute/examples/own_law.rs` is such a law from outside this crate, and [`super::check`] tests one.
pub trait OfInvariants: Describe {
    /// Invariants in which f has second derivatives, by position. Only these entries of
    /// [`Derivatives::second`] are read.
    const CURVED: [bool; 4] = [false; 4];
    /// Whether f has third derivatives.
    const THIRD: bool = false;
    /// Whether f depends on I2.
    const SECOND_INVARIANT: bool = true;
    /// Whether f depends on I4.
    const FIBRES: bool = false;

    /// f and its first and second derivatives.
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R>;

    /// Third derivatives of f.
    #[inline(always)]
    fn third<R: Real>(&self, at: &Invariants<R>) -> Third<R> {
        no_third(at.j)
    }

    /// Fibre direction, a unit vector of the undeformed body.
    #[inline(always)]
    fn fibre(&self) -> [f64; 3] {
        [0.0; 3]
    }
}

/// The fibre direction as vectors of the same width as `k`.
#[inline(always)]
fn fibre<R: Real, L: OfInvariants>(law: &L, k: &Kinematics<R>) -> Vec3<R> {
    Vec3::constant(k.volume_change, law.fibre())
}

#[inline(always)]
fn invariants<R: Real, L: OfInvariants>(law: &L, k: &Kinematics<R>) -> Invariants<R> {
    let i4 = if L::FIBRES {
        // |a + H a|^2 - 1 without cancellation.
        let a = fibre(law, k);
        let stretch = k.displacement_gradient * a;
        stretch.dot(a) * 2.0 + stretch.dot(stretch)
    } else {
        k.volume_change.constant(0.0)
    };
    Invariants { i1: k.first_invariant, i2: k.second_invariant, j: k.volume_change, i4 }
}

/// First Piola stress from the derivatives of f; `f_j` is fJ minus the excess pressure.
#[inline(always)]
fn stress_of<R: Real, L: OfInvariants>(law: &L, k: &Kinematics<R>, [f1, f2, f_j, f4]: [R; 4]) -> Mat3<R> {
    let f = k.deformation_gradient;
    let mut stress = k.cofactor * f_j + f * (f1 * 2.0);
    if L::SECOND_INVARIANT {
        stress += second_invariant_slope(k) * f2;
    }
    if L::FIBRES {
        let a = fibre(law, k);
        stress += (f * a).outer(a) * (f4 * 2.0);
    }
    stress
}

impl<L: OfInvariants> Law for L {
    #[inline(always)]
    fn stress<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>) {
        let d = self.derivatives(&invariants(self, k));
        let [f1, f2, f_j, f4] = d.first;
        (d.energy - q_pa * k.volume_change, stress_of(self, k, [f1, f2, f_j - q_pa, f4]))
    }

    #[inline(always)]
    fn response<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>, Tangent<R>) {
        let d = self.derivatives(&invariants(self, k));
        let [f1, f2, f_j, f4] = d.first;
        let f_j = f_j - q_pa;
        let f = k.deformation_gradient;
        let a = fibre(self, k);
        let (zero, two) = (q_pa.constant(0.0), q_pa.constant(2.0));
        let mut tangent = Tangent {
            map: f,
            forward: zero,
            crosswise: zero,
            left: Mat3::zeros(zero),
            stretch: zero,
            isotropic: f1 * 2.0,
            determinant: f_j,
            fibre: a,
            along_fibre: f4 * 2.0,
            second: d.second,
            slopes: [f * two, second_invariant_slope(k), k.cofactor, (f * a * two).outer(a)],
            rows: L::CURVED,
        };
        if L::SECOND_INVARIANT {
            tangent.forward = f2 * 4.0;
            tangent.crosswise = f2 * -2.0;
            tangent.left = f * f.transpose() * (f2 * -2.0);
            tangent.stretch = f2 * -2.0;
            tangent.isotropic += f2 * 2.0 * (k.first_invariant + 3.0);
        }
        (d.energy - q_pa * k.volume_change, stress_of(self, k, [f1, f2, f_j, f4]), tangent)
    }

    /// With `I[i]`, `I[ij]`, `I[ijk]` the derivatives of an invariant along the directions G_i,
    ///
    /// `D3 W = sum_m f_m I_m[ijk] + sum_mn f_mn (I_m[ij] I_n[k] + 2 permutations)`
    /// `+ sum_mno f_mno I_m[i] I_n[j] I_o[k]`,
    ///
    /// and the multiplier adds `- q J[ijk] - (q_i J[jk] + 2 permutations)`.
    #[inline(always)]
    fn third_along<R: Real>(
        &self,
        k: &Kinematics<R>,
        q_pa: R,
        gradients: &[Mat3<R>; 3],
        dq_pa: &[R; 3],
    ) -> [R; 10] {
        let zero = q_pa.constant(0.0);
        let at = invariants(self, k);
        let d = self.derivatives(&at);
        let along = InvariantsAlong::new::<L>(k, gradients, fibre(self, k));
        // sum_n f_mn I_n[p]: the same for every pair of the other two directions.
        let mut weighted = [[zero; 4]; 3];
        for p in 0..3 {
            for m in 0..4 {
                for n in 0..4 {
                    if L::CURVED[m] && L::CURVED[n] {
                        weighted[p][m] += d.second[m][n] * along.linear[p][n];
                    }
                }
            }
            weighted[p][J] -= dq_pa[p];
        }
        let third = self.third(&at);
        let mut result = [zero; 10];
        for (value, [i, j, l]) in result.iter_mut().zip(THIRD_INDICES) {
            let cubic = along.cubic::<L>(i, j, l);
            let mut sum = (d.first[J] - q_pa) * cubic[J];
            if L::SECOND_INVARIANT {
                sum += d.first[I2] * cubic[I2];
            }
            for (p, [a, b]) in [(i, [j, l]), (j, [i, l]), (l, [i, j])] {
                let square = along.square(a, b);
                for m in 0..4 {
                    if L::CURVED[m] || m == J {
                        sum += weighted[p][m] * square[m];
                    }
                }
            }
            if L::THIRD {
                for m in 0..4 {
                    for n in 0..4 {
                        for o in 0..4 {
                            if L::CURVED[m] && L::CURVED[n] && L::CURVED[o] {
                                let (low, high) = (m.min(n).min(o), m.max(n).max(o));
                                let f_mno = third[low][m + n + o - low - high][high];
                                sum += f_mno * along.linear[i][m] * along.linear[j][n] * along.linear[l][o];
                            }
                        }
                    }
                }
            }
            *value = sum;
        }
        result
    }
}

/// dI2/dF = 2 (I1 F - F F^T F).
#[inline(always)]
fn second_invariant_slope<R: Real>(k: &Kinematics<R>) -> Mat3<R> {
    let f = k.deformation_gradient;
    (f * (k.first_invariant + 3.0) - f * (f.transpose() * f)) * k.first_invariant.constant(2.0)
}

/// Derivatives of the four invariants along three directions of F.
struct InvariantsAlong<R> {
    /// By direction and invariant.
    linear: [[R; 4]; 3],
    /// By pair of directions, in the order of [`SECOND_INDICES`], and invariant.
    squares: [[R; 4]; 6],
    directions: [Mat3<R>; 3],
    /// Derivatives of cof F along one direction; those along two directions follow.
    cofactor_slopes: [Mat3<R>; 3],
    cofactor_curvatures: [Mat3<R>; 6],
}

/// Position of a pair of directions in [`SECOND_INDICES`].
#[inline(always)]
fn pair(i: usize, j: usize) -> usize {
    let (low, high) = if i <= j { (i, j) } else { (j, i) };
    [0, 2, 3][low] + high
}

impl<R: Real> InvariantsAlong<R> {
    #[inline(always)]
    fn new<L: OfInvariants>(k: &Kinematics<R>, directions: &[Mat3<R>; 3], fibre: Vec3<R>) -> Self {
        let f = k.deformation_gradient;
        let zero = k.volume_change.constant(0.0);
        let nothing = Mat3::zeros(zero);
        let mut along = Self {
            linear: [[zero; 4]; 3],
            squares: [[zero; 4]; 6],
            directions: *directions,
            cofactor_slopes: [nothing; 3],
            cofactor_curvatures: [nothing; 6],
        };
        let fibre_now = f * fibre;
        for (i, &direction) in directions.iter().enumerate() {
            let slope = mixed_cofactor(f, direction);
            along.cofactor_slopes[i] = slope;
            let linear = &mut along.linear[i];
            if L::CURVED[I1] {
                linear[I1] = f.dot(direction) * 2.0;
            }
            if L::CURVED[I2] {
                linear[I2] = k.cofactor.dot(slope) * 2.0;
            }
            if L::CURVED[J] {
                linear[J] = k.cofactor.dot(direction);
            }
            if L::CURVED[I4] {
                linear[I4] = fibre_now.dot(direction * fibre) * 2.0;
            }
        }
        for (p, [i, j]) in SECOND_INDICES.into_iter().enumerate() {
            let (a, b) = (directions[i], directions[j]);
            let curvature = mixed_cofactor(a, b);
            along.cofactor_curvatures[p] = curvature;
            let slopes = &along.cofactor_slopes;
            let square = &mut along.squares[p];
            if L::CURVED[I1] {
                square[I1] = a.dot(b) * 2.0;
            }
            if L::CURVED[I2] {
                square[I2] = (slopes[i].dot(slopes[j]) + k.cofactor.dot(curvature)) * 2.0;
            }
            square[J] = slopes[i].dot(b);
            if L::CURVED[I4] {
                square[I4] = (a * fibre).dot(b * fibre) * 2.0;
            }
        }
        along
    }

    #[inline(always)]
    fn square(&self, i: usize, j: usize) -> &[R; 4] {
        &self.squares[pair(i, j)]
    }

    /// Third derivatives. Those of I1 and I4 are zero, because these are quadratic in F.
    #[inline(always)]
    fn cubic<L: OfInvariants>(&self, i: usize, j: usize, l: usize) -> [R; 4] {
        let (slope, curvature) = (&self.cofactor_slopes, &self.cofactor_curvatures);
        let zero = self.linear[0][0].constant(0.0);
        let second = if L::SECOND_INVARIANT {
            slope[i].dot(curvature[pair(j, l)])
                + slope[j].dot(curvature[pair(i, l)])
                + slope[l].dot(curvature[pair(i, j)])
        } else {
            zero
        };
        [zero, second * 2.0, curvature[pair(i, j)].dot(self.directions[l]), zero]
    }
}
