//! One solve of a space, and how many of them came to what.

use palpate_core::ConfigTag;

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
