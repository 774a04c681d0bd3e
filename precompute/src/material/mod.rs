//! Hyperelastic laws: strain energy density W, stress, material tangent, and the third derivative along given directions.
//!
//! Every law but the linear one is a function of invariants,
//!
//! W = f(I1, I2, J, I4),   I1 = tr C,  I2 = cof F : cof F,  J = det F,  I4 = |F a|^2,
//!
//! and has its own file with f, its derivatives, the second Piola stress and the material tangent they make. This file
//! turns derivatives of f into those of W by the chain rule:
//!
//! - second Piola stress S = dW/dgamma = 2 f1 I + 2 f2 (I1 I - C) + fJ J C^-1 + 2 f4 a (x) a,
//! - material tangent dS/dgamma = sum_mn f_mn (dI_m/dgamma) (x) (dI_n/dgamma) + 4 f2 (I (x) I - Is)
//!   + fJ J (C^-1 (x) C^-1 - 2 C^-1 o C^-1), Is the symmetric identity, o the symmetrised product;
//!
//! the assembly takes them in their F form, first Piola P = F S and elasticity A = dP/dF, which divide by nothing:
//!
//! - P = 2 f1 F + 2 f2 (I1 F - F F^T F) + fJ cof F + 2 f4 (F a) (x) a
//! - A = sum_mn f_mn (dI_m/dF) (x) (dI_n/dF) + f1 I1'' + f2 I2'' + fJ J'' + f4 I4''
//!
//! with I1'' = 2 d_ij d_KL,  I4'' = 2 d_ij a_K a_L,  J'' = e_ijm e_KLM F_mM  and
//! I2'' = 4 F_iK F_jL + 2 I1 d_ij d_KL - 2 (d_ij C_KL + F_iL F_jK + (F F^T)_ij d_KL).
//!
//! An incompressible law carries the multiplier term (p0 + q)(1 - J): the rest pressure p0, which makes the undeformed
//! state free of stress, is part of f; the excess q over it comes from [`crate::pressure`].

mod counterpart;
mod holzapfel_gasser_ogden;
mod linear_elastic;
mod mooney_rivlin;
mod neo_hookean;
mod st_venant_kirchhoff;

#[cfg(test)]
mod tests;

pub use counterpart::{LAWS, NEARLY_INCOMPRESSIBLE, NoCounterpart};
pub use holzapfel_gasser_ogden::HolzapfelGasserOgden;
pub use linear_elastic::LinearElastic;
pub use mooney_rivlin::{MooneyRivlin, ReducedMooneyRivlin};
pub use neo_hookean::NeoHookean;
pub use st_venant_kirchhoff::{Lame, StVenantKirchhoff};

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::kinematics::{Kinematics, mixed_cofactor};

/// Positions of the invariants in [`Derivatives`].
const I1: usize = 0;
const I2: usize = 1;
const J: usize = 2;
const I4: usize = 3;

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
pub type Third = [[[f64; 4]; 4]; 4];

/// Components of a symmetric third-order tensor in three directions, in the order of [`THIRD_INDICES`].
pub type SymmetricThird = [f64; 10];

/// Index triples (i <= j <= k) of [`SymmetricThird`].
pub const THIRD_INDICES: [[usize; 3]; 10] = [
    [0, 0, 0],
    [0, 0, 1],
    [0, 0, 2],
    [0, 1, 1],
    [0, 1, 2],
    [0, 2, 2],
    [1, 1, 1],
    [1, 1, 2],
    [1, 2, 2],
    [2, 2, 2],
];

/// A hyperelastic law with its parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Material {
    /// Small strain, linear.
    LinearElastic(LinearElastic),
    /// Geometrically nonlinear, linear material (paper, Eq. 6).
    StVenantKirchhoff(StVenantKirchhoff),
    /// The same with J = 1 by a multiplier (the paper's "modified St. Venant").
    ModifiedStVenantKirchhoff(StVenantKirchhoff),
    /// Incompressible, unreduced invariants (paper, Eq. 7 with its misprint mended).
    MooneyRivlin(MooneyRivlin),
    /// Incompressible, reduced invariants.
    ReducedMooneyRivlin(ReducedMooneyRivlin),
    /// Compressible, with a barrier at J -> 0.
    NeoHookean(NeoHookean),
    /// Incompressible with one family of fibres.
    HolzapfelGasserOgden(HolzapfelGasserOgden),
}

impl Material {
    /// Name in the scene file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::LinearElastic(_) => "linear",
            Self::StVenantKirchhoff(_) => "st-venant-kirchhoff",
            Self::ModifiedStVenantKirchhoff(_) => "modified-st-venant-kirchhoff",
            Self::MooneyRivlin(_) => "mooney-rivlin",
            Self::ReducedMooneyRivlin(_) => "mooney-rivlin-reduced",
            Self::NeoHookean(_) => "neo-hookean",
            Self::HolzapfelGasserOgden(_) => "holzapfel-gasser-ogden",
        }
    }

    /// Every parameter of the law, in a fixed order: what a hash of the model takes in.
    pub fn parameters(&self) -> Vec<f64> {
        match self {
            Self::LinearElastic(LinearElastic { lame })
            | Self::StVenantKirchhoff(StVenantKirchhoff { lame })
            | Self::ModifiedStVenantKirchhoff(StVenantKirchhoff { lame })
            | Self::NeoHookean(NeoHookean { lame }) => vec![lame.lambda_pa, lame.mu_pa],
            Self::MooneyRivlin(MooneyRivlin { c10_pa, c01_pa })
            | Self::ReducedMooneyRivlin(ReducedMooneyRivlin { c10_pa, c01_pa }) => vec![*c10_pa, *c01_pa],
            Self::HolzapfelGasserOgden(HolzapfelGasserOgden { c10_pa, k1_pa, k2, dispersion, fibre }) => {
                vec![*c10_pa, *k1_pa, *k2, *dispersion, fibre[0], fibre[1], fibre[2]]
            }
        }
    }

    /// Pressure at rest of an incompressible law, Pa; `None` if the law needs no multiplier.
    pub fn rest_pressure_pa(&self) -> Option<f64> {
        match self {
            Self::LinearElastic(_) | Self::StVenantKirchhoff(_) | Self::NeoHookean(_) => None,
            Self::ModifiedStVenantKirchhoff(_) | Self::ReducedMooneyRivlin(_) => Some(0.0),
            Self::MooneyRivlin(law) => Some(law.rest_pressure_pa()),
            Self::HolzapfelGasserOgden(law) => Some(law.rest_pressure_pa()),
        }
    }

    /// Shear modulus at rest, Pa (of the matrix, where there are fibres): the scale of residuals and pressures.
    pub fn shear_modulus_pa(&self) -> f64 {
        match self {
            Self::LinearElastic(law) => law.lame.mu_pa,
            Self::StVenantKirchhoff(law) | Self::ModifiedStVenantKirchhoff(law) => law.lame.mu_pa,
            Self::NeoHookean(law) => law.lame.mu_pa,
            Self::MooneyRivlin(law) => 2.0 * (law.c10_pa + law.c01_pa),
            Self::ReducedMooneyRivlin(law) => 2.0 * (law.c10_pa + law.c01_pa),
            Self::HolzapfelGasserOgden(law) => 2.0 * law.c10_pa,
        }
    }

    /// Fibre direction, a unit vector of the undeformed body; zero for a law without fibres.
    fn fibre(&self) -> Vector3<f64> {
        match self {
            Self::HolzapfelGasserOgden(law) => Vector3::from(law.fibre),
            _ => Vector3::zeros(),
        }
    }

    #[inline(always)]
    fn invariants(&self, k: &Kinematics) -> Invariants {
        let i4 = match self {
            Self::HolzapfelGasserOgden(law) => {
                // |a + H a|^2 - 1 without cancellation.
                let a = Vector3::from(law.fibre);
                let stretch = k.displacement_gradient * a;
                2.0 * stretch.dot(&a) + stretch.norm_squared()
            }
            _ => 0.0,
        };
        Invariants { i1: k.first_invariant, i2: k.second_invariant, j: k.volume_change, i4 }
    }

    /// Derivatives of f; `None` for the linear law, which is no function of invariants of C.
    #[inline(always)]
    fn derivatives(&self, at: &Invariants) -> Option<Derivatives> {
        match self {
            Self::LinearElastic(_) => None,
            Self::StVenantKirchhoff(law) | Self::ModifiedStVenantKirchhoff(law) => Some(law.derivatives(at)),
            Self::MooneyRivlin(law) => Some(law.derivatives(at)),
            Self::ReducedMooneyRivlin(law) => Some(law.derivatives(at)),
            Self::NeoHookean(law) => Some(law.derivatives(at)),
            Self::HolzapfelGasserOgden(law) => Some(law.derivatives(at)),
        }
    }

    /// Third derivatives of f; `None` where they vanish.
    #[inline(always)]
    fn third(&self, at: &Invariants) -> Option<Third> {
        match self {
            Self::LinearElastic(_)
            | Self::StVenantKirchhoff(_)
            | Self::ModifiedStVenantKirchhoff(_)
            | Self::MooneyRivlin(_) => None,
            Self::ReducedMooneyRivlin(law) => Some(law.third(at)),
            Self::NeoHookean(law) => Some(law.third(at)),
            Self::HolzapfelGasserOgden(law) => Some(law.third(at)),
        }
    }

    /// Energy density with the multiplier term of the excess pressure `q`, J/m^3, and first Piola stress, Pa.
    #[inline(always)]
    pub fn stress(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>) {
        let f = &k.deformation_gradient;
        match self.derivatives(&self.invariants(k)) {
            None => {
                let Self::LinearElastic(law) = self else { unreachable!("every other law has derivatives") };
                law.stress(&k.displacement_gradient)
            }
            Some(d) => {
                let mut stress = k.cofactor * (d.first[J] - q_pa) + f * (2.0 * d.first[I1]);
                if d.first[I2] != 0.0 {
                    stress += second_invariant_slope(k) * d.first[I2];
                }
                if d.first[I4] != 0.0 {
                    let a = self.fibre();
                    stress += f * a * a.transpose() * (2.0 * d.first[I4]);
                }
                (d.energy - q_pa * k.volume_change, stress)
            }
        }
    }

    /// [`Material::stress`] with the tangent dP/dF at fixed pressure.
    #[inline(always)]
    pub fn response(&self, k: &Kinematics, q_pa: f64) -> (f64, Matrix3<f64>, Tangent) {
        let Some(d) = self.derivatives(&self.invariants(k)) else {
            let Self::LinearElastic(law) = self else { unreachable!("every other law has derivatives") };
            let (energy, stress) = law.stress(&k.displacement_gradient);
            return (energy, stress, law.tangent());
        };
        let f = &k.deformation_gradient;
        let [f1, f2, f_j, f4] = d.first;
        let f_j = f_j - q_pa;
        let slope_i2 = second_invariant_slope(k);
        let mut stress = k.cofactor * f_j + f * (2.0 * f1) + slope_i2 * f2;
        let a = self.fibre();
        if f4 != 0.0 {
            stress += f * a * a.transpose() * (2.0 * f4);
        }
        let tangent = Tangent {
            map: *f,
            forward: 4.0 * f2,
            crosswise: -2.0 * f2,
            left: f * f.transpose() * (-2.0 * f2),
            stretch: -2.0 * f2,
            isotropic: 2.0 * f1 + 2.0 * f2 * (k.first_invariant + 3.0),
            determinant: f_j,
            fibre: a,
            along_fibre: 2.0 * f4,
            second: d.second,
            slopes: [2.0 * f, slope_i2, k.cofactor, 2.0 * (f * a) * a.transpose()],
            rows: d.second.map(|row| row.iter().any(|&s| s != 0.0)),
        };
        (d.energy - q_pa * k.volume_change, stress, tangent)
    }

    /// Third derivatives of W + q (1 - J) along three directions of (F, q), in the order of [`THIRD_INDICES`], J/m^3.
    ///
    /// With `I[i]`, `I[ij]`, `I[ijk]` the derivatives of an invariant along the directions G_i,
    ///
    /// `D3 W = sum_m f_m I_m[ijk] + sum_mn f_mn (I_m[ij] I_n[k] + 2 permutations) + sum_mno f_mno I_m[i] I_n[j] I_o[k]`,
    ///
    /// and the multiplier adds `- q J[ijk] - (q_i J[jk] + 2 permutations)`.
    #[inline(always)]
    pub fn third_along(
        &self,
        k: &Kinematics,
        q_pa: f64,
        gradients: &[Matrix3<f64>; 3],
        dq_pa: &[f64; 3],
    ) -> SymmetricThird {
        let at = self.invariants(k);
        let Some(d) = self.derivatives(&at) else { return [0.0; 10] };
        let third = self.third(&at);
        // Most laws here are linear in every invariant: then the first two derivatives are needed of J alone.
        let curved = third.is_some() || d.second.iter().flatten().any(|&s| s != 0.0);
        let along = InvariantsAlong::new(k, gradients, &self.fibre(), curved);
        let mut result = [0.0; 10];
        for (value, [i, j, l]) in result.iter_mut().zip(THIRD_INDICES) {
            let cubic = along.cubic(i, j, l);
            let mut sum = (d.first[J] - q_pa) * cubic[J] + d.first[I2] * cubic[I2];
            for (p, [a, b]) in [(i, [j, l]), (j, [i, l]), (l, [i, j])] {
                let square = along.square(a, b);
                sum -= dq_pa[p] * square[J];
                for m in 0..if curved { 4 } else { 0 } {
                    for n in 0..4 {
                        if d.second[m][n] != 0.0 {
                            sum += d.second[m][n] * along.linear[p][m] * square[n];
                        }
                    }
                }
            }
            if let Some(third) = &third {
                for m in 0..4 {
                    for n in 0..4 {
                        for o in 0..4 {
                            let mut sorted = [m, n, o];
                            sorted.sort_unstable();
                            let f_mno = third[sorted[0]][sorted[1]][sorted[2]];
                            if f_mno != 0.0 {
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

/// The elasticity A = dP/dF, kept as the few numbers from which a block g_a . A . g_b is made.
///
/// With x_a = F g_a and m = F (g_a x g_b), term by term of the A at the top of this file:
///
/// g_a . A . g_b = forward x_a x_b^T + crosswise x_b x_a^T + left (g_a . g_b) + determinant e_ijk m_k
///   + [ isotropic (g_a . g_b) + stretch (x_a . x_b) + along_fibre (a . g_a)(a . g_b) ] I
///   + sum_mn f_mn (I_m' g_a) (I_n' g_b)^T
#[derive(Debug, Clone, Copy)]
pub struct Tangent {
    map: Matrix3<f64>,
    forward: f64,
    crosswise: f64,
    left: Matrix3<f64>,
    stretch: f64,
    isotropic: f64,
    determinant: f64,
    fibre: Vector3<f64>,
    along_fibre: f64,
    second: [[f64; 4]; 4],
    slopes: [Matrix3<f64>; 4],
    /// Rows of `second` that are not zero.
    rows: [bool; 4],
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
            if self.rows[m] {
                for n in 0..4 {
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
    fn new(k: &Kinematics, directions: &[Matrix3<f64>; 3], fibre: &Vector3<f64>, curved: bool) -> Self {
        let f = &k.deformation_gradient;
        let stretched = directions.map(|g| g * fibre);
        let fibre_now = f * fibre;
        let cofactor_slopes = directions.map(|g| mixed_cofactor(f, &g));
        let cofactor_curvatures = PAIRS.map(|(i, j)| mixed_cofactor(&directions[i], &directions[j]));
        let linear = std::array::from_fn(|i| {
            if !curved {
                return [0.0; 4];
            }
            [
                2.0 * f.dot(&directions[i]),
                2.0 * k.cofactor.dot(&cofactor_slopes[i]),
                k.cofactor.dot(&directions[i]),
                2.0 * fibre_now.dot(&stretched[i]),
            ]
        });
        let squares = std::array::from_fn(|p| {
            let (i, j) = PAIRS[p];
            let volume = cofactor_slopes[i].dot(&directions[j]);
            if !curved {
                return [0.0, 0.0, volume, 0.0];
            }
            [
                2.0 * directions[i].dot(&directions[j]),
                2.0 * (cofactor_slopes[i].dot(&cofactor_slopes[j]) + k.cofactor.dot(&cofactor_curvatures[p])),
                volume,
                2.0 * stretched[i].dot(&stretched[j]),
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
    fn cubic(&self, i: usize, j: usize, l: usize) -> [f64; 4] {
        let curvature = |a, b| &self.cofactor_curvatures[pair(a, b)];
        let slope = &self.cofactor_slopes;
        let second =
            slope[i].dot(curvature(j, l)) + slope[j].dot(curvature(i, l)) + slope[l].dot(curvature(i, j));
        [0.0, 2.0 * second, curvature(i, j).dot(&self.directions[l]), 0.0]
    }
}
