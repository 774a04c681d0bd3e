//! The condensed energy and its derivatives at one point: the datum that the solver passes to every fit.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Index pairs (i <= j) of the components of a symmetric second-order tensor, in the order of all files and
/// tables.
pub const SECOND_INDICES: [[usize; 2]; 6] = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

/// Components of a symmetric third-order tensor in three directions, in the order of [`THIRD_INDICES`].
pub(crate) type SymmetricThird = [f64; 10];

/// Index triples (i <= j <= k) of `SymmetricThird`.
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

/// The condensed energy and its derivatives at a solved configuration.
///
/// The control is what the tool prescribes: the displacement of the active node from rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EnergyJet {
    /// Control d, m.
    pub control_m: [f64; 3],
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S, N/m.
    pub stiffness_n_m: Matrix3<f64>,
    /// W_ijk in the order of [`THIRD_INDICES`], N/m^2.
    pub third_n_m2: SymmetricThird,
}

impl EnergyJet {
    /// W, h, S (order of [`SECOND_INDICES`]) and W_ijk (order of [`THIRD_INDICES`]), as in files and fits.
    pub(crate) fn numbers(&self) -> [f64; 20] {
        let mut numbers = [0.0; 20];
        numbers[0] = self.energy_j;
        numbers[1..4].copy_from_slice(&self.force_n);
        numbers[4..10].copy_from_slice(&SECOND_INDICES.map(|[i, j]| self.stiffness_n_m[(i, j)]));
        numbers[10..].copy_from_slice(&self.third_n_m2);
        numbers
    }

    /// The jet at `control_m` with the values of `Self::numbers`.
    pub fn from_numbers(control_m: [f64; 3], numbers: &[f64; 20]) -> Self {
        let [energy_j, hx, hy, hz, xx, xy, xz, yy, yz, zz, third @ ..] = *numbers;
        Self {
            control_m,
            energy_j,
            force_n: [hx, hy, hz],
            stiffness_n_m: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            third_n_m2: third,
        }
    }

    /// The same jet with zero energy and force. Both vanish at rest by definition; the solver's values there
    /// are rounding errors.
    #[must_use]
    pub(crate) fn as_rest(self) -> Self {
        Self { energy_j: 0.0, force_n: [0.0; 3], ..self }
    }

    /// The jet of s = sqrt(2 W), if W is larger than `least_j`: s_i = h_i / s, s_ij = (S_ij - s_i s_j) / s,
    /// s_ijk = (W_ijk - s_i s_jk - s_j s_ik - s_k s_ij) / s.
    pub(crate) fn root(&self, least_j: f64) -> Option<Self> {
        if self.energy_j.is_nan() || self.energy_j <= least_j {
            return None;
        }
        let s = (2.0 * self.energy_j).sqrt();
        let first = Vector3::from(self.force_n) / s;
        let second = (self.stiffness_n_m - first * first.transpose()) / s;
        let mut third = self.third_n_m2;
        for (value, &[i, j, k]) in third.iter_mut().zip(&THIRD_INDICES) {
            let mixed = first[i] * second[(j, k)] + first[j] * second[(i, k)] + first[k] * second[(i, j)];
            *value = (*value - mixed) / s;
        }
        Some(Self { energy_j: s, force_n: first.into(), stiffness_n_m: second, third_n_m2: third, ..*self })
    }

    /// The jet of W = s^2 / 2 from this one of s, the inverse of [`Self::root`]; zero where s is not positive.
    pub(crate) fn squared(&self) -> Self {
        let s = self.energy_j;
        if s.is_nan() || s <= 0.0 {
            return Self::from_numbers(self.control_m, &[0.0; 20]);
        }
        let (first, second) = (Vector3::from(self.force_n), &self.stiffness_n_m);
        let mut third = self.third_n_m2;
        for (value, &[i, j, k]) in third.iter_mut().zip(&THIRD_INDICES) {
            let mixed = first[i] * second[(j, k)] + first[j] * second[(i, k)] + first[k] * second[(i, j)];
            *value = s * *value + mixed;
        }
        Self {
            energy_j: 0.5 * s * s,
            force_n: (s * first).into(),
            stiffness_n_m: first * first.transpose() + s * second,
            third_n_m2: third,
            ..*self
        }
    }

    /// Value of the third-order Taylor series at another control.
    pub(crate) fn taylor_value(&self, control_m: [f64; 3]) -> f64 {
        let d = Vector3::from(control_m) - Vector3::from(self.control_m);
        // Of the gradient the terms of order n contribute their product with d over n + 1.
        let first = Vector3::from(self.force_n).dot(&d);
        let second = (self.stiffness_n_m * d).dot(&d);
        let third = Vector3::from(self.taylor_force_n(control_m)).dot(&d) - first - second;
        self.energy_j + first + 0.5 * second + third / 3.0
    }

    /// Whether the tool touches nothing there, as a sphere beside the body.
    pub(crate) fn is_free(&self) -> bool {
        self.stiffness_n_m == Matrix3::zeros()
    }

    /// Whether every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        self.numbers().iter().chain(self.stiffness_n_m.iter()).all(|x| x.is_finite())
    }

    /// Force at another control by the third-order Taylor series, N.
    pub(crate) fn taylor_force_n(&self, control_m: [f64; 3]) -> [f64; 3] {
        let d = Vector3::from(control_m) - Vector3::from(self.control_m);
        let mut force = Vector3::from(self.force_n) + self.stiffness_n_m * d;
        for (triple, value) in THIRD_INDICES.iter().zip(self.third_n_m2) {
            // Derivative of W_ijk d_i d_j d_k / 6 with respect to d; each distinct permutation of the triple
            // contributes one term.
            let [i, j, k] = *triple;
            let orders = if i == k {
                1.0
            } else if i == j || j == k {
                3.0
            } else {
                6.0
            };
            let share = orders * value / 6.0;
            force[i] += share * d[j] * d[k];
            force[j] += share * d[i] * d[k];
            force[k] += share * d[i] * d[j];
        }
        force.into()
    }
}
