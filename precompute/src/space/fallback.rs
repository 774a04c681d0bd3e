//! The fallback lattice, which replaces an adaptive search that stagnates.
//!
//! Its points use the micrometre units of the search, so that one store holds the configurations of both.

use super::record::Record;
use crate::spec::{GridIndex, SpaceGrid, UNIT_M};

/// Cells along the radius. Three suffice for a smooth space. A branch jump needs more; five would be 1,014
/// solves.
const CELLS: i32 = 4;

/// The fallback lattice; its points are in units of `UNIT_M`, as those of the search.
#[derive(Debug, Clone)]
pub struct FallbackLattice {
    /// The lattice.
    pub grid: SpaceGrid,
    /// Spacing in units of `UNIT_M`.
    pub spacing: i32,
}

impl FallbackLattice {
    /// The lattice within `radius_m`, with the corners outside the ball. `None` if that is not a valid
    /// lattice of the core.
    pub fn within(radius_m: f64) -> Option<Self> {
        // Rounded up: a spacing slightly too small would add a cell.
        let spacing = (radius_m / UNIT_M / f64::from(CELLS) - 1e-6).ceil() as i32;
        let grid = SpaceGrid::new(f64::from(spacing) * UNIT_M, radius_m).ok()?;
        Some(Self { grid, spacing })
    }

    /// The records at lattice points among those of the space, with indices in lattice steps, in the same
    /// order.
    pub fn records(&self, of_space: &[Record]) -> Vec<Record> {
        of_space.iter().filter_map(|record| self.own(record)).collect()
    }

    /// The record with its index in lattice steps; `None` if it is not a lattice point. Of the points of the
    /// search only rest is one.
    pub(super) fn own(&self, record: &Record) -> Option<Record> {
        let steps = |index: GridIndex| index.map(|n| n / self.spacing);
        let index = steps(record.index);
        let is_own =
            record.index == index.map(|n| n * self.spacing) && self.grid.lattice.slot(index).is_some();
        let parent = record.parent.map(|(parent, attempt)| (steps(parent), attempt));
        is_own.then(|| Record { index, parent, ..record.clone() })
    }
}
