//! Equations that a factor leaves free and loads hold at zero.

use nalgebra::{Matrix3, Vector3};

/// Three equations whose solution is held at zero by loads on them, x = M^-1 r - Y (E' Y)^-1 E' M^-1 r.
pub(super) struct HeldByLoads {
    equations: [usize; 3],
    /// Y = M^-1 E, column after column.
    unit_loads: Vec<f64>,
    /// (E' Y)^-1.
    stiffness: Matrix3<f64>,
}

impl HeldByLoads {
    /// By the solutions Y; `None` if these cannot hold the equations.
    pub(super) fn new(equations: [usize; 3], unit_loads: &[f64]) -> Option<Self> {
        let stiffness = held_stiffness(equations, unit_loads)?;
        Some(Self { equations, unit_loads: unit_loads.to_vec(), stiffness })
    }

    /// Changes the columns M^-1 r to those with the equations held.
    pub(super) fn hold(&self, columns: &mut [f64]) {
        let n = self.unit_loads.len() / 3;
        for x in columns.chunks_mut(n) {
            let loads = self.stiffness * Vector3::from(self.equations.map(|equation| x[equation]));
            for (load, column) in loads.iter().zip(self.unit_loads.chunks(n)) {
                for (x, y) in x.iter_mut().zip(column) {
                    *x -= load * y;
                }
            }
            // Without the rounding.
            self.equations.iter().for_each(|&equation| x[equation] = 0.0);
        }
    }
}

/// (E' Y)^-1 of the solutions Y for unit loads on three equations: the loads that displace these by one.
pub(in crate::fem::solve) fn held_stiffness(
    equations: [usize; 3],
    unit_loads: &[f64],
) -> Option<Matrix3<f64>> {
    let n = unit_loads.len() / 3;
    Matrix3::from_fn(|row, column| unit_loads[column * n + equations[row]]).try_inverse()
}
