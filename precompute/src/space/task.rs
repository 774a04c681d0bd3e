//! One solve of a space, and the counts of their outcomes.

use palpate_core::ConfigTag;

use crate::num::sequence::split_mix;
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

impl Task {
    /// Whether the stability is determined also where the solver makes no factor: of the rest point, of a point that
    /// is solved again, and of one in `every` others, pseudo-random: what the sample shows holds for all.
    pub(super) fn checks_stability(&self, active: u32, every: u64) -> bool {
        let mix = |hash: u64, n: u32| split_mix(hash ^ u64::from(n));
        let hash = self.target.iter().fold(split_mix(active.into()), |hash, &n| mix(hash, n as u32));
        self.parent.is_none() || self.attempt > 0 || hash.is_multiple_of(every)
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_in_so_many_configurations_is_checked_and_every_later_attempt() {
        let task = |n: i32, attempt| {
            let target = [n % 7, n / 7 % 7, n / 49];
            Task { target, attempt, round: 1, parent: Some(([0; 3], 0)), chart: None }
        };
        for active in 0..4 {
            let checked = |every| (1..=343).filter(|&n| task(n, 0).checks_stability(active, every)).count();
            assert_eq!(checked(1), 343);
            assert!((60..112).contains(&checked(4)), "{} of 343", checked(4));
            assert!((1..=343).all(|n| task(n, 1).checks_stability(active, 4)));
        }
        let rest = Task { parent: None, ..task(0, 0) };
        assert!((0..9).all(|active| rest.checks_stability(active, 4)));
    }
}
