//! The configuration space: a ball of positions of the active node, solved point by point (paper, 4.3 and 5.1).
//!
//! [`expansion`] decides what to solve and from which parent; [`store`] keeps every solved configuration in SQLite;
//! [`SpaceGrid`] is the lattice in metres.

pub mod expansion;
pub mod store;

pub use expansion::{Expansion, ExpansionError, Progress, TagCounts, still_to_solve};
pub use store::{Record, Store, StoreError, StoreIdentity};

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
