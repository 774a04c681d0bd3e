//! Points of a configuration space: integer triples on the paper's lattice, or on one of a micrometre.

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

/// What scattered positions are counted in, m: far below what anybody resolves.
pub const UNIT_M: f64 = 1e-6;

/// Displacement of a point, m.
pub fn displacement_m(index: GridIndex) -> [f64; 3] {
    index.map(|n| f64::from(n) * UNIT_M)
}

/// The point nearest to a displacement.
pub fn nearest_index(displacement_m: [f64; 3]) -> GridIndex {
    displacement_m.map(|x| (x / UNIT_M).round() as i32)
}
