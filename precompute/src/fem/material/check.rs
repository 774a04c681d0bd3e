//! Consistency check of a law: each derivative against finite differences of the previous one.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{Law, Tangent};
use crate::fem::kinematics::Kinematics;
use crate::num::jet::THIRD_INDICES;
use crate::num::tensor::Mat3;

/// Largest relative errors found by [`check`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LawCheck {
    /// First Piola stress against differences of the energy, relative to the norm of the stress.
    pub stress: f64,
    /// Elasticity against differences of the stress, relative to its largest entry.
    pub elasticity: f64,
    /// Asymmetry of the elasticity, relative to its largest entry.
    pub symmetry: f64,
    /// Third derivatives against differences of the elasticity, relative to the larger of the largest third
    /// derivative and the shear modulus.
    pub third: f64,
    /// Energy and stress of [`Law::response`] against those of [`Law::stress`].
    pub agreement: f64,
    /// Change of the energy and of F^-1 P under a rotation, relative to the shear modulus.
    pub rotation: f64,
    /// Energy and stress at rest, and the difference of the stiffness in simple shear from the shear modulus,
    /// relative to the shear modulus.
    pub rest: f64,
}

impl LawCheck {
    /// The errors above their limits, one line each; empty for a consistent law. The limits are 1e-7 for the
    /// stress and the elasticity, 1e-6 for the third derivatives, 1e-11 for rotations, and 1e-12 for the
    /// others.
    pub fn faults(&self) -> Vec<String> {
        [
            ("the stress is not the derivative of the energy", self.stress, 1e-7),
            ("the elasticity is not the derivative of the stress", self.elasticity, 1e-7),
            ("the elasticity is not symmetric", self.symmetry, 1e-12),
            ("the third derivatives are not those of the elasticity", self.third, 1e-6),
            ("energy and stress with the elasticity differ from those without", self.agreement, 1e-12),
            ("a rotation changes the energy or the second Piola stress", self.rotation, 1e-11),
            ("the undeformed body has an energy, a stress or another shear modulus", self.rest, 1e-12),
        ]
        .into_iter()
        .filter(|(_, error, limit)| error > limit)
        .map(|(what, error, limit)| {
            format!("{what}: relative error {error:.1e}, at most {limit:.0e} is sound")
        })
        .collect()
    }
}

/// Checks that a law is consistent: stress, elasticity and third derivatives are derivatives of the energy,
/// the elasticity is symmetric, and the law is objective. The undeformed body must be free of stress and have
/// the stated shear modulus. The deformations are general ones of about 30 % strain, a small one, and one
/// with J < 0. The last one is excluded if its energy is NaN.
///
/// ```
/// use palpate_precompute::fem::material::{MooneyRivlin, check};
///
/// let law = MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 };
/// assert_eq!(check(&law).faults(), [""; 0]);
/// ```
pub fn check<L: Law + ?Sized>(law: &L) -> LawCheck {
    let mut found = LawCheck::default();
    let q_pa = law.rest_pressure_pa().map_or(0.0, |_| 0.06 * law.shear_modulus_pa());
    for h in gradients() {
        let k = Kinematics::of(&h);
        let finite = law.stress(&k, q_pa).0.is_finite();
        if k.jacobian() > 0.0 || finite {
            check_stress(law, &h, q_pa, &mut found);
            check_elasticity(law, &h, q_pa, &mut found);
            check_third(law, &h, q_pa, &mut found);
            check_rotation(law, &h, q_pa, &mut found);
        }
    }
    check_rest(law, &mut found);
    found
}

/// Displacement gradients: a general one, one that shortens most fibres, a small one, one with inversion.
fn gradients() -> [Matrix3<f64>; 4] {
    [
        Matrix3::new(0.2, -0.3, 0.1, 0.05, -0.2, 0.25, 0.3, 0.15, 0.1),
        Matrix3::new(-0.3, 0.1, 0.0, 0.1, 0.2, 0.05, -0.02, 0.1, -0.2),
        Matrix3::new(0.011, 0.002, 0.001, -0.003, 0.009, 0.004, 0.0, -0.002, 0.008),
        Matrix3::new(-1.2, 0.1, 0.0, 0.1, 0.2, 0.05, -0.02, 0.1, 0.2),
    ]
}

/// Finite-difference step of the displacement gradient.
const STEP: f64 = 1e-6;

/// Raises `worst` to `error`; NaN counts as infinite.
fn raise(worst: &mut f64, error: f64) {
    *worst = worst.max(if error.is_nan() { f64::INFINITY } else { error });
}

fn along(h: &Matrix3<f64>, component: usize, step: f64) -> Kinematics {
    let mut moved = *h;
    moved[component] += step;
    Kinematics::of(&moved)
}

/// A as a 9 x 9 matrix, from its blocks along the axes; component (i, K) of a 3 x 3 tensor has index 3 K + i.
pub(super) fn matrix(tangent: &Tangent) -> [[f64; 9]; 9] {
    let axes = [0, 1, 2].map(|k| tangent.node(Vector3::ith(k, 1.0).into()));
    let mut full = [[0.0; 9]; 9];
    for (row, entries) in full.iter_mut().enumerate() {
        for (column, entry) in entries.iter_mut().enumerate() {
            *entry = tangent.block(&axes[row / 3], &axes[column / 3])[3 * (row % 3) + column % 3];
        }
    }
    full
}

fn check_stress<L: Law + ?Sized>(law: &L, h: &Matrix3<f64>, q_pa: f64, found: &mut LawCheck) {
    let stress = Matrix3::from(law.stress(&Kinematics::of(h), q_pa).1);
    for c in 0..9 {
        let energy = |step: f64| law.stress(&along(h, c, step), q_pa).0;
        let near = energy(STEP) - energy(-STEP);
        let far = energy(2.0 * STEP) - energy(-2.0 * STEP);
        let slope = (8.0 * near - far) / (12.0 * STEP);
        raise(&mut found.stress, (slope - stress[c]).abs() / stress.norm());
    }
}

fn check_elasticity<L: Law + ?Sized>(law: &L, h: &Matrix3<f64>, q_pa: f64, found: &mut LawCheck) {
    let k = Kinematics::of(h);
    let (energy, stress, tangent) = law.response(&k, q_pa);
    let (energy_alone, stress_alone) = law.stress(&k, q_pa);
    raise(&mut found.agreement, (energy - energy_alone).abs() / energy_alone.abs());
    let difference = (stress - stress_alone).norm_squared() / stress_alone.norm_squared();
    raise(&mut found.agreement, difference.sqrt());
    let elasticity = matrix(&tangent);
    let scale = elasticity.iter().flatten().fold(0.0f64, |m, a| m.max(a.abs()));
    for column in 0..9 {
        let stress = |step: f64| Matrix3::from(law.stress(&along(h, column, step), q_pa).1);
        let slope = (stress(STEP) - stress(-STEP)) / (2.0 * STEP);
        for row in 0..9 {
            let (entry, mirrored) = (elasticity[row][column], elasticity[column][row]);
            raise(&mut found.elasticity, (slope[row] - entry).abs() / scale);
            raise(&mut found.symmetry, (entry - mirrored).abs() / scale);
        }
    }
}

fn check_third<L: Law + ?Sized>(law: &L, h: &Matrix3<f64>, q_pa: f64, found: &mut LawCheck) {
    let directions = [
        Matrix3::new(0.3, 0.1, -0.2, 0.5, -0.4, 0.2, 0.1, 0.6, 0.2),
        Matrix3::new(-0.1, 0.4, 0.3, 0.2, 0.2, -0.5, 0.4, 0.0, 0.3),
        Matrix3::new(0.2, 0.0, 0.5, -0.3, 0.1, 0.1, 0.2, -0.2, 0.4),
    ];
    let shear_pa = law.shear_modulus_pa();
    let dq_pa = law.rest_pressure_pa().map_or([0.0; 3], |_| [0.04, -0.1, 0.06].map(|share| share * shear_pa));
    let gradients = directions.map(|direction| Mat3::from(&direction));
    let third = law.third_along(&Kinematics::of(h), q_pa, &gradients, &dq_pa);
    // Second derivative along (F, q) in directions a and b, at a state shifted along direction l.
    let second = |shift: f64, l: usize, a: usize, b: usize| -> f64 {
        let k = Kinematics::of(&(h + directions[l] * shift));
        let elasticity = matrix(&law.response(&k, q_pa + dq_pa[l] * shift).2);
        let inner: f64 = (0..9)
            .map(|r| directions[a][r] * (0..9).map(|c| elasticity[r][c] * directions[b][c]).sum::<f64>())
            .sum();
        let cofactor = Matrix3::from(k.cofactor);
        inner - dq_pa[a] * cofactor.dot(&directions[b]) - dq_pa[b] * cofactor.dot(&directions[a])
    };
    let scale = third.iter().fold(shear_pa, |m, t| m.max(t.abs()));
    for (value, [i, j, l]) in third.iter().zip(THIRD_INDICES) {
        let slope = (second(STEP, l, i, j) - second(-STEP, l, i, j)) / (2.0 * STEP);
        raise(&mut found.third, (slope - value).abs() / scale);
    }
}

fn check_rotation<L: Law + ?Sized>(law: &L, h: &Matrix3<f64>, q_pa: f64, found: &mut LawCheck) {
    let turn = *Rotation3::from_euler_angles(0.7, -1.1, 2.0).matrix();
    let turned = turn * (h + Matrix3::identity()) - Matrix3::identity();
    let (energy, stress) = law.stress(&Kinematics::of(h), q_pa);
    let (energy_turned, stress_turned) = law.stress(&Kinematics::of(&turned), q_pa);
    let difference = turn * Matrix3::from(stress) - Matrix3::from(stress_turned);
    raise(&mut found.rotation, (energy - energy_turned).abs() / law.shear_modulus_pa());
    raise(&mut found.rotation, difference.norm() / law.shear_modulus_pa());
}

fn check_rest<L: Law + ?Sized>(law: &L, found: &mut LawCheck) {
    let (energy, stress, tangent) = law.response(&Kinematics::of(&Matrix3::zeros()), 0.0);
    let shear_pa = law.shear_modulus_pa();
    // A_xYxY = mu in simple shear.
    let shear = matrix(&tangent)[3][3];
    for error in [energy, stress.norm_squared().sqrt(), shear - shear_pa] {
        raise(&mut found.rest, (error / shear_pa).abs());
    }
}
