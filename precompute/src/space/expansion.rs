//! Runs the plans of one or many spaces with a crew, and keeps what comes back.
//!
//! Resuming is nothing special: the same plans are walked, and a task that the store already holds is not done again.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::AtomicBool;

use super::crew::{Crew, CrewError, Shift};
use super::job::{Done, Job, Work};
use super::plan::SpacePlan;
use super::plans::Plans;
use super::record::Record;
use super::state::SpaceState;
use super::store::{Store, StoreError};
use super::task::{TagCounts, Task};
use crate::adaptive::PASSES;
use crate::spec::GridIndex;

/// The spaces to expand.
#[derive(Debug, Clone)]
pub struct Expansion {
    /// Active nodes, by their number in the store.
    pub actives: Vec<usize>,
}

/// What a caller is told after every outcome.
#[derive(Debug, Clone, Copy)]
pub struct Progress {
    /// Points by tag, over all spaces.
    pub counts: TagCounts,
    /// Points of all spaces, the rest points not counted; not known beforehand where they are scattered.
    pub total: Option<usize>,
    /// Where they are scattered: predictions that passed since the last that did not, and how many must, over all spaces.
    pub passes: Option<(usize, usize)>,
    /// Spaces that are done, and all of them.
    pub spaces: (usize, usize),
    /// Highest round of a space so far.
    pub round: u32,
    /// Tries of this run, not found in the store.
    pub solved_now: usize,
    /// Points of failed tries and of folds are being solved again: how many is not known beforehand.
    pub again: bool,
    /// Solves that are waited for, once it was asked to stop.
    pub stopping: Option<usize>,
}

/// Why an expansion ended early.
#[derive(Debug)]
pub enum ExpansionError {
    /// The store failed.
    Store(StoreError),
    /// The body has no equilibrium at rest: it is not held, or the mesh is not usable.
    Rest(String),
    /// Asked to stop; everything finished is committed.
    Interrupted,
    /// The workers failed.
    Crew(CrewError),
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
                write!(f, "interrupted; every finished configuration is kept, run the same command to go on")
            }
            Self::Crew(error) => write!(f, "{error}"),
        }
    }
}

impl std::error::Error for ExpansionError {}

impl From<StoreError> for ExpansionError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<CrewError> for ExpansionError {
    fn from(error: CrewError) -> Self {
        Self::Crew(error)
    }
}

/// A space in progress.
struct Space {
    plan: SpacePlan,
    /// The next task, if it was looked for already.
    ahead: Option<Task>,
    /// Outcomes of earlier runs that the plan has not asked for yet.
    known: HashMap<(GridIndex, u32), Record>,
    counted: TagCounts,
    passed: usize,
}

impl Space {
    /// The space of an active node with what earlier runs solved of it.
    fn begin(store: &Store, plans: &Plans, active: usize) -> Result<Self, ExpansionError> {
        let known = store.attempts(active)?;
        store.check_states(active)?;
        let finished = store.finished(active)?.map(|state| SpacePlan::Finished(Box::new(state)));
        let is_kept = finished.is_some();
        let mut space = Self {
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

    /// Takes an outcome. The state of the space if that was the last one: the next task is looked for, so that both are kept together.
    fn take(&mut self, record: &Record, store: &Store) -> Result<Option<SpaceState>, ExpansionError> {
        self.plan.decide(record);
        if self.ahead.is_none() {
            self.ahead = self.next(store)?;
        }
        Ok(self.state())
    }

    /// The next task that must be done now; those of earlier runs are answered from the store on the way.
    fn next(&mut self, store: &Store) -> Result<Option<Task>, ExpansionError> {
        if let Some(task) = self.ahead.take() {
            return Ok(Some(task));
        }
        while let Some(task) = self.plan.next_task() {
            let Some(record) = self.known.remove(&(task.target, task.attempt)) else { return Ok(Some(task)) };
            if record.parent != task.parent || record.round != task.round {
                let what = format!("point {:?} was not solved as this version would", task.target);
                return Err(store.corrupt(what).into());
            }
            expect_rest(&record)?;
            self.plan.decide(&record);
        }
        Ok(None)
    }
}

/// Without a rest there is no space, whether that was found now or by an earlier run.
fn expect_rest(record: &Record) -> Result<(), ExpansionError> {
    match &record.failure {
        Some(failure) if record.parent.is_none() => Err(ExpansionError::Rest(failure.clone())),
        _ => Ok(()),
    }
}

impl Expansion {
    /// Runs to the end, or until `stop` is raised. `progress` is called on this thread. Returns the points by tag, a space each.
    pub fn run(
        &self,
        store: &Store,
        crew: &mut dyn Crew,
        stop: &AtomicBool,
        mut progress: impl FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, ExpansionError> {
        let outcome = self.run_to_commit(store, crew, stop, &mut progress);
        // Whatever ended it: what is done is kept. The first error is the one that matters.
        let committed = store.commit();
        let counts = outcome?;
        committed?;
        Ok(counts)
    }

    fn run_to_commit(
        &self,
        store: &Store,
        crew: &mut dyn Crew,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, ExpansionError> {
        let plans = Plans::of(store)?;
        let mut shift = Shift::new(crew, store, stop);
        // Spaces in hand, by position in `actives`. A space is begun only when those in hand have nothing certain to do, so that
        // a worker stays with its active node and only a few plans are in memory.
        let mut spaces: BTreeMap<usize, Space> = BTreeMap::new();
        let mut begun = 0;
        let mut finished: Vec<Option<TagCounts>> = vec![None; self.actives.len()];
        let total = plans.points().map(|points| self.actives.len() * points);
        let mut state = Progress {
            counts: TagCounts { unknown: total.unwrap_or(0), ..TagCounts::default() },
            total,
            passes: total.is_none().then_some((0, PASSES * self.actives.len())),
            spaces: (0, self.actives.len()),
            round: 0,
            solved_now: 0,
            again: false,
            stopping: None,
        };
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
            let Done::Point(outcome) = done else { return Err(CrewError::Confused.into()) };
            let at = self.position_of(outcome.active as usize).unwrap_or(usize::MAX);
            let mut space = spaces.get_mut(&at);
            let taken = match (expect_rest(&outcome.record), &mut space) {
                (Ok(()), Some(space)) => space.take(&outcome.record, store),
                (rest, _) => rest.map(|()| None),
            };
            // What was solved is kept, whatever is wrong beside it.
            store.add(&outcome, taken.as_ref().ok().and_then(Option::as_ref))?;
            taken?;
            if let Some(space) = space {
                state.solved_now += 1;
                state.account(space);
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

    /// A task of the space the worker knows, or else of any space in hand, or else of a new one.
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
        // A space that earlier runs finished is let go of before the next one is begun.
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
    /// Takes over what changed in a space since it was last looked at.
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
            // Those of a space that is done have passed, whatever the last ones of it said.
            let passed = if space.plan.is_done() { PASSES } else { passed };
            *sum = *sum + passed - std::mem::replace(&mut space.passed, passed);
        }
        self.round = self.round.max(space.plan.round());
        self.again = space.plan.is_solving_again();
    }
}

#[cfg(test)]
mod tests;
