//! Selection of the next solve in one space.

mod adaptive;
mod lattice;
mod switched;

pub(crate) use adaptive::ScatteredPlan;
pub use lattice::Plan;

use super::record::Record;
use super::state::SpaceState;
use super::task::{TagCounts, Task};
use crate::adaptive::STREAK;

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

/// The plan of one space.
#[derive(Debug)]
pub(crate) enum SpacePlan {
    /// Of a lattice.
    Lattice(Box<Plan>),
    /// Of adaptive sampling.
    Scattered(Box<ScatteredPlan>),
    /// Of a space with nothing left to solve.
    Finished(Box<SpaceState>),
}

impl SpacePlan {
    /// The next certain task. `None` while outstanding results decide what is next, or when all is done.
    pub(crate) fn next_task(&mut self) -> Option<Task> {
        match self {
            Self::Lattice(plan) => plan.next_task(),
            Self::Scattered(plan) => plan.next_task(),
            Self::Finished(_) => None,
        }
    }

    /// Records the outcome of a task.
    pub(crate) fn decide(&mut self, record: &Record) {
        match self {
            Self::Lattice(plan) => plan.decide(record),
            Self::Scattered(plan) => plan.decide(record),
            Self::Finished(_) => {}
        }
    }

    /// Points by tag, without the rest point.
    pub(crate) fn counts(&self) -> TagCounts {
        match self {
            Self::Lattice(plan) => plan.counts(),
            Self::Scattered(plan) => plan.counts(),
            Self::Finished(state) => state.counts,
        }
    }

    /// Highest level, round or batch so far.
    pub(crate) fn round(&self) -> u32 {
        match self {
            Self::Lattice(plan) => plan.round(),
            Self::Scattered(plan) => plan.round(),
            Self::Finished(_) => 0,
        }
    }

    /// Whether failed points or those at branch jumps are being solved again.
    pub(crate) fn is_solving_again(&self) -> bool {
        match self {
            Self::Lattice(plan) => plan.is_solving_again(),
            Self::Scattered(plan) => plan.is_solving_again(),
            Self::Finished(_) => false,
        }
    }

    /// What is being solved.
    pub(crate) fn phase(&self) -> Phase {
        match self {
            Self::Lattice(_) => Phase::Lattice,
            Self::Scattered(plan) if plan.is_taken_over() => Phase::FallbackLattice,
            Self::Finished(state) if state.fallback().is_some() => Phase::FallbackLattice,
            Self::Finished(state) if state.fit.is_none() => Phase::Lattice,
            Self::Scattered(_) | Self::Finished(_) => Phase::Search,
        }
    }

    /// Estimate of the solves that are still needed.
    pub(crate) fn left(&self) -> SolvesLeft {
        match self {
            Self::Lattice(plan) => SolvesLeft::About(plan.left()),
            Self::Scattered(plan) => plan.left(),
            Self::Finished(_) => SolvesLeft::About(0),
        }
    }

    /// Whether nothing is left to do.
    pub(crate) fn is_done(&self) -> bool {
        match self {
            Self::Lattice(plan) => plan.is_done(),
            Self::Scattered(plan) => plan.is_done(),
            Self::Finished(_) => true,
        }
    }

    /// Length of the validation streak of adaptive sampling; `None` on a lattice.
    pub(crate) fn passes(&self) -> Option<usize> {
        match self {
            Self::Lattice(_) => None,
            Self::Scattered(plan) => Some(plan.passes().min(STREAK)),
            Self::Finished(state) => state.fit.as_ref().map(|_| STREAK),
        }
    }

    /// The state of the space with `open` open attempts.
    pub(super) fn state(&self, open: usize) -> SpaceState {
        let fit = match self {
            Self::Lattice(_) => None,
            Self::Scattered(plan) => plan.fit(),
            Self::Finished(state) => return SpaceState::clone(state),
        };
        SpaceState { open, counts: self.counts(), fit }
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
