//! Expansion of one configuration space (paper, sections 4.3 and 5.1), in rounds.
//!
//! Round 0 solves the rest point. Round r solves every unknown point that has an expandable neighbour (of the 26)
//! decided in an earlier round, from the parent that `parent_of` names. Which points a round holds and where each
//! starts from follow from the lattice and from the tags of earlier rounds alone, never from which worker was done
//! first; so one thread, many threads and any interrupted and resumed run give the same numbers. Resuming is nothing
//! special: the same rounds are walked, and a point that the store already holds is not solved again.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Instant;

use palpate_core::ConfigTag;

use super::store::{Record, Store, StoreError, StoredSeed};
use super::{GridIndex, SpaceGrid};
use crate::solve::{Problem, Solver};

/// Expansion of the space of one active node.
#[derive(Debug)]
pub struct Expansion {
    /// Body and active node.
    pub problem: Arc<Problem>,
    /// Which active node of the store this is.
    pub active: usize,
    /// Points to solve.
    pub grid: SpaceGrid,
    /// Force beyond which a configuration is terminating, N.
    pub max_force_n: f64,
    /// Worker threads.
    pub threads: usize,
}

/// Number of points by tag.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TagCounts {
    /// Solved, reachable.
    pub expandable: usize,
    /// Solved, beyond the force limit.
    pub terminating: usize,
    /// Not solvable from its parent.
    pub failed: usize,
    /// Not decided yet; at the end: behind terminating or failed points.
    pub unknown: usize,
}

impl TagCounts {
    /// Solved configurations.
    pub fn solved(&self) -> usize {
        self.expandable + self.terminating
    }

    fn move_to(&mut self, tag: ConfigTag) {
        self.unknown = self.unknown.saturating_sub(1);
        match tag {
            ConfigTag::Expandable => self.expandable += 1,
            ConfigTag::Terminating => self.terminating += 1,
            ConfigTag::Failed => self.failed += 1,
            ConfigTag::Unknown => self.unknown += 1,
        }
    }
}

/// What a caller is told after every decided point.
#[derive(Debug, Clone, Copy)]
pub struct Progress {
    /// Tags so far.
    pub counts: TagCounts,
    /// Round in progress.
    pub round: u32,
    /// Points of this run that were solved now, not found in the store.
    pub solved_now: usize,
}

/// Why an expansion ended early.
#[derive(Debug)]
pub enum ExpansionError {
    /// The store failed.
    Store(StoreError),
    /// The body has no equilibrium at rest: it is not held, or the mesh is not usable.
    Rest(crate::solve::SolveFailure),
    /// Asked to stop; everything finished is committed.
    Interrupted,
    /// A worker panicked.
    Worker,
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
            Self::Worker => write!(f, "a worker thread stopped on an internal error; please report it"),
        }
    }
}

impl std::error::Error for ExpansionError {}

impl From<StoreError> for ExpansionError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

/// One transition to solve.
#[derive(Debug, Clone, Copy)]
struct Transition {
    parent: GridIndex,
    target: GridIndex,
}

/// What a worker found.
type Outcome = Result<(Record, Option<StoredSeed>), StoreError>;

const NEIGHBOURS: [GridIndex; 26] = neighbours();

const fn neighbours() -> [GridIndex; 26] {
    let mut all = [[0; 3]; 26];
    let (mut n, mut code) = (0, 0);
    while code < 27 {
        let offset = [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1];
        if code != 13 {
            all[n] = offset;
            n += 1;
        }
        code += 1;
    }
    all
}

fn squared(index: GridIndex) -> i32 {
    index.iter().map(|n| n * n).sum()
}

fn plus(a: GridIndex, b: GridIndex) -> GridIndex {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// The parent of `target` among its expandable neighbours: the nearest, then the one closest to rest, then by index.
fn parent_of(target: GridIndex, tags: &HashMap<GridIndex, ConfigTag>) -> Option<GridIndex> {
    NEIGHBOURS
        .iter()
        .map(|&offset| (squared(offset), plus(target, offset)))
        .filter(|(_, index)| tags.get(index) == Some(&ConfigTag::Expandable))
        .min_by_key(|&(distance, index)| (distance, squared(index), index))
        .map(|(_, index)| index)
}

/// Lattice points still to be solved: undecided, with an expandable neighbour. Zero when the expansion has ended; points that
/// only terminating or failed ones surround are never reached and do not count.
pub fn still_to_solve(grid: &SpaceGrid, records: &[Record]) -> usize {
    let tags: HashMap<GridIndex, ConfigTag> = records.iter().map(|r| (r.index, r.tag)).collect();
    if !tags.contains_key(&[0; 3]) {
        return grid.lattice.count();
    }
    let open: std::collections::HashSet<GridIndex> = tags
        .iter()
        .filter(|(_, tag)| **tag == ConfigTag::Expandable)
        .flat_map(|(&index, _)| NEIGHBOURS.map(|step| plus(index, step)))
        .filter(|index| grid.lattice.contains(*index) && !tags.contains_key(index))
        .collect();
    open.len()
}

impl Expansion {
    /// Points of the grid, the rest point not counted.
    pub fn total(&self) -> usize {
        self.grid.lattice.count()
    }

    /// Runs to the end, or until `stop` is raised. `progress` is called on this thread.
    pub fn run(
        &self,
        store: &Store,
        stop: &AtomicBool,
        mut progress: impl FnMut(&Progress),
    ) -> Result<TagCounts, ExpansionError> {
        let known: HashMap<GridIndex, Record> =
            store.records(self.active)?.into_iter().map(|r| (r.index, r)).collect();
        let points: Vec<GridIndex> = self.grid.lattice.points().collect();
        let mut state = Progress {
            counts: TagCounts { unknown: points.len(), ..Default::default() },
            round: 0,
            solved_now: 0,
        };
        let mut tags = HashMap::with_capacity(points.len() + 1);
        if !known.contains_key(&[0; 3]) {
            self.solve_rest(store)?;
        }
        tags.insert([0; 3], ConfigTag::Expandable);
        loop {
            state.round += 1;
            let round: Vec<Transition> = points
                .iter()
                .filter(|target| !tags.contains_key(*target))
                .filter_map(|&target| parent_of(target, &tags).map(|parent| Transition { parent, target }))
                .collect();
            if round.is_empty() {
                return Ok(state.counts);
            }
            let (done, open): (Vec<_>, Vec<_>) =
                round.into_iter().partition(|t| known.contains_key(&t.target));
            // Tags are entered after the round only, so that no point of a round can be another's parent.
            let mut decided: Vec<(GridIndex, ConfigTag)> =
                done.iter().map(|t| (t.target, known[&t.target].tag)).collect();
            for &(_, tag) in &decided {
                state.counts.move_to(tag);
            }
            self.solve_round(store, stop, &open, state.round, |record| {
                decided.push((record.index, record.tag));
                state.counts.move_to(record.tag);
                state.solved_now += 1;
                progress(&state);
            })?;
            tags.extend(decided);
        }
    }

    fn solve_rest(&self, store: &Store) -> Result<(), ExpansionError> {
        let start = Instant::now();
        let rest = Solver::new(self.problem.clone()).rest().map_err(ExpansionError::Rest)?;
        let record =
            Record::solved([0; 3], ConfigTag::Expandable, 0, None, &rest, start.elapsed().as_secs_f64());
        store.commit(self.active, &record, Some(&StoredSeed::pack(&rest.seed)))?;
        Ok(())
    }

    /// Solves `transitions` on all workers; results are committed on this thread as they arrive.
    fn solve_round(
        &self,
        store: &Store,
        stop: &AtomicBool,
        transitions: &[Transition],
        round: u32,
        mut decided: impl FnMut(&Record),
    ) -> Result<(), ExpansionError> {
        let next = AtomicUsize::new(0);
        // Raised on a store error, so that workers do not solve on for nothing.
        let abandon = AtomicBool::new(false);
        let path: PathBuf = store.path().to_path_buf();
        let workers = self.threads.clamp(1, transitions.len().max(1));
        // Bounded: what is solved is committed before much more is, so that a kill loses little and a stop is prompt.
        let (sender, receiver) = mpsc::sync_channel::<Outcome>(workers);
        let committed = std::thread::scope(|scope| {
            let handles: Vec<_> = (0..workers)
                .map(|_| {
                    let (sender, next, abandon, path) = (sender.clone(), &next, &abandon, &path);
                    scope.spawn(move || {
                        let reader = match Store::open(path) {
                            Ok(reader) => reader,
                            Err(error) => return drop(sender.send(Err(error))),
                        };
                        let mut solver = Solver::new(self.problem.clone());
                        while !stop.load(Ordering::Relaxed) && !abandon.load(Ordering::Relaxed) {
                            let Some(transition) = transitions.get(next.fetch_add(1, Ordering::Relaxed))
                            else {
                                return;
                            };
                            let outcome = self.solve_transition(&mut solver, &reader, transition, round);
                            if sender.send(outcome).is_err() {
                                return;
                            }
                        }
                    })
                })
                .collect();
            drop(sender);
            let mut result = Ok(());
            for outcome in receiver {
                let committed = outcome.and_then(|(record, seed)| {
                    store.commit(self.active, &record, seed.as_ref())?;
                    Ok(record)
                });
                match committed {
                    Ok(record) => decided(&record),
                    Err(error) => {
                        abandon.store(true, Ordering::Relaxed);
                        result = Err(ExpansionError::Store(error));
                    }
                }
            }
            for handle in handles {
                if handle.join().is_err() && result.is_ok() {
                    result = Err(ExpansionError::Worker);
                }
            }
            result
        });
        committed?;
        if stop.load(Ordering::Relaxed) { Err(ExpansionError::Interrupted) } else { Ok(()) }
    }

    fn solve_transition(&self, solver: &mut Solver, reader: &Store, t: &Transition, round: u32) -> Outcome {
        let start = Instant::now();
        let seed = reader.seed(self.active, t.parent, self.grid.displacement_m(t.parent))?;
        Ok(match solver.advance(&seed, self.grid.displacement_m(t.target)) {
            Ok(configuration) => {
                let reachable = norm(configuration.force_n) < self.max_force_n;
                let tag = if reachable { ConfigTag::Expandable } else { ConfigTag::Terminating };
                let seconds = start.elapsed().as_secs_f64();
                let record = Record::solved(t.target, tag, round, Some(t.parent), &configuration, seconds);
                (record, Some(StoredSeed::pack(&configuration.seed)))
            }
            Err(failure) => {
                let record =
                    Record::failed(t.target, round, t.parent, &failure, start.elapsed().as_secs_f64());
                (record, None)
            }
        })
    }
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
