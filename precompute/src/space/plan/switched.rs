//! The lattice that replaces a stagnating search.
//!
//! A lattice handles branch jumps well. It finds neighbours on different branches, solves them again from the
//! other side and flags them. The table does not interpolate across a flagged pair, so an error at a branch
//! jump stays in its cells.

use std::sync::Arc;

use super::{Plan, SpacePlan};
use crate::space::fallback::FallbackLattice;
use crate::space::record::{Record, Solution};
use crate::space::task::Task;
use crate::spec::{Domain, GridIndex, Requirements};

/// The plan of the fallback lattice.
#[derive(Debug)]
pub(super) struct Switched {
    wanted: Requirements,
    pub(super) plan: Plan,
    lattice: FallbackLattice,
}

impl Switched {
    /// The plan for `wanted` with its rest point solved. `None` if the radius is not a valid multiple of the
    /// spacing.
    pub(super) fn new(wanted: Requirements, rest: &Record) -> Option<Self> {
        let lattice = FallbackLattice::within(wanted.radius_m)?;
        let mut plan = Plan::new(Arc::new(Domain::new(&lattice.grid, true)), lattice.grid);
        // The first task is the rest point, which the search has solved.
        plan.next_task()?;
        plan.decide(rest);
        Some(Self { wanted, plan, lattice })
    }

    pub(super) fn next_task(&mut self) -> Option<Task> {
        let task = self.plan.next_task()?;
        let in_units = |index: GridIndex| index.map(|n| n * self.lattice.spacing);
        let parent = task.parent.map(|(parent, attempt)| (in_units(parent), attempt));
        Some(Task { target: in_units(task.target), parent, ..task })
    }

    pub(super) fn decide(&mut self, record: &Record) {
        let Some(mut record) = self.lattice.own(record) else { return };
        let at = self.lattice.grid.displacement_m(record.index);
        if let Ok(Solution { equilibrium, .. }) = &mut record.result {
            // Beyond the tool's reach as at the force limit: no other point is solved from this one.
            equilibrium.terminating |= !self.wanted.lattice_goes_on_from(at, equilibrium.force_n);
        }
        self.plan.decide(&record);
    }
}
