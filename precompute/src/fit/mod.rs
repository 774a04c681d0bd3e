//! Fits: from solved configurations to the tables that the core interpolates.

mod branch_jump;
mod centre;
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
pub use centre::Centre;
pub(crate) use displacement::{DisplacementFault, DisplacementFit, Misfit};
pub use displacement::{SurfaceMotionSample, fit_displacement};
pub use ghosts::{LatticeValues, lattice_values};
pub use hermite::{HermiteNodes, flag_branch_jumps, hermite_nodes, hermite_nodes_known};
pub(crate) use kernel::DATA;
pub use kernel::{Derivatives, KernelFit};
pub(crate) use kernel_planes::KernelPlanes;
pub(crate) use modes::PackedModes;
pub use motion::ScatteredMotion;
pub(crate) use rbf_weights::{FitError, SurfaceRbf};
pub use rbf_weights::{Kernel, RbfFit, fit_rbf};

use crate::num::jet::EnergyJet;
use crate::spec::GridIndex;

/// A solved grid point, as input of the fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Grid point.
    pub index: GridIndex,
    /// Index of the attempt that gave the solution.
    pub attempt: u32,
    /// W, h, S and W_ijk at the point.
    pub jet: EnergyJet,
    /// Whether |h| exceeds the scene's force limit.
    pub terminating: bool,
    /// Whether an element is inverted.
    pub inverted: bool,
}
