//! Replays a solved expansion without solving: the throughput of rank 0 alone.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::time::{Duration, Instant};

use palpate_precompute::space::{Done, Executor, ExecutorError, Outcome, Record, Store, Work, state};
use palpate_precompute::spec::{Lattice, SpaceGrid};
use serde::Serialize;

use super::simulated::Try;
use crate::failure::Failure;

/// Wall-clock cost of an attempt on rank 0.
#[derive(Debug, Serialize)]
pub(super) struct RankZero {
    /// Attempts per second.
    pub tries_per_second: f64,
    /// Microseconds per attempt.
    pub us_per_try: f64,
    /// Mean size of a job's message, bytes.
    pub job_bytes: f64,
    /// Mean size of an outcome's message, bytes.
    pub outcome_bytes: f64,
}

/// A complete space in memory.
#[derive(Debug)]
pub(super) struct Replay {
    /// Its grid.
    pub grid: SpaceGrid,
    /// Whether cells were completed.
    pub complete_cells: bool,
    /// Active nodes with solved points.
    pub actives: Vec<usize>,
    /// All attempts.
    pub records: HashMap<Try, Record>,
    /// The outcomes in the form that workers send.
    messages: HashMap<Try, Vec<u8>>,
}

impl Replay {
    /// Reads a complete store. States between grid points are omitted.
    pub(super) fn load(path: &Path) -> Result<Self, Failure> {
        let store = Store::open(path)?;
        let identity = store.identity()?;
        let Lattice { grid, complete_cells, .. } = *identity
            .sampling
            .lattice()
            .ok_or_else(|| Failure::input(format!("{}: not a lattice", path.display())))?;
        let (mut actives, mut records, mut messages) = (Vec::new(), HashMap::new(), HashMap::new());
        for active in 0..store.active()?.len() {
            let attempts = store.attempts(active)?;
            if attempts.is_empty() {
                continue;
            }
            if state(&store, active)?.open > 0 {
                return Err(Failure::input(format!(
                    "{}: the space is not finished; run `palpate precompute` first",
                    path.display()
                )));
            }
            actives.push(active);
            for record in attempts {
                let key = (active as u32, record.index, record.attempt);
                let seed = match record.tag().is_solved() {
                    true => Some(store.stored_seed(active, record.index, record.attempt)?),
                    false => None,
                };
                let outcome =
                    Outcome { active: active as u32, record: record.clone(), seed, intermediate: Vec::new() };
                messages.insert(
                    key,
                    postcard::to_stdvec(&Done::Point(Box::new(outcome))).map_err(Failure::work)?,
                );
                records.insert(key, record);
            }
        }
        Ok(Self { grid, complete_cells, actives, records, messages })
    }

    /// Seconds of every solve, sorted.
    pub(super) fn seconds(&self) -> Vec<f64> {
        let mut seconds: Vec<f64> = self.records.values().map(|r| r.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        seconds
    }

    /// Times `expand` with an executor that has every outcome immediately.
    pub(super) fn measure(
        &self,
        expand: impl FnOnce(&mut dyn Executor) -> Result<(), Failure>,
    ) -> Result<RankZero, Failure> {
        let mut executor =
            AtOnce { replay: self, done: VecDeque::new(), tries: 0, job_bytes: 0, outcome_bytes: 0 };
        let start = Instant::now();
        expand(&mut executor)?;
        let seconds = start.elapsed().as_secs_f64();
        let tries = executor.tries.max(1) as f64;
        Ok(RankZero {
            tries_per_second: tries / seconds,
            us_per_try: 1e6 * seconds / tries,
            job_bytes: executor.job_bytes as f64 / tries,
            outcome_bytes: executor.outcome_bytes as f64 / tries,
        })
    }
}

/// Some workers that take no time.
struct AtOnce<'r> {
    replay: &'r Replay,
    done: VecDeque<(usize, Try)>,
    tries: usize,
    job_bytes: usize,
    outcome_bytes: usize,
}

impl Executor for AtOnce<'_> {
    fn size(&self) -> usize {
        8
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        let bytes = postcard::to_stdvec(&work).map_err(|error| ExecutorError::Lost(error.to_string()))?;
        let Work::Point(job) = work else {
            return Err(ExecutorError::Lost("only points are replayed".into()));
        };
        self.job_bytes += bytes.len();
        self.tries += 1;
        self.done.push_back((worker, (job.active, job.task.target, job.task.attempt)));
        Ok(())
    }

    fn take(&mut self, _: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        let (worker, at) =
            self.done.pop_front().ok_or_else(|| ExecutorError::Lost("nothing is out".into()))?;
        let unknown = || ExecutorError::Lost(format!("the file has no attempt {} at {:?}", at.2, at.1));
        let bytes = self.replay.messages.get(&at).ok_or_else(unknown)?;
        self.outcome_bytes += bytes.len();
        let done = postcard::from_bytes(bytes).map_err(|error| ExecutorError::Lost(error.to_string()))?;
        Ok(Some((worker, done)))
    }

    fn stop(&mut self) {}
}
