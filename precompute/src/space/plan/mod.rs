//! What to solve next, in one space: tasks, and the plans that make them.

mod adaptive;
mod lattice;
mod switched;

pub use adaptive::ScatteredPlan;
pub use lattice::Plan;
pub use switched::Switched;

use palpate_core::ConfigTag;

use super::Record;
use crate::adaptive::PASSES;
use crate::spec::GridIndex;

/// One configuration to solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Task {
    /// Where.
    pub target: GridIndex,
    /// 0 for the first try of a point, then counting.
    pub attempt: u32,
    /// Level, or round of retries or folds.
    pub round: u32,
    /// Where the transition starts: a point, and which of its solutions; `None` for the rest point.
    pub parent: Option<(GridIndex, u32)>,
}

/// Number of points by tag.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TagCounts {
    /// Solved, reachable.
    pub expandable: usize,
    /// Solved, beyond the force limit.
    pub terminating: usize,
    /// Not solvable from any neighbour tried.
    pub failed: usize,
    /// Not decided yet; at the end: behind terminating or failed points.
    pub unknown: usize,
}

impl TagCounts {
    /// Solved configurations.
    pub fn solved(&self) -> usize {
        self.expandable + self.terminating
    }

    pub(crate) fn of(&mut self, tag: ConfigTag) -> &mut usize {
        match tag {
            ConfigTag::Expandable => &mut self.expandable,
            ConfigTag::Terminating => &mut self.terminating,
            ConfigTag::Failed => &mut self.failed,
            ConfigTag::Unknown => &mut self.unknown,
        }
    }
}

impl std::ops::AddAssign for TagCounts {
    fn add_assign(&mut self, other: Self) {
        self.expandable += other.expandable;
        self.terminating += other.terminating;
        self.failed += other.failed;
        self.unknown += other.unknown;
    }
}

/// The plan of one space.
#[derive(Debug)]
pub enum SpacePlan {
    /// Of a lattice.
    Lattice(Box<Plan>),
    /// Of scattered positions.
    Scattered(Box<ScatteredPlan>),
}

impl SpacePlan {
    /// The next task that is certain; `None` while what is out must come back first, or when all is done.
    pub fn next_task(&mut self) -> Option<Task> {
        match self {
            Self::Lattice(plan) => plan.next_task(),
            Self::Scattered(plan) => plan.next_task(),
        }
    }

    /// Takes the outcome of a task that was handed out.
    pub fn decide(&mut self, record: &Record) {
        match self {
            Self::Lattice(plan) => plan.decide(record),
            Self::Scattered(plan) => plan.decide(record),
        }
    }

    /// Points by tag, the rest point not counted.
    pub fn counts(&self) -> TagCounts {
        match self {
            Self::Lattice(plan) => plan.counts(),
            Self::Scattered(plan) => plan.counts(),
        }
    }

    /// Highest level, round or batch so far.
    pub fn round(&self) -> u32 {
        match self {
            Self::Lattice(plan) => plan.round(),
            Self::Scattered(plan) => plan.round(),
        }
    }

    /// Whether failed points or those at folds are being solved once more.
    pub fn is_solving_again(&self) -> bool {
        match self {
            Self::Lattice(plan) => plan.is_solving_again(),
            Self::Scattered(plan) => plan.is_solving_again(),
        }
    }

    /// Whether nothing is left to do.
    pub fn is_done(&self) -> bool {
        match self {
            Self::Lattice(plan) => plan.is_done(),
            Self::Scattered(plan) => plan.is_done(),
        }
    }

    /// Predictions that passed, of those that must, where the space is scattered.
    pub fn passes(&self) -> Option<usize> {
        match self {
            Self::Lattice(_) => None,
            Self::Scattered(plan) => Some(plan.search().map_or(0, |search| search.passes().min(PASSES))),
        }
    }
}

/// Energies closer than this share are one solution.
const SAME_ENERGY: f64 = 1e-6;

/// Whether a later attempt at a point counts instead of the one kept so far: any solution instead of none, a lower energy
/// instead of a higher one.
pub(super) fn supersedes(new: &Record, kept: Option<&Record>) -> bool {
    match kept {
        None => true,
        Some(kept) if !kept.tag.is_solved() => true,
        Some(kept) => {
            let least = SAME_ENERGY * kept.energy_j.abs();
            new.tag.is_solved() && new.energy_j < kept.energy_j - least
        }
    }
}
