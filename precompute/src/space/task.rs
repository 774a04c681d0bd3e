//! One solve of a space, and the counts of their outcomes.

use palpate_core::ConfigTag;

use crate::spec::GridIndex;

/// One configuration to solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Task {
    /// The point.
    pub target: GridIndex,
    /// Number of the attempt at this point, from 0.
    pub attempt: u32,
    /// Level of the expansion, or round of retries or of repeated solves at branch jumps.
    pub round: u32,
    /// Start of the transition: a point and the attempt whose solution is used; `None` for the rest point.
    pub parent: Option<(GridIndex, u32)>,
    /// The chart that solved the parent, if it is another one; the parent's index is in its displacements.
    pub chart: Option<u32>,
}

/// Number of points by tag.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TagCounts {
    /// Solved and reachable.
    pub expandable: usize,
    /// Solved, beyond the force limit.
    pub terminating: usize,
    /// Not solvable from any neighbour tried.
    pub failed: usize,
    /// Not decided yet. At the end: points that terminating or failed points cut off.
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
