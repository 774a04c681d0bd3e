//! Fits: from solved configurations to the tables that the core interpolates.

mod branch_jump;
mod displacement;
mod ghosts;
mod hermite;
mod kernel;
mod kernel_planes;
mod modes;
mod motion;
mod rbf_iterative;
mod rbf_weights;
#[cfg(test)]
pub(crate) mod synthetic;

pub use branch_jump::BranchJump;
pub(crate) use branch_jump::{branch_jumps, flagged_pairs};
pub(crate) use displacement::{
    DisplacementFault, DisplacementFit, Misfit, SurfaceMotionSample, fit_displacement,
};
pub(crate) use ghosts::lattice_flags;
pub use ghosts::{LatticeValues, lattice_values};
pub(crate) use hermite::root_nodes;
pub use hermite::{HermiteNodes, hermite_nodes};
pub(crate) use kernel::DATA;
pub(crate) use kernel::Derivatives;
pub use kernel::{Base, KernelFit};
pub(crate) use kernel::{KernelSystem, LEAST_ROOT_J};
pub(crate) use kernel_planes::KernelPlanes;
pub(crate) use modes::PackedModes;
pub(crate) use motion::ScatteredMotion;
pub(crate) use motion::displacement_of_fit;
pub(crate) use rbf_weights::FitError;
pub use rbf_weights::{Kernel, RbfFit, fit_rbf};

use crate::num::jet::EnergyJet;
use crate::spec::GridIndex;

/// A configuration at a grid point, solved or evaluated from a fit: the input of the tables.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Grid point.
    pub index: GridIndex,
    /// Index of the attempt that gave the solution.
    pub attempt: u32,
    /// W, h, S and W_ijk at the point.
    pub jet: EnergyJet,
    /// All derivatives of the table, J/m^n; `None` for a solution, whose higher derivatives are differences.
    pub derivatives: Option<Derivatives>,
    /// Whether |h| exceeds the scene's force limit.
    pub terminating: bool,
    /// Whether an element is inverted.
    pub inverted: bool,
}

/// A position and the force there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centre {
    /// Position in cells.
    pub position: [f64; 3],
    /// h, N.
    pub force_n: [f64; 3],
}

impl From<&Sample> for Centre {
    fn from(sample: &Sample) -> Self {
        Self { position: sample.index.map(f64::from), force_n: sample.jet.force_n }
    }
}
