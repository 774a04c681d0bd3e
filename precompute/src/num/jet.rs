//! The condensed energy at a point, with its derivatives: what the solver hands to every fit.

use nalgebra::{Matrix3, Vector3};

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

/// The condensed energy and its derivatives at a solved configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnergyJet {
    /// Displacement of the active node, m.
    pub displacement_m: [f64; 3],
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
    /// Force at another displacement by the Taylor series of third order, N.
    pub fn taylor_force_n(&self, displacement_m: [f64; 3]) -> [f64; 3] {
        let d = Vector3::from(displacement_m) - Vector3::from(self.displacement_m);
        let mut force = Vector3::from(self.force_n) + self.stiffness_n_m * d;
        for (triple, value) in THIRD_INDICES.iter().zip(self.third_n_m2) {
            // d(W_ijk d_i d_j d_k / 6)/dd with as many orders of the triple as there are.
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
