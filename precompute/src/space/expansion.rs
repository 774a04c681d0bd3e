//! Solves one or several spaces on an executor and stores the results.
//!
//! The plan of a space chooses its next tasks. A resumed run goes through the same plans. A task that is
//! already in the store is not solved again.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::AtomicBool;

use super::executor::{Dispatcher, Executor};
use super::job::{Done, ExecutorError, Job, Work};
use super::plan::{Phase, SolvesLeft, SpacePlan};
use super::plans::Plans;
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use super::task::{TagCounts, Task};
use crate::adaptive::STREAK;
use crate::spec::GridIndex;

/// Progress after each result.
#[derive(Debug, Clone, Copy)]
pub struct Progress {
    /// Points by tag, over all spaces.
    pub counts: TagCounts,
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
    /// Attempts solved in this run (not read from the store).
    pub solved_now: usize,
    /// Points of failed attempts or of branch jumps are being solved again in the first unfinished space.
    pub again: bool,
    /// Solves still running after a stop request.
    pub stopping: Option<usize>,
}

/// Why an expansion ended early.
#[derive(Debug, thiserror::Error)]
pub enum ExpansionError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The body has no equilibrium at rest: it is not fixed, or the mesh is unusable.
    #[error(
        "the body cannot be solved at rest ({0}); check the constants and units of the material, and fix at least three \
         nodes that are not on one line"
    )]
    Rest(String),
    /// A stop was requested; all finished work is committed.
    #[error("interrupted; every finished configuration is kept, run the same command to continue")]
    Interrupted,
    /// The workers failed.
    #[error(transparent)]
    Executor(#[from] ExecutorError),
}

/// A space in progress.
struct Space {
    plan: Box<dyn SpacePlan>,
    /// The next task, if it has been determined.
    ahead: Option<Task>,
    /// Outcomes of earlier runs that the plan has not requested yet.
    known: HashMap<(GridIndex, u32), Record>,
    /// Attempts in the store.
    tried: usize,
    /// Whether the body must have an equilibrium at zero displacement. A chart without one has no table.
    needs_rest: bool,
}

impl Space {
    /// The space of an active node with the outcomes of earlier runs.
    fn begin(store: &Store, plans: &Plans, active: usize) -> Result<Self, ExpansionError> {
        let known = store.attempts(active)?;
        store.check_states(active)?;
        let finished = store.finished(active)?;
        let is_kept = finished.is_some();
        let mut space = Self {
            needs_rest: !plans.are_charts(),
            tried: known.len(),
            plan: match finished {
                Some(state) => Box::new(state),
                None => plans.plan(store, active)?,
            },
            ahead: None,
            known: known.into_iter().map(|r| ((r.index, r.attempt), r)).collect(),
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

    /// Records an outcome and finds the next task. If there is none, returns the final state of the space,
    /// which the caller stores together with this outcome.
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
            if self.needs_rest {
                expect_rest(&record)?;
            }
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

/// Totals over the finished spaces; they estimate the solves of the spaces not yet begun.
#[derive(Debug, Default)]
struct Ended {
    spaces: usize,
    counts: TagCounts,
    tried: usize,
    taken_over: usize,
}

impl Ended {
    fn add(&mut self, space: &Space) -> TagCounts {
        let status = space.plan.status();
        self.spaces += 1;
        self.counts += status.counts;
        self.tried += space.tried;
        self.taken_over += usize::from(status.phase == Phase::FallbackLattice);
        status.counts
    }

    /// Estimate of the solves of `waiting` unstarted spaces.
    fn left(&self, points: Option<usize>, waiting: usize) -> SolvesLeft {
        match points {
            _ if waiting == 0 => SolvesLeft::About(0),
            Some(points) => SolvesLeft::About(waiting * (1 + points)),
            None if self.spaces > 0 => SolvesLeft::About(waiting * self.tried / self.spaces),
            None => SolvesLeft::AtLeast(waiting * (1 + STREAK)),
        }
    }
}

/// Expands the spaces of these active nodes (by their numbers in the store) to the end, or until `stop` is
/// set. Calls `progress` on the calling thread. Returns the points by tag of each space.
pub fn expand(
    actives: &[usize],
    store: &Store,
    executor: &mut dyn Executor,
    stop: &AtomicBool,
    mut progress: impl FnMut(&Progress),
) -> Result<Vec<TagCounts>, ExpansionError> {
    let plans = Plans::of(store)?;
    let (spaces, ended) = (BTreeMap::new(), Ended::default());
    let mut expansion = Expansion { actives, store, plans, spaces, begun: 0, ended, solved_now: 0 };
    let outcome = expansion.run(&mut Dispatcher::new(executor, store, stop), &mut progress);
    // Finished work is committed however the run ended. The first error is returned.
    let committed = store.commit();
    let counts = outcome?;
    committed?;
    Ok(counts)
}

struct Expansion<'a> {
    actives: &'a [usize],
    store: &'a Store,
    plans: Plans,
    /// Spaces in progress, by position in `actives`. A new space starts only when those in progress have no
    /// task ready. So a worker keeps its active node, and only a few plans are in memory.
    spaces: BTreeMap<usize, Space>,
    /// Number of spaces begun.
    begun: usize,
    ended: Ended,
    solved_now: usize,
}

impl Expansion<'_> {
    fn run(
        &mut self,
        dispatcher: &mut Dispatcher<'_>,
        progress: &mut dyn FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, ExpansionError> {
        let mut finished: Vec<Option<TagCounts>> = vec![None; self.actives.len()];
        let mut state = self.progress(None);
        progress(&state);
        loop {
            self.give_tasks(dispatcher)?;
            let done: Vec<usize> =
                self.spaces.iter().filter(|(_, s)| s.plan.is_done()).map(|(&at, _)| at).collect();
            for &at in &done {
                if let Some(space) = self.spaces.remove(&at) {
                    finished[at] = Some(self.ended.add(&space));
                    state = self.progress(Some(&state));
                    progress(&state);
                }
            }
            if !done.is_empty() && !dispatcher.is_stopping() {
                continue;
            }
            if dispatcher.is_idle() {
                break;
            }
            let done = dispatcher.take::<ExpansionError>()?;
            if let Some(done) = done {
                let Done::Point(outcome) = done else { return Err(ExecutorError::UnexpectedResult.into()) };
                let at = self.position_of(outcome.active as usize).unwrap_or(usize::MAX);
                let mut space = self.spaces.get_mut(&at);
                let rest = if self.plans.are_charts() { Ok(()) } else { expect_rest(&outcome.record) };
                let taken = match (rest, &mut space) {
                    (Ok(()), Some(space)) => space.take(&outcome.record, self.store),
                    (rest, _) => rest.map(|()| None),
                };
                // The outcome is stored even if the space cannot use it.
                self.store.add(&outcome, taken.as_ref().ok().and_then(Option::as_ref))?;
                taken?;
                self.solved_now += 1;
                state = self.progress(Some(&state));
            }
            state.stopping = dispatcher.busy_after_stop();
            progress(&state);
        }
        if dispatcher.is_stopping() && finished.iter().any(Option::is_none) {
            return Err(ExpansionError::Interrupted);
        }
        Ok(finished.into_iter().flatten().collect())
    }

    fn position_of(&self, active: usize) -> Option<usize> {
        self.actives.iter().position(|&a| a == active)
    }

    /// Gives every free worker a task.
    fn give_tasks(&mut self, dispatcher: &mut Dispatcher<'_>) -> Result<(), ExpansionError> {
        while let Some((worker, last)) = dispatcher.free() {
            let prefer = last.and_then(|active| self.position_of(active));
            let Some((at, task)) = self.next_task(prefer)? else { break };
            let active = self.actives[at];
            let seed = match task.parent {
                Some((parent, attempt)) => {
                    let solver = task.chart.map_or(active, |chart| chart as usize);
                    let from_m = self.plans.origin_m(active, task.chart);
                    Some(self.store.stored_seed(solver, parent, attempt)?.moved_by(from_m))
                }
                None => None,
            };
            dispatcher.give(worker, active, Work::Point(Job { active: active as u32, task, seed }))?;
        }
        Ok(())
    }

    /// A task of the space of the worker's last active node; otherwise of any space in progress; otherwise of
    /// a new one.
    fn next_task(&mut self, prefer: Option<usize>) -> Result<Option<(usize, Task)>, ExpansionError> {
        let others = self.spaces.keys().copied().filter(|at| Some(*at) != prefer);
        for at in prefer.into_iter().chain(others).collect::<Vec<_>>() {
            let Some(space) = self.spaces.get_mut(&at) else { continue };
            if let Some(task) = space.next(self.store)? {
                return Ok(Some((at, task)));
            }
        }
        // A space that earlier runs finished is removed before the next one starts.
        if self.begun < self.actives.len() && self.spaces.values().all(|space| !space.plan.is_done()) {
            let at = self.begun;
            let is_open = |other: usize| self.spaces.keys().any(|at| self.actives[*at] == other);
            if self.plans.before(self.actives[at]).any(is_open) {
                return Ok(None);
            }
            self.begun += 1;
            let mut space = Space::begin(self.store, &self.plans, self.actives[at])?;
            let task = space.next(self.store)?;
            self.spaces.insert(at, space);
            return Ok(task.map(|task| (at, task)));
        }
        Ok(None)
    }

    /// The progress; if no space is in progress, number and phase are those of `last`.
    fn progress(&self, last: Option<&Progress>) -> Progress {
        let (all, points) = (self.actives.len(), self.plans.points());
        let waiting = all - self.ended.spaces - self.spaces.len();
        let mut counts = self.ended.counts;
        counts.unknown += waiting * points.unwrap_or(0);
        let first_phase = if points.is_some() { Phase::Lattice } else { Phase::Search };
        let (mut space, mut phase, mut again) =
            last.map_or((1, first_phase, false), |last| (last.space, last.phase, last.again));
        let (mut passed, mut taken_over, mut tried) =
            (STREAK * self.ended.spaces, self.ended.taken_over, self.ended.tried);
        let mut left = self.ended.left(points, waiting);
        for (at, each) in self.spaces.iter().rev() {
            let status = each.plan.status();
            counts += status.counts;
            // The streak of a finished space counts as complete.
            passed += if each.plan.is_done() { STREAK } else { status.passes };
            taken_over += usize::from(status.phase == Phase::FallbackLattice);
            tried += each.tried;
            left = status.left + left;
            (space, phase, again) = (at + 1, status.phase, status.is_solving_again);
        }
        Progress {
            counts,
            passes: points.is_none().then_some((passed, STREAK * all)),
            spaces: (self.ended.spaces, all),
            space,
            phase,
            taken_over,
            tried,
            left,
            solved_now: self.solved_now,
            again,
            stopping: last.and_then(|last| last.stopping),
        }
    }
}

#[cfg(test)]
mod tests;
