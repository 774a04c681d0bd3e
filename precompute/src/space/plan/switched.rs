//! The lattice that takes over where the search stalls.
//!
//! Folds are what a lattice is good at: neighbours on different branches are found, solved again from the other side and flagged, and the
//! table does not smooth over them; an error at a fold stays in its cells. Its points are those of the lattice of a micrometre too, so that one store
//! holds what the search solved and what the lattice did.

use std::sync::Arc;

use palpate_core::ConfigTag;

use super::Plan;
use crate::space::record::Record;
use crate::space::task::{TagCounts, Task};
use crate::spec::{Domain, GridIndex, SpaceGrid, UNIT_M, Wanted};

/// Cells along the radius. Three suffice for a smooth space; a fold asks for more, and five would be 1,014 solves.
const CELLS: i32 = 4;

/// A lattice space whose points are counted in [`UNIT_M`].
#[derive(Debug)]
pub struct Switched {
    wanted: Wanted,
    plan: Plan,
    grid: SpaceGrid,
    /// Spacing in units.
    spacing: i32,
}

impl Switched {
    /// The lattice of what is wanted, with its rest known. `None` if the radius is no ball of so many cells.
    pub(super) fn new(wanted: Wanted, rest: &Record) -> Option<Self> {
        let (grid, spacing) = Self::within(wanted.radius_m)?;
        let mut plan = Plan::new(Arc::new(Domain::new(&grid, true)), grid);
        // The first task is the rest, which the search has solved.
        plan.next_task()?;
        plan.decide(rest);
        Some(Self { wanted, plan, grid, spacing })
    }

    /// The lattice that would take over within `radius_m`, corners outside the ball included, and its spacing in units.
    pub fn within(radius_m: f64) -> Option<(SpaceGrid, i32)> {
        // Rounded up: a spacing that is a little too small would make a cell more.
        let spacing = (radius_m / UNIT_M / f64::from(CELLS) - 1e-6).ceil() as i32;
        let grid = SpaceGrid::new(f64::from(spacing) * UNIT_M, radius_m).ok()?;
        Some((grid, spacing))
    }

    /// The lattice.
    pub fn grid(&self) -> &SpaceGrid {
        &self.grid
    }

    /// The units that a step of the lattice is.
    pub fn spacing(&self) -> i32 {
        self.spacing
    }

    /// The records of its points among those of the space, counted in its own steps, in their order.
    pub fn records(&self, of_space: &[Record]) -> Vec<Record> {
        of_space.iter().filter_map(|record| self.own(record)).collect()
    }

    /// Its points by tag, the rest point not counted.
    pub fn counts(&self) -> TagCounts {
        self.plan.counts()
    }

    pub(super) fn round(&self) -> u32 {
        self.plan.round()
    }

    pub(super) fn is_done(&self) -> bool {
        self.plan.is_done()
    }

    pub(super) fn is_solving_again(&self) -> bool {
        self.plan.is_solving_again()
    }

    pub(super) fn next_task(&mut self) -> Option<Task> {
        let task = self.plan.next_task()?;
        let in_units = |index: GridIndex| index.map(|n| n * self.spacing);
        let parent = task.parent.map(|(parent, attempt)| (in_units(parent), attempt));
        Some(Task { target: in_units(task.target), parent, ..task })
    }

    pub(super) fn decide(&mut self, record: &Record) {
        let Some(mut record) = self.own(record) else { return };
        let at = self.grid.displacement_m(record.index);
        if record.tag == ConfigTag::Expandable && !self.wanted.lattice_goes_on_from(at, record.force_n) {
            // As at the force limit: solved, and nothing is solved from it.
            record.tag = ConfigTag::Terminating;
        }
        self.plan.decide(&record);
    }

    /// A record in steps of the lattice; `None` if its point is none of the lattice's: the search's own are not, but for rest.
    fn own(&self, record: &Record) -> Option<Record> {
        let steps = |index: GridIndex| index.map(|n| n / self.spacing);
        let index = steps(record.index);
        let is_own =
            record.index == index.map(|n| n * self.spacing) && self.grid.lattice.slot(index).is_some();
        let parent = record.parent.map(|(parent, attempt)| (steps(parent), attempt));
        is_own.then(|| Record { index, parent, ..record.clone() })
    }
}
