//! From solved configurations to the tables that the core interpolates.

mod displacement;
mod fold;
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

pub use displacement::{DisplacementFault, DisplacementFit, Misfit, Moved, fit_displacement};
pub use fold::{Fold, flagged_pairs, folds};
pub use ghosts::{LatticeValues, lattice_values};
pub use hermite::{HermiteNodes, flag_folds, hermite_nodes, hermite_nodes_known};
pub(crate) use kernel::DATA;
pub use kernel::{Derivatives, Indistinct, KernelFit};
pub use kernel_planes::KernelPlanes;
pub(crate) use modes::PackedModes;
pub use motion::ScatteredMotion;
pub use rbf_weights::{Centre, FitError, Kernel, RbfFit, SurfaceRbf, fit_rbf};

use crate::num::jet::SymmetricThird;
use crate::spec::GridIndex;

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
    /// W_ijk in the order of [`crate::num::jet::THIRD_INDICES`], N/m^2.
    pub third_n_m2: SymmetricThird,
    /// |h| is beyond the scene's force limit.
    pub terminating: bool,
    /// At least one element is inverted.
    pub inverted: bool,
}
