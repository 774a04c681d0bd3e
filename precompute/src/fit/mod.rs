//! From solved configurations to the tables that the core interpolates.

mod displacement;
mod form;
mod ghosts;
mod hermite;
mod kernel;
mod kernel_planes;
#[cfg(test)]
pub(crate) mod made_up;
mod modes;
mod motion;
mod rbf_iterative;
mod rbf_weights;

pub use displacement::{
    DisplacementBound, DisplacementFault, DisplacementFit, Misfit, Moved, fit_displacement,
};
pub use form::{Form, FormNeeds};
pub use ghosts::{LatticeValues, lattice_values};
pub use hermite::{HermiteNodes, flag_folds, hermite_nodes, hermite_nodes_known};
pub(crate) use kernel::DATA;
pub use kernel::{Derivatives, EnergyJet, Indistinct, KernelFit};
pub use kernel_planes::KernelPlanes;
pub(crate) use modes::PackedModes;
pub use motion::{ScatteredMotion, SurfaceMotion};
pub use rbf_weights::{Centre, FitError, Kernel, RbfFit, SurfaceRbf, fit_rbf};

use crate::configuration_space::{GridIndex, Record, SpaceGrid};
use crate::material::SymmetricThird;

/// A solved grid point as the fits need it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Grid point.
    pub index: GridIndex,
    /// Which try at the point gave the solution.
    pub attempt: u32,
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S = dh/dd, rows, N/m.
    pub stiffness_n_m: [[f64; 3]; 3],
    /// W_ijk in the order of [`crate::material::THIRD_INDICES`], N/m^2.
    pub third_n_m2: SymmetricThird,
    /// |h| is beyond the scene's force limit.
    pub terminating: bool,
    /// At least one element is inverted.
    pub inverted: bool,
}

/// The solved points among `records`, sorted by grid index.
pub fn samples(grid: &SpaceGrid, records: &[Record]) -> Vec<Sample> {
    let mut samples: Vec<Sample> = records
        .iter()
        .filter(|r| r.tag.is_solved() && grid.lattice.slot(r.index).is_some())
        .map(|r| Sample {
            index: r.index,
            attempt: r.attempt,
            // Rest has no force by its definition; what the solver left of a body force's residual is rounding.
            energy_j: if r.index == [0; 3] { 0.0 } else { r.energy_j },
            force_n: if r.index == [0; 3] { [0.0; 3] } else { r.force_n },
            third_n_m2: r.third_n_m2,
            stiffness_n_m: std::array::from_fn(|i| std::array::from_fn(|j| r.stiffness_n_m[(i, j)])),
            terminating: r.tag == palpate_core::ConfigTag::Terminating,
            inverted: r.inverted > 0,
        })
        .collect();
    samples.sort_unstable_by_key(|s| s.index);
    samples
}
