//! Selects the next solve of one space. The selection is a pure function of the lattice and the outcomes, not
//! of the order in which they arrive.
//!
//! **Expansion** (paper, 5.1). The rest point has level 0. An undecided point p has level r if the lowest
//! level of the expandable points that can be its parent is r - 1. Its parent is the best of those. The
//! result is that of rounds with a barrier between them. But a point is issued as soon as its level and
//! parent are certain, so that no worker waits for the end of a round. The `floor` of a point is one more
//! than the lowest level that any of its neighbours has or can still get. A point is certain when an
//! expandable neighbour has level `floor` - 1 and every neighbour that could still get this level is decided.
//! Floors are shortest paths from the expandable and pending points through the undecided ones. They only
//! rise, so an outdated floor only delays a point.
//!
//! **Retries.** When no expansion is left, every failed point is tried from its other solved neighbours, one
//! after the other until one succeeds. A point that becomes expandable then opens a new level.
//!
//! **Branch jumps.** When no retry is left, the points of flagged pairs ([`crate::fit::BranchJump`]) are
//! solved again from another parent. A second repetition follows where the other end of such a pair has found
//! a better solution. The solution of lowest energy of each point is kept, and every attempt is recorded.

use std::collections::VecDeque;
use std::sync::Arc;

use palpate_core::ConfigTag;

use super::{Phase, PlanStatus, SolvesLeft, SpacePlan};
use crate::fit::flagged_pairs;
use crate::space::record::Record;
use crate::space::task::{TagCounts, Task};
use crate::spec::{Domain, REST, SpaceGrid};

/// Maximum number of repeated solves of a point of a flagged pair.
const MAX_JUMP_ATTEMPTS: usize = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Expand,
    Retry,
    BranchJump,
    Done,
}

/// State of one point.
#[derive(Debug, Clone)]
struct Point {
    /// Level at which it was or is being solved.
    level: u32,
    /// Lower bound on the level of an undecided point.
    floor: u32,
    /// An attempt is in flight.
    pending: bool,
    /// In the queue of certain points.
    queued: bool,
    /// Parents tried, each with the attempt whose solution was used; one entry per attempt.
    tried: Vec<(u32, u32)>,
    /// The first attempt made because of a branch jump.
    first_at_fold: Option<u32>,
    /// Parents to try in this phase, each with the attempt whose solution is used, the next one last. The
    /// list is fixed at the start of the phase, so that solutions found meanwhile have no influence.
    left: Vec<(u32, u32)>,
    /// The accepted solution; the last failure if there is none.
    kept: Option<Record>,
}

impl Point {
    fn tag(&self) -> ConfigTag {
        self.kept.as_ref().map_or(ConfigTag::Unknown, Record::tag)
    }

    /// The attempt of the accepted solution.
    fn solution(&self) -> u32 {
        self.kept.as_ref().map_or(0, |record| record.attempt)
    }

    fn is_source(&self) -> bool {
        self.pending || self.tag() == ConfigTag::Expandable
    }
}

/// Level of a point that cannot be reached.
const NEVER: u32 = u32::MAX;

/// The plan of one space.
#[derive(Debug)]
pub(crate) struct Plan {
    domain: Arc<Domain>,
    grid: SpaceGrid,
    points: Vec<Point>,
    stage: Stage,
    /// Certain points that are not issued yet.
    ready: VecDeque<u32>,
    pending: usize,
    /// A point was decided that opens no other: floors may have risen.
    floors_stale: bool,
    /// Highest level so far.
    round: u32,
    counts: TagCounts,
}

impl Plan {
    /// Plan with nothing solved.
    pub(crate) fn new(domain: Arc<Domain>, grid: SpaceGrid) -> Self {
        let blank = Point {
            level: NEVER,
            floor: 0,
            pending: false,
            queued: false,
            tried: Vec::new(),
            first_at_fold: None,
            left: Vec::new(),
            kept: None,
        };
        let counts = TagCounts { unknown: domain.count() - 1, ..TagCounts::default() };
        Self {
            points: vec![blank; domain.count()],
            domain,
            grid,
            stage: Stage::Expand,
            ready: VecDeque::from([REST]),
            pending: 0,
            floors_stale: true,
            round: 0,
            counts,
        }
    }

    /// Estimate of the solves that are still needed: the undecided points, and the attempts of the present
    /// round of repeated solves.
    fn left(&self) -> usize {
        let is_fold = self.stage == Stage::BranchJump;
        let again = self.points.iter().filter(|point| is_fold || !point.tag().is_solved());
        match self.stage {
            Stage::Expand => self.counts.unknown,
            Stage::Retry | Stage::BranchJump => {
                self.pending + again.map(|point| point.left.len()).sum::<usize>()
            }
            Stage::Done => 0,
        }
    }

    fn begin_task(&mut self, p: u32) -> Task {
        let parent = match self.stage {
            Stage::Expand => {
                let level = self.points[p as usize].floor;
                self.points[p as usize].level = level;
                self.round = self.round.max(level);
                self.best_parent(p)
            }
            _ => self.points[p as usize].left.pop(),
        };
        let round = if self.stage == Stage::Expand { self.points[p as usize].level } else { self.round };
        let from = parent.map(|(w, attempt)| (self.domain.index(w), attempt));
        let point = &mut self.points[p as usize];
        let attempt = point.tried.len() as u32;
        point.tried.push(parent.unwrap_or((REST, 0)));
        if self.stage == Stage::BranchJump {
            point.first_at_fold.get_or_insert(attempt);
        }
        point.pending = true;
        point.queued = false;
        self.pending += 1;
        Task { target: self.domain.index(p), attempt, round, parent: from, chart: None }
    }

    /// The best parent of the lowest level. The list is sorted, best first.
    fn best_parent(&self, p: u32) -> Option<(u32, u32)> {
        let floor = self.points[p as usize].floor;
        let solution = |w: u32| {
            let parent = &self.points[w as usize];
            let fits = parent.tag() == ConfigTag::Expandable && parent.level + 1 == floor;
            fits.then(|| (w, parent.solution()))
        };
        self.domain.parents(p).iter().find_map(|&w| solution(w))
    }

    fn queue(&mut self, p: u32) {
        if !self.points[p as usize].queued {
            self.points[p as usize].queued = true;
            self.ready.push_back(p);
        }
    }

    /// Queues a point whose level and parent can no longer change.
    fn release_if_decided(&mut self, p: u32) {
        let point = &self.points[p as usize];
        if point.pending || point.kept.is_some() || point.floor == 0 || point.floor == NEVER {
            return;
        }
        let below = point.floor - 1;
        let mut reached = false;
        for &w in self.domain.parents(p) {
            let parent = &self.points[w as usize];
            if parent.pending {
                if parent.level <= below {
                    return;
                }
            } else if parent.kept.is_none() {
                if parent.floor <= below {
                    return;
                }
            } else if parent.tag() == ConfigTag::Expandable && parent.level == below {
                reached = true;
            }
        }
        if reached {
            self.queue(p);
        }
    }

    /// Recomputes all floors by levels, and queues every point that is certain.
    fn raise_floors(&mut self) {
        self.floors_stale = false;
        let mut buckets: Vec<Vec<u32>> = Vec::new();
        let put = |buckets: &mut Vec<Vec<u32>>, level: u32, p: u32| {
            let level = level as usize;
            if buckets.len() <= level {
                buckets.resize(level + 1, Vec::new());
            }
            buckets[level].push(p);
        };
        for p in 0..self.points.len() as u32 {
            let point = &mut self.points[p as usize];
            point.floor = NEVER;
            if point.is_source() && self.domain.in_ball(p) {
                let level = point.level;
                put(&mut buckets, level, p);
            }
        }
        let mut level = 0;
        while level < buckets.len() {
            for w in std::mem::take(&mut buckets[level]) {
                // A point reached again at a higher level was already processed at the lower one.
                if !self.points[w as usize].is_source() && self.points[w as usize].floor < level as u32 {
                    continue;
                }
                for &p in self.domain.children(w) {
                    let point = &mut self.points[p as usize];
                    let undecided = point.kept.is_none() && !point.pending;
                    if undecided && (level as u32 + 1) < point.floor {
                        point.floor = level as u32 + 1;
                        if self.domain.in_ball(p) {
                            put(&mut buckets, level as u32 + 1, p);
                        }
                    }
                }
            }
            level += 1;
        }
        for p in 1..self.points.len() as u32 {
            self.release_if_decided(p);
        }
    }

    /// Queues failed points with the solved neighbours they were not tried from, expandable ones first.
    fn begin_retries(&mut self) {
        let opened = self.round + 1;
        for p in 1..self.points.len() as u32 {
            if self.points[p as usize].tag() != ConfigTag::Failed {
                continue;
            }
            let tried = &self.points[p as usize].tried;
            let mut left = Vec::new();
            for tag in [ConfigTag::Terminating, ConfigTag::Expandable] {
                for &w in self.domain.parents(p).iter().rev() {
                    let parent = &self.points[w as usize];
                    if parent.tag() == tag && !tried.iter().any(|(from, _)| *from == w) {
                        left.push((w, parent.solution()));
                    }
                }
            }
            if !left.is_empty() {
                self.round = opened;
                self.points[p as usize].left = left;
                self.queue(p);
            }
        }
    }

    /// Queues points of flagged pairs, each with one solution of a neighbour that it was not tried from.
    ///
    /// In the first repetition that is the other end of a flagged pair, or any other neighbour if the point
    /// was solved from there. The second repetition requires that the other end has found a better solution
    /// since: a persistent branch jump is not tried again.
    fn begin_jump_attempts(&mut self) {
        let solved = |record: &Record| record.jet(self.grid.displacement_m(record.index));
        let at = |index| solved(self.points[self.domain.position(index)? as usize].kept.as_ref()?);
        let kept = self.points.iter().filter_map(|p| p.kept.as_ref());
        let points = kept.filter_map(|record| Some((record.index, solved(record)?)));
        let mut partners: Vec<Vec<u32>> = vec![Vec::new(); self.points.len()];
        for fold in flagged_pairs(points, at) {
            let [a, b] = [fold.from, fold.to].map(|index| self.domain.position(index).expect("a point"));
            partners[a as usize].push(b);
            partners[b as usize].push(a);
        }
        let opened = self.round + 1;
        for p in 1..self.points.len() as u32 {
            let (point, partners) = (&self.points[p as usize], &partners[p as usize]);
            let tries = point.first_at_fold.map_or(0, |first| point.tried.len() - first as usize);
            if partners.is_empty() || tries >= MAX_JUMP_ATTEMPTS {
                continue;
            }
            let first_time = tries == 0;
            let candidate = |w: &u32| {
                let other = &self.points[*w as usize];
                let solution = other.solution();
                let found_since = other.first_at_fold.is_some_and(|first| solution >= first);
                let usable = other.tag().is_solved() && !point.tried.contains(&(*w, solution));
                (usable && (first_time || found_since)).then_some((*w, solution))
            };
            let all = self.domain.parents(p);
            let suspect = all.iter().filter(|w| partners.contains(w)).find_map(candidate);
            let another = || all.iter().filter(|_| first_time).find_map(candidate);
            if let Some(from) = suspect.or_else(another) {
                self.round = opened;
                self.points[p as usize].left = vec![from];
                self.queue(p);
            }
        }
    }
}

impl SpacePlan for Plan {
    fn next_task(&mut self) -> Option<Task> {
        loop {
            if let Some(point) = self.ready.pop_front() {
                return Some(self.begin_task(point));
            }
            if self.stage == Stage::Expand && self.floors_stale {
                self.raise_floors();
                if !self.ready.is_empty() {
                    continue;
                }
            }
            if self.pending > 0 || self.stage == Stage::Done {
                return None;
            }
            self.stage = match self.stage {
                Stage::Expand => Stage::Retry,
                Stage::Retry => Stage::BranchJump,
                Stage::BranchJump | Stage::Done => Stage::Done,
            };
            match self.stage {
                Stage::Retry => self.begin_retries(),
                Stage::BranchJump => self.begin_jump_attempts(),
                Stage::Expand | Stage::Done => {}
            }
        }
    }

    /// # Panics
    ///
    /// If no attempt at that point is in flight.
    fn decide(&mut self, record: &Record) {
        let p = self.domain.position(record.index).expect("a task's target is a point of the domain");
        let point = &mut self.points[p as usize];
        assert!(point.pending, "{:?} was not handed out", record.index);
        point.pending = false;
        self.pending -= 1;
        let before = point.tag();
        if super::supersedes(record, point.kept.as_ref()) {
            point.kept = Some(record.clone());
        }
        let after = point.tag();
        if p != REST {
            *self.counts.of(before) -= 1;
            *self.counts.of(after) += 1;
        }
        let in_ball = self.domain.in_ball(p);
        let opens = in_ball && after == ConfigTag::Expandable && before != after;
        match self.stage {
            Stage::Expand if opens => {
                let domain = self.domain.clone();
                for &child in domain.children(p) {
                    self.release_if_decided(child);
                }
            }
            Stage::Expand => self.floors_stale |= in_ball,
            Stage::Retry | Stage::BranchJump => {
                if opens {
                    self.points[p as usize].level = self.round;
                }
                let settled = self.stage == Stage::BranchJump || after.is_solved();
                if !settled && !self.points[p as usize].left.is_empty() {
                    self.queue(p);
                } else if self.pending == 0 && self.ready.is_empty() {
                    // Points that this round opened are expanded before further retries.
                    self.stage = Stage::Expand;
                    self.floors_stale = true;
                }
            }
            Stage::Done => {}
        }
    }

    fn is_done(&self) -> bool {
        self.stage == Stage::Done
    }

    fn status(&self) -> PlanStatus {
        let is_solving_again = matches!(self.stage, Stage::Retry | Stage::BranchJump);
        let (phase, left) = (Phase::Lattice, SolvesLeft::About(self.left()));
        PlanStatus { counts: self.counts, phase, is_solving_again, left, passes: 0 }
    }
}

#[cfg(test)]
mod tests;
