//! Selection of the next solve in one space.

mod adaptive;
mod lattice;
mod switched;

pub(crate) use adaptive::ScatteredPlan;
pub(crate) use lattice::Plan;

use super::record::Record;
use super::state::SpaceState;
use super::task::{TagCounts, Task};
use crate::adaptive::{AdaptiveFit, STREAK};

/// What is solved in a space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// The positions of adaptive sampling.
    Search,
    /// The lattice that the scene specifies.
    Lattice,
    /// The lattice that replaces an adaptive search that stagnates.
    FallbackLattice,
}

/// Number of solves that are still needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolvesLeft {
    /// An estimate. Points behind the force limit are counted, repeated solves that are not certain are not.
    About(usize),
    /// A lower bound: an adaptive search ends when its predictions are within tolerance.
    AtLeast(usize),
}

impl std::ops::Add for SolvesLeft {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        match (self, other) {
            (Self::About(a), Self::About(b)) => Self::About(a + b),
            (Self::About(a) | Self::AtLeast(a), Self::About(b) | Self::AtLeast(b)) => Self::AtLeast(a + b),
        }
    }
}

/// How far a plan has come.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlanStatus {
    /// Points by tag, without the rest point.
    pub counts: TagCounts,
    /// What is solved.
    pub phase: Phase,
    /// Failed points or those at branch jumps are being solved again.
    pub is_solving_again: bool,
    /// Estimate of the solves that are still needed.
    pub left: SolvesLeft,
    /// Length of the validation streak of adaptive sampling, at most [`STREAK`]; 0 on a lattice.
    pub passes: usize,
}

/// The plan of one space.
pub(crate) trait SpacePlan {
    /// The next certain task. `None` while outstanding results decide what is next, or when all is done.
    fn next_task(&mut self) -> Option<Task>;

    /// Records the outcome of a task.
    fn decide(&mut self, record: &Record);

    /// Whether nothing is left to do.
    fn is_done(&self) -> bool;

    /// How far the plan has come.
    fn status(&self) -> PlanStatus;

    /// The fit of adaptive sampling; `None` on a lattice and before rest is solved.
    fn fit(&self) -> Option<AdaptiveFit> {
        None
    }

    /// The state of the space with `open` open attempts.
    fn state(&self, open: usize) -> SpaceState {
        SpaceState { open, counts: self.status().counts, fit: self.fit() }
    }
}

/// The plan of a space with nothing left to solve.
impl SpacePlan for SpaceState {
    fn next_task(&mut self) -> Option<Task> {
        None
    }

    fn decide(&mut self, _: &Record) {}

    fn is_done(&self) -> bool {
        true
    }

    fn status(&self) -> PlanStatus {
        let phase = match &self.fit {
            None => Phase::Lattice,
            Some(_) if self.fallback().is_some() => Phase::FallbackLattice,
            Some(_) => Phase::Search,
        };
        let (is_solving_again, left) = (false, SolvesLeft::About(0));
        PlanStatus { counts: self.counts, phase, is_solving_again, left, passes: STREAK }
    }

    fn fit(&self) -> Option<AdaptiveFit> {
        self.fit.clone()
    }
}

/// Relative difference below which two energies belong to one solution.
const SAME_ENERGY: f64 = 1e-6;

/// Whether an attempt at a point replaces the accepted one: a solution replaces a failure, a lower energy a
/// higher one.
pub(super) fn supersedes(new: &Record, kept: Option<&Record>) -> bool {
    let energy_j = |record: &Record| record.equilibrium().map(|at| at.energy_j);
    let Some(kept) = kept.and_then(energy_j) else { return true };
    energy_j(new).is_some_and(|new| new < kept - SAME_ENERGY * kept.abs())
}
