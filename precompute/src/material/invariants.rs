//! The chain rule from the derivatives of f(I1, I2, J, I4) to those of W.

use nalgebra::{Matrix3, Vector3};

use super::{Law, SymmetricThird, THIRD_INDICES, Tangent};
use crate::kinematics::{Kinematics, mixed_cofactor};

/// Positions of the invariants in [`Derivatives`].
pub(super) const I1: usize = 0;
pub(super) const I2: usize = 1;
pub(super) const J: usize = 2;
pub(super) const I4: usize = 3;

/// Invariants of the deformation less their values at rest.
#[derive(Debug, Clone, Copy, Default)]
pub struct Invariants {
    /// I1 - 3.
    pub i1: f64,
    /// I2 - 3.
    pub i2: f64,
    /// J - 1.
    pub j: f64,
    /// I4 - 1; 0 for a law without fibres.
    pub i4: f64,
}

/// Value of f and its first and second derivatives by (I1, I2, J, I4), Pa.
#[derive(Debug, Clone, Copy, Default)]
pub struct Derivatives {
    /// f, J/m^3, zero at rest.
    pub energy: f64,
    /// First derivatives.
    pub first: [f64; 4],
    /// Second derivatives, symmetric.
    pub second: [[f64; 4]; 4],
}

/// Third derivatives of f; only the upper part m <= n <= o is read.
pub(super) type Third = [[[f64; 4]; 4]; 4];

/// A law that is a function of invariants. What is constantly zero in it is said in its constants, so that the compiler leaves out
/// whatever would be multiplied by it.
pub trait OfInvariants {
    /// Invariants in which f has second derivatives.
    const CURVED: [bool; 4] = [false; 4];
    /// Whether f has third derivatives.
    const THIRD: bool = false;
    /// Whether f depends on I2.
    const SECOND_INVARIANT: bool = true;
    /// Whether f depends on I4.
    const FIBRES: bool = false;

    /// Derivatives of f.
    fn derivatives(&self, at: &Invariants) -> Derivatives;

    /// Third derivatives of f.
    #[inline(always)]
    fn third(&self, _at: &Invariants) -> Third {
        Third::default()
    }

    /// Fibre direction, a unit vector of the undeformed body.
    #[inline(always)]
    fn fibre(&self) -> Vector3<f64> {
        Vector3::zeros()
    }
}

#[inline(always)]
fn invariants<L: OfInvariants>(law: &L, k: &Kinematics) -> Invariants {
    let i4 = if L::FIBRES {
        // |a + H a|^2 - 1 without cancellation.
        let a = law.fibre();
        let stretch = k.displacement_gradient * a;
        2.0 * stretch.dot(&a) + stretch.norm_squared()
    } else {
        0.0
    };
    Invariants { i1: k.first_invariant, i2: k.second_invariant, j: k.volume_change, i4 }
}

/// P of the derivatives of f, with fJ less the excess pressure.
#[inline(always)]
fn stress_of<L: OfInvariants>(law: &L, k: &Kinematics, [f1, f2, f_j, f4]: [f64; 4]) -> Matrix3<f64> {
    let f = &k.deformation_gradient;
    let mut stress = k.cofactor * f_j + f * (2.0 * f1);
    if L::SECOND_INVARIANT {
        stress += second_invariant_slope(k) * f2;
    }
    if L::FIBRES {
        let a = law.fibre();
        stress += f * a * a.transpose() * (2.0 * f4);
    }
    stress
}

impl<L: OfInvariants> Law for L {
    #[inline(always)]
    fn stress(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>) {
        let d = self.derivatives(&invariants(self, k));
        let [f1, f2, f_j, f4] = d.first;
        (d.energy - q_pa * k.volume_change, stress_of(self, k, [f1, f2, f_j - q_pa, f4]))
    }

    #[inline(always)]
    fn response(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>, Tangent) {
        let d = self.derivatives(&invariants(self, k));
        let [f1, f2, f_j, f4] = d.first;
        let f_j = f_j - q_pa;
        let f = &k.deformation_gradient;
        let a = self.fibre();
        let mut tangent = Tangent {
            map: *f,
            forward: 0.0,
            crosswise: 0.0,
            left: Matrix3::zeros(),
            stretch: 0.0,
            isotropic: 2.0 * f1,
            determinant: f_j,
            fibre: a,
            along_fibre: 2.0 * f4,
            second: d.second,
            slopes: [2.0 * f, second_invariant_slope(k), k.cofactor, 2.0 * (f * a) * a.transpose()],
            rows: L::CURVED,
        };
        if L::SECOND_INVARIANT {
            tangent.forward = 4.0 * f2;
            tangent.crosswise = -2.0 * f2;
            tangent.left = f * f.transpose() * (-2.0 * f2);
            tangent.stretch = -2.0 * f2;
            tangent.isotropic += 2.0 * f2 * (k.first_invariant + 3.0);
        }
        (d.energy - q_pa * k.volume_change, stress_of(self, k, [f1, f2, f_j, f4]), tangent)
    }

    /// With `I[i]`, `I[ij]`, `I[ijk]` the derivatives of an invariant along the directions G_i,
    ///
    /// `D3 W = sum_m f_m I_m[ijk] + sum_mn f_mn (I_m[ij] I_n[k] + 2 permutations) + sum_mno f_mno I_m[i] I_n[j] I_o[k]`,
    ///
    /// and the multiplier adds `- q J[ijk] - (q_i J[jk] + 2 permutations)`.
    #[inline(always)]
    fn third_along(
        &self,
        k: &Kinematics,
        q_pa: f64,
        gradients: &[Matrix3<f64>; 3],
        dq_pa: &[f64; 3],
    ) -> SymmetricThird {
        let at = invariants(self, k);
        let d = self.derivatives(&at);
        let along = InvariantsAlong::new::<L>(k, gradients, &self.fibre());
        // sum_n f_mn I_n[p]: the same for every pair of the other two directions.
        let weighted: [[f64; 4]; 3] = std::array::from_fn(|p| {
            let mut row = [0.0; 4];
            for m in 0..4 {
                for n in 0..4 {
                    if L::CURVED[m] && L::CURVED[n] {
                        row[m] += d.second[m][n] * along.linear[p][n];
                    }
                }
            }
            row[J] -= dq_pa[p];
            row
        });
        let third = self.third(&at);
        let mut result = [0.0; 10];
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
                                let mut sorted = [m, n, o];
                                sorted.sort_unstable();
                                let f_mno = third[sorted[0]][sorted[1]][sorted[2]];
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
fn second_invariant_slope(k: &Kinematics) -> Matrix3<f64> {
    let f = &k.deformation_gradient;
    (f * (k.first_invariant + 3.0) - f * (f.transpose() * f)) * 2.0
}

/// Derivatives of the four invariants along three directions of F.
struct InvariantsAlong {
    /// [direction][invariant].
    linear: [[f64; 4]; 3],
    /// [pair of directions][invariant], pairs in the order 00 01 02 11 12 22.
    squares: [[f64; 4]; 6],
    directions: [Matrix3<f64>; 3],
    /// Derivatives of cof F along one direction, and along two.
    cofactor_slopes: [Matrix3<f64>; 3],
    cofactor_curvatures: [Matrix3<f64>; 6],
}

const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// Position of a pair of directions in [`PAIRS`].
#[inline(always)]
fn pair(i: usize, j: usize) -> usize {
    let (low, high) = if i <= j { (i, j) } else { (j, i) };
    [0, 2, 3][low] + high
}

impl InvariantsAlong {
    #[inline(always)]
    fn new<L: OfInvariants>(k: &Kinematics, directions: &[Matrix3<f64>; 3], fibre: &Vector3<f64>) -> Self {
        let f = &k.deformation_gradient;
        let stretched = directions.map(|g| g * fibre);
        let fibre_now = f * fibre;
        let cofactor_slopes = directions.map(|g| mixed_cofactor(f, &g));
        let cofactor_curvatures = PAIRS.map(|(i, j)| mixed_cofactor(&directions[i], &directions[j]));
        let needed =
            |invariant: usize, value: &dyn Fn() -> f64| if L::CURVED[invariant] { value() } else { 0.0 };
        let linear = std::array::from_fn(|i| {
            [
                needed(I1, &|| 2.0 * f.dot(&directions[i])),
                needed(I2, &|| 2.0 * k.cofactor.dot(&cofactor_slopes[i])),
                needed(J, &|| k.cofactor.dot(&directions[i])),
                needed(I4, &|| 2.0 * fibre_now.dot(&stretched[i])),
            ]
        });
        let squares = std::array::from_fn(|p| {
            let (i, j) = PAIRS[p];
            [
                needed(I1, &|| 2.0 * directions[i].dot(&directions[j])),
                needed(I2, &|| {
                    let bent = k.cofactor.dot(&cofactor_curvatures[p]);
                    2.0 * (cofactor_slopes[i].dot(&cofactor_slopes[j]) + bent)
                }),
                cofactor_slopes[i].dot(&directions[j]),
                needed(I4, &|| 2.0 * stretched[i].dot(&stretched[j])),
            ]
        });
        Self { linear, squares, directions: *directions, cofactor_slopes, cofactor_curvatures }
    }

    #[inline(always)]
    fn square(&self, i: usize, j: usize) -> &[f64; 4] {
        &self.squares[pair(i, j)]
    }

    /// Third derivatives; I1 and I4 are quadratic in F and have none.
    #[inline(always)]
    fn cubic<L: OfInvariants>(&self, i: usize, j: usize, l: usize) -> [f64; 4] {
        let curvature = |a, b| &self.cofactor_curvatures[pair(a, b)];
        let slope = &self.cofactor_slopes;
        let second = if L::SECOND_INVARIANT {
            slope[i].dot(curvature(j, l)) + slope[j].dot(curvature(i, l)) + slope[l].dot(curvature(i, j))
        } else {
            0.0
        };
        [0.0, 2.0 * second, curvature(i, j).dot(&self.directions[l]), 0.0]
    }
}
