//! The configuration space: a ball of positions of the active node, solved point by point (paper, 4.3 and 5.1).
//!
//! [`plan`] decides what to solve and from which parent; [`job`] is one solve, done by a [`crew`] of threads or processes;
//! [`expansion`] brings them together; [`store`] keeps every try in SQLite; [`fold`] flags neighbours on different branches;
//! [`SpaceGrid`] is the lattice in metres.

pub mod crew;
mod domain;
pub mod expansion;
pub mod fold;
pub mod job;
#[cfg(test)]
pub(crate) mod made_up;
pub mod plan;
mod plans;
#[cfg(test)]
mod planted_fold;
mod record;
mod sampling;
pub mod store;

pub use crew::{Crew, CrewError, Threads, with_threads};
pub use domain::Domain;
pub use expansion::{Expansion, ExpansionError, Progress};
pub use job::{Done, Intermediate, Job, Outcome, Work, Worker, Workshop};
pub use plan::TagCounts;
pub use plans::{Plans, SpacePlan, still_to_solve};
pub use record::{Record, StoredSeed};
pub use sampling::{Lattice, Sampling, Scattered};
pub use store::{Salvaged, Store, StoreError, StoreIdentity, solver_version};

use palpate_core::{BallLattice, LatticeError};

/// Index of a grid point in cells, relative to the active node at rest.
pub type GridIndex = [i32; 3];

/// The uniform grid G_A of one space (paper, Eq. 11), in f64.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceGrid {
    /// Distance of neighbouring points, m.
    pub spacing_m: f64,
    /// Radius r_G of the ball, m.
    pub radius_m: f64,
    /// Index arithmetic, shared with the core so that both ends number the slots alike.
    pub lattice: BallLattice,
}

impl SpaceGrid {
    /// Grid of `spacing_m` within `radius_m`.
    pub fn new(spacing_m: f64, radius_m: f64) -> Result<Self, LatticeError> {
        Ok(Self { spacing_m, radius_m, lattice: BallLattice::new(spacing_m as f32, radius_m as f32)? })
    }

    /// Displacement of a grid point, m.
    pub fn displacement_m(&self, index: GridIndex) -> [f64; 3] {
        index.map(|n| f64::from(n) * self.spacing_m)
    }
}
