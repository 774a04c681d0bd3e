//! Points of a configuration space as integer triples, in cells of the paper's lattice or in micrometres.

use palpate_core::{BallLattice, LatticeError};

/// Index of a grid point in cells, relative to the active node at rest.
pub type GridIndex = [i32; 3];

/// The uniform grid G_A of one space (paper, Eq. 11), in f64.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceGrid {
    /// Distance between neighbouring points, m.
    pub spacing_m: f64,
    /// Radius r_G of the ball, m.
    pub radius_m: f64,
    /// Index arithmetic; the core uses the same, so both number the slots alike.
    pub lattice: BallLattice,
}

impl SpaceGrid {
    /// The grid with this spacing and radius, both in m.
    pub fn new(spacing_m: f64, radius_m: f64) -> Result<Self, LatticeError> {
        Ok(Self { spacing_m, radius_m, lattice: BallLattice::new(spacing_m as f32, radius_m as f32)? })
    }

    /// Displacement of a grid point, m.
    pub fn displacement_m(&self, index: GridIndex) -> [f64; 3] {
        index.map(|n| f64::from(n) * self.spacing_m)
    }
}

/// Unit of the indices of scattered positions, m; far below the resolution of any device.
pub(crate) const UNIT_M: f64 = 1e-6;

/// Smallest radius r_G of a space, m. A radius below ten units contains too few positions.
pub(crate) const MIN_RADIUS_M: f64 = 1e-5;

/// Largest radius r_G of a space, m: that of the core's lattices.
pub(crate) const MAX_RADIUS_M: f64 = 1e3;

/// Displacement of a scattered point, m.
pub(crate) fn displacement_m(index: GridIndex) -> [f64; 3] {
    index.map(|n| f64::from(n) * UNIT_M)
}

/// The scattered point nearest to a displacement in m.
pub(crate) fn nearest_index(displacement_m: [f64; 3]) -> GridIndex {
    displacement_m.map(|x| (x / UNIT_M).round() as i32)
}
