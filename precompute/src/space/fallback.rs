//! The lattice that takes over where an adaptive search stalls.
//!
//! Its points are counted in the micrometres of the search too, so one store holds the configurations of both.

use super::record::Record;
use crate::spec::{GridIndex, SpaceGrid, UNIT_M};

/// Cells along the radius. Three suffice for a smooth space; a fold asks for more, and five would be 1,014 solves.
const CELLS: i32 = 4;

/// The lattice, with points that are counted in [`UNIT_M`] too.
#[derive(Debug, Clone)]
pub struct FallbackLattice {
    /// The lattice.
    pub grid: SpaceGrid,
    /// Units of a step.
    pub spacing: i32,
}

impl FallbackLattice {
    /// The lattice within `radius_m`, with the corners outside the ball. `None` if the radius is no ball of so many
    /// cells.
    pub fn within(radius_m: f64) -> Option<Self> {
        // Rounded up: a spacing that is a little too small would make a cell more.
        let spacing = (radius_m / UNIT_M / f64::from(CELLS) - 1e-6).ceil() as i32;
        let grid = SpaceGrid::new(f64::from(spacing) * UNIT_M, radius_m).ok()?;
        Some(Self { grid, spacing })
    }

    /// The records of its points among those of the space, counted in its own steps, in their order.
    pub fn records(&self, of_space: &[Record]) -> Vec<Record> {
        of_space.iter().filter_map(|record| self.own(record)).collect()
    }

    /// A record in steps of the lattice; `None` if its point is not one of the lattice's. Of the search's own points
    /// only rest is.
    pub(super) fn own(&self, record: &Record) -> Option<Record> {
        let steps = |index: GridIndex| index.map(|n| n / self.spacing);
        let index = steps(record.index);
        let is_own =
            record.index == index.map(|n| n * self.spacing) && self.grid.lattice.slot(index).is_some();
        let parent = record.parent.map(|(parent, attempt)| (steps(parent), attempt));
        is_own.then(|| Record { index, parent, ..record.clone() })
    }
}
