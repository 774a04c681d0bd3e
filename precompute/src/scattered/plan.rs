//! A search as tasks of a configuration space.

use std::collections::{HashMap, VecDeque};

use super::{Found, Search, Step, Target, Verdict, Wanted, displacement_m};
use crate::configuration_space::plan::{TagCounts, Task};
use crate::configuration_space::{GridIndex, Plans, Record, SpacePlan, Store, StoreError};
use crate::fit::EnergyJet;

/// The point at rest.
const REST: GridIndex = [0; 3];

/// The plan of one scattered space: the counterpart of [`crate::configuration_space::plan::Plan`].
#[derive(Debug)]
pub struct ScatteredPlan {
    wanted: Wanted,
    /// None before the rest is known.
    search: Option<Search>,
    /// What the search learned from, in its order: parents are counted in it.
    learned: Vec<GridIndex>,
    /// The batch that is out.
    batch: Vec<Target>,
    found: HashMap<GridIndex, Found>,
    ready: VecDeque<Task>,
    counts: TagCounts,
    round: u32,
    verdict: Option<Verdict>,
}

impl ScatteredPlan {
    /// Plan with nothing solved.
    pub fn new(wanted: Wanted) -> Self {
        Self {
            wanted,
            search: None,
            learned: Vec::new(),
            batch: Vec::new(),
            found: HashMap::new(),
            ready: VecDeque::from([Task { target: REST, attempt: 0, round: 0, parent: None }]),
            counts: TagCounts::default(),
            round: 0,
            verdict: None,
        }
    }

    /// The search so far; `None` before the rest is known.
    pub fn search(&self) -> Option<&Search> {
        self.search.as_ref()
    }

    /// How it ended, once it has.
    pub fn verdict(&self) -> Option<Verdict> {
        self.verdict
    }

    /// Points by tag, the rest point not counted.
    pub fn counts(&self) -> TagCounts {
        self.counts
    }

    /// Batches so far.
    pub fn round(&self) -> u32 {
        self.round
    }

    /// Whether nothing is left to do.
    pub fn is_done(&self) -> bool {
        self.verdict.is_some()
    }

    /// The next task; `None` while the batch must come back first, or when all is done.
    pub fn next_task(&mut self) -> Option<Task> {
        if self.ready.is_empty() && self.batch.is_empty() && self.verdict.is_none() {
            self.begin_batch();
        }
        self.ready.pop_front()
    }

    fn begin_batch(&mut self) {
        let Some(search) = &mut self.search else { return };
        match search.step() {
            Step::Done(verdict) => self.verdict = Some(verdict),
            Step::Solve(targets) => {
                self.round += 1;
                let round = self.round;
                let task = |target: &Target| {
                    let parent = Some((self.learned[target.parent], 0));
                    Task { target: target.index, attempt: 0, round, parent }
                };
                self.ready = targets.iter().map(task).collect();
                self.batch = targets;
            }
        }
    }

    /// Takes the outcome of a task that was handed out.
    pub fn decide(&mut self, record: &Record) {
        let Some(search) = &mut self.search else {
            if record.tag.is_solved() {
                self.search = Some(Search::new(self.wanted, &jet(record)));
                self.learned.push(REST);
            } else {
                self.verdict = Some(Verdict::NotReached);
            }
            return;
        };
        *self.counts.of(record.tag) += 1;
        let found = match record.tag.is_solved() {
            false => Found::Failed,
            true if record.switched => Found::Elsewhere(jet(record)),
            true => Found::Solved(jet(record)),
        };
        self.found.insert(record.index, found);
        if self.batch.iter().all(|target| self.found.contains_key(&target.index)) {
            let batch = std::mem::take(&mut self.batch);
            let found: Vec<Found> = batch
                .iter()
                .map(|target| self.found.remove(&target.index).unwrap_or(Found::Failed))
                .collect();
            search.take(&found);
            let at = |jet: &EnergyJet| super::nearest_index(jet.displacement_m);
            self.learned = search.jets().iter().map(at).collect();
        }
    }
}

/// The plan of an active node as far as its store goes; `None` where it is a lattice.
pub fn planned(store: &Store, active: usize) -> Result<Option<ScatteredPlan>, StoreError> {
    Ok(match Plans::of(store)?.replayed(active, &store.attempts(active)?).0 {
        SpacePlan::Scattered(plan) => Some(*plan),
        SpacePlan::Lattice(_) => None,
    })
}

/// Its search; `None` without a rest.
pub fn searched(store: &Store, active: usize) -> Result<Option<Search>, StoreError> {
    Ok(planned(store, active)?.and_then(|plan| plan.search))
}

/// What a fit takes from a record; rest has no force by its definition.
fn jet(record: &Record) -> EnergyJet {
    let is_rest = record.index == REST;
    EnergyJet {
        displacement_m: displacement_m(record.index),
        energy_j: if is_rest { 0.0 } else { record.energy_j },
        force_n: if is_rest { [0.0; 3] } else { record.force_n },
        stiffness_n_m: record.stiffness_n_m,
        third_n_m2: record.third_n_m2,
    }
}
