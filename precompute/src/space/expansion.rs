//! Runs the plans of one or several spaces on an executor and stores the results.
//!
//! A resumed run walks the same plans. A task that is already in the store is not solved again.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::AtomicBool;

use super::executor::{Dispatcher, Executor, ExecutorError};
use super::job::{Done, Job, Work};
use super::plan::{Phase, SolvesLeft, SpacePlan};
use super::plans::Plans;
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use super::task::{TagCounts, Task};
use crate::adaptive::STREAK;
use crate::spec::GridIndex;

/// The spaces to expand.
#[derive(Debug, Clone)]
pub struct Expansion {
    /// Active nodes by their number in the store.
    pub actives: Vec<usize>,
}

/// Progress after each result.
#[derive(Debug, Clone, Copy)]
pub struct Progress {
    /// Points by tag, over all spaces.
    pub counts: TagCounts,
    /// Number of points of all spaces without the rest points; `None` for adaptive sampling, where it is not
    /// known in advance.
    pub total: Option<usize>,
    /// Adaptive sampling: current and required length of the validation streak, summed over all spaces.
    pub passes: Option<(usize, usize)>,
    /// Finished spaces and number of spaces.
    pub spaces: (usize, usize),
    /// Number of the first unfinished space, from 1.
    pub space: usize,
    /// What is solved in it.
    pub phase: Phase,
    /// Number of spaces whose search a fallback lattice has replaced.
    pub taken_over: usize,
    /// Attempts in the store, over all spaces begun.
    pub tried: usize,
    /// Estimate of the attempts that are still needed, over all spaces.
    pub left: SolvesLeft,
    /// Highest round of any space so far.
    pub round: u32,
    /// Attempts solved in this run (not read from the store).
    pub solved_now: usize,
    /// Points of failed attempts or of branch jumps are being solved again in the first unfinished space.
    pub again: bool,
    /// Solves still running after a stop request.
    pub stopping: Option<usize>,
}

/// Why an expansion ended early.
#[derive(Debug)]
pub enum ExpansionError {
    /// The store failed.
    Store(StoreError),
    /// The body has no equilibrium at rest: it is not fixed, or the mesh is unusable.
    Rest(String),
    /// A stop was requested; all finished work is committed.
    Interrupted,
    /// The workers failed.
    Executor(ExecutorError),
}

impl std::fmt::Display for ExpansionError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Store(error) => write!(f, "{error}"),
            Self::Rest(failure) => {
                write!(
                    f,
                    "the body cannot be solved at rest: {failure}; fix at least three nodes off one line"
                )
            }
            Self::Interrupted => {
                write!(
                    f,
                    "interrupted; every finished configuration is kept, run the same command to continue"
                )
            }
            Self::Executor(error) => write!(f, "{error}"),
        }
    }
}

impl std::error::Error for ExpansionError {}

impl From<StoreError> for ExpansionError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<ExecutorError> for ExpansionError {
    fn from(error: ExecutorError) -> Self {
        Self::Executor(error)
    }
}

/// A space in progress.
struct Space {
    plan: SpacePlan,
    /// The next task, if it has been determined.
    ahead: Option<Task>,
    /// Outcomes of earlier runs that the plan has not requested yet.
    known: HashMap<(GridIndex, u32), Record>,
    counted: TagCounts,
    passed: usize,
    /// Attempts in the store.
    tried: usize,
}

impl Space {
    /// The space of an active node with the outcomes of earlier runs.
    fn begin(store: &Store, plans: &Plans, active: usize) -> Result<Self, ExpansionError> {
        let known = store.attempts(active)?;
        store.check_states(active)?;
        let finished = store.finished(active)?.map(|state| SpacePlan::Finished(Box::new(state)));
        let is_kept = finished.is_some();
        let mut space = Self {
            tried: known.len(),
            plan: finished.unwrap_or_else(|| plans.plan(active)),
            ahead: None,
            known: known.into_iter().map(|r| ((r.index, r.attempt), r)).collect(),
            counted: TagCounts { unknown: plans.points().unwrap_or(0), ..TagCounts::default() },
            passed: 0,
        };
        space.ahead = space.next(store)?;
        if let Some(state) = space.state().filter(|_| !is_kept) {
            store.finish(active, &state)?;
        }
        Ok(space)
    }

    /// The state of the space if nothing is left to solve.
    fn state(&self) -> Option<SpaceState> {
        self.plan.is_done().then(|| self.plan.state(0))
    }

    /// Records an outcome. Returns the state of the space if this outcome was the last one. It determines the
    /// next task first, so that outcome and state are stored together.
    fn take(&mut self, record: &Record, store: &Store) -> Result<Option<SpaceState>, ExpansionError> {
        self.plan.decide(record);
        self.tried += 1;
        if self.ahead.is_none() {
            self.ahead = self.next(store)?;
        }
        Ok(self.state())
    }

    /// The next task to solve. Tasks that earlier runs solved are answered from the store.
    fn next(&mut self, store: &Store) -> Result<Option<Task>, ExpansionError> {
        if let Some(task) = self.ahead.take() {
            return Ok(Some(task));
        }
        while let Some(task) = self.plan.next_task() {
            let Some(record) = self.known.remove(&(task.target, task.attempt)) else { return Ok(Some(task)) };
            if record.parent != task.parent || record.round != task.round {
                let what = format!(
                    "point {:?} was solved by a plan that differs from that of this version",
                    task.target
                );
                return Err(store.corrupt(what).into());
            }
            expect_rest(&record)?;
            self.plan.decide(&record);
        }
        Ok(None)
    }
}

/// An error if the rest point failed, in this run or an earlier one: without it there is no space.
fn expect_rest(record: &Record) -> Result<(), ExpansionError> {
    match &record.result {
        Err(failure) if record.parent.is_none() => Err(ExpansionError::Rest(failure.clone())),
        _ => Ok(()),
    }
}

/// The finished spaces of an expansion, which predict the spaces that wait.
#[derive(Debug, Default)]
struct Ended {
    /// Points of a space without its rest point; `None` for adaptive sampling.
    points: Option<usize>,
    spaces: usize,
    tried: usize,
    taken_over: usize,
}

impl Ended {
    fn add(&mut self, space: &Space) {
        self.spaces += 1;
        self.tried += space.tried;
        self.taken_over += usize::from(space.plan.phase() == Phase::FallbackLattice);
    }

    /// Estimate of the solves of this number of other spaces.
    fn left(&self, waiting: usize) -> SolvesLeft {
        match (self.points, waiting) {
            (_, 0) => SolvesLeft::About(0),
            (Some(points), _) => SolvesLeft::About(waiting * (1 + points)),
            (None, _) if self.spaces > 0 => SolvesLeft::About(waiting * self.tried / self.spaces),
            (None, _) => SolvesLeft::AtLeast(waiting * (1 + STREAK)),
        }
    }
}

impl Expansion {
    /// Runs to the end, or until `stop` is set. Calls `progress` on the calling thread. Returns the points by
    /// tag of each space.
    pub fn run(
        &self,
        store: &Store,
        executor: &mut dyn Executor,
        stop: &AtomicBool,
        mut progress: impl FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, ExpansionError> {
        let outcome = self.run_to_commit(store, executor, stop, &mut progress);
        // Finished work is committed however the run ended. The first error is returned.
        let committed = store.commit();
        let counts = outcome?;
        committed?;
        Ok(counts)
    }

    fn run_to_commit(
        &self,
        store: &Store,
        executor: &mut dyn Executor,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, ExpansionError> {
        let plans = Plans::of(store)?;
        let mut shift = Dispatcher::new(executor, store, stop);
        // Spaces in progress, by position in `actives`. A new space starts only when those in progress have
        // no certain task. So a worker keeps its active node, and only a few plans are in memory.
        let mut spaces: BTreeMap<usize, Space> = BTreeMap::new();
        let mut begun = 0;
        let mut finished: Vec<Option<TagCounts>> = vec![None; self.actives.len()];
        let total = plans.points().map(|points| self.actives.len() * points);
        let mut state = Progress::begin(total, self.actives.len());
        let mut ended = Ended { points: plans.points(), ..Ended::default() };
        state.look_at(&spaces, &ended);
        progress(&state);
        loop {
            while let Some((worker, last)) = shift.free() {
                let prefer = last.and_then(|active| self.position_of(active));
                let Some((at, task)) = self.next_task(store, &plans, &mut spaces, &mut begun, prefer)? else {
                    break;
                };
                let active = self.actives[at];
                let seed = match task.parent {
                    Some((parent, attempt)) => Some(store.stored_seed(active, parent, attempt)?),
                    None => None,
                };
                shift.give(worker, active, Work::Point(Job { active: active as u32, task, seed }))?;
            }
            let done: Vec<usize> =
                spaces.iter().filter(|(_, s)| s.plan.is_done()).map(|(&at, _)| at).collect();
            for &at in &done {
                if let Some(mut space) = spaces.remove(&at) {
                    state.account(&mut space);
                    state.spaces.0 += 1;
                    finished[at] = Some(space.plan.counts());
                    ended.add(&space);
                    state.look_at(&spaces, &ended);
                    progress(&state);
                }
            }
            if !done.is_empty() && !shift.is_stopping() {
                continue;
            }
            if shift.out() == 0 {
                break;
            }
            let done = shift.take::<ExpansionError>()?;
            state.stopping = shift.stopping();
            let Some(done) = done else {
                progress(&state);
                continue;
            };
            let Done::Point(outcome) = done else { return Err(ExecutorError::UnexpectedResult.into()) };
            let at = self.position_of(outcome.active as usize).unwrap_or(usize::MAX);
            let mut space = spaces.get_mut(&at);
            let taken = match (expect_rest(&outcome.record), &mut space) {
                (Ok(()), Some(space)) => space.take(&outcome.record, store),
                (rest, _) => rest.map(|()| None),
            };
            // The outcome is stored even if the space cannot use it.
            store.add(&outcome, taken.as_ref().ok().and_then(Option::as_ref))?;
            taken?;
            if let Some(space) = space {
                state.solved_now += 1;
                state.account(space);
                state.look_at(&spaces, &ended);
                progress(&state);
            }
        }
        if shift.is_stopping() && finished.iter().any(Option::is_none) {
            return Err(ExpansionError::Interrupted);
        }
        Ok(finished.into_iter().flatten().collect())
    }

    fn position_of(&self, active: usize) -> Option<usize> {
        self.actives.iter().position(|&a| a == active)
    }

    /// A task of the space of the worker's last active node; otherwise of any space in progress; otherwise of
    /// a new one.
    fn next_task(
        &self,
        store: &Store,
        plans: &Plans,
        spaces: &mut BTreeMap<usize, Space>,
        begun: &mut usize,
        prefer: Option<usize>,
    ) -> Result<Option<(usize, Task)>, ExpansionError> {
        let others = spaces.keys().copied().filter(|at| Some(*at) != prefer);
        for at in prefer.into_iter().chain(others).collect::<Vec<_>>() {
            let Some(space) = spaces.get_mut(&at) else { continue };
            if let Some(task) = space.next(store)? {
                return Ok(Some((at, task)));
            }
        }
        // A space that earlier runs finished is removed before the next one starts.
        if *begun < self.actives.len() && spaces.values().all(|space| !space.plan.is_done()) {
            let at = *begun;
            *begun += 1;
            let mut space = Space::begin(store, plans, self.actives[at])?;
            let task = space.next(store)?;
            spaces.insert(at, space);
            if let Some(task) = task {
                return Ok(Some((at, task)));
            }
        }
        Ok(None)
    }
}

impl Progress {
    /// Of this number of spaces before the first solve; `total` as in [`Self::total`].
    fn begin(total: Option<usize>, spaces: usize) -> Self {
        Self {
            counts: TagCounts { unknown: total.unwrap_or(0), ..TagCounts::default() },
            total,
            passes: total.is_none().then_some((0, STREAK * spaces)),
            spaces: (0, spaces),
            space: 1,
            phase: if total.is_some() { Phase::Lattice } else { Phase::Search },
            taken_over: 0,
            tried: 0,
            left: SolvesLeft::About(0),
            round: 0,
            solved_now: 0,
            again: false,
            stopping: None,
        }
    }

    /// Adds what changed in a space since the last call.
    fn account(&mut self, space: &mut Space) {
        let (old, new) = (space.counted, space.plan.counts());
        let mut sum = self.counts;
        sum += new;
        self.counts = TagCounts {
            expandable: sum.expandable - old.expandable,
            terminating: sum.terminating - old.terminating,
            failed: sum.failed - old.failed,
            unknown: sum.unknown - old.unknown,
        };
        space.counted = new;
        if let (Some((sum, _)), Some(passed)) = (&mut self.passes, space.plan.passes()) {
            // The streak of a finished space counts as complete.
            let passed = if space.plan.is_done() { STREAK } else { passed };
            *sum = *sum + passed - std::mem::replace(&mut space.passed, passed);
        }
        self.round = self.round.max(space.plan.round());
    }

    /// Describes the spaces in progress, by position in the expansion, and the work left.
    fn look_at(&mut self, spaces: &BTreeMap<usize, Space>, ended: &Ended) {
        let is_taken_over = |space: &&Space| space.plan.phase() == Phase::FallbackLattice;
        self.taken_over = ended.taken_over + spaces.values().filter(is_taken_over).count();
        self.tried = ended.tried + spaces.values().map(|space| space.tried).sum::<usize>();
        if let Some((at, first)) = spaces.first_key_value() {
            self.space = at + 1;
            self.phase = first.plan.phase();
            self.again = first.plan.is_solving_again();
        }
        let waiting = self.spaces.1 - ended.spaces - spaces.len();
        let begun = spaces.values().map(|space| space.plan.left()).fold(SolvesLeft::About(0), |a, b| a + b);
        self.left = begun + ended.left(waiting);
    }
}

#[cfg(test)]
mod tests;
