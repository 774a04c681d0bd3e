//! One worker: the solver of the active node it was last asked for, and what it must know beside the job.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use super::job::{Done, Job, Outcome, Work};
use super::record::{Record, StoredSeed};
use super::walk::{WalkJob, WalkOutcome};
use crate::fem::solve::{Configuration, LoadingOptions, Problem, Seed, SolveFailure, Solver};
use crate::num::jet::EnergyJet;
use crate::spec::{GridIndex, Sampling};

/// Everything a worker must know beside the job.
pub struct Workshop {
    problem: Box<dyn Fn(usize) -> Arc<Problem> + Send + Sync>,
    /// The problem of an active node while a worker has it in hand: with its numbering and analysis one serves them all.
    problems: Mutex<HashMap<u32, Arc<Mutex<Weak<Problem>>>>>,
    /// What the positions are.
    pub sampling: Sampling,
    /// Force beyond which a configuration is terminating, N.
    pub max_force_n: f64,
}

impl Workshop {
    /// Workshop where `problem` builds that of an active node.
    pub fn new(
        problem: impl Fn(usize) -> Arc<Problem> + Send + Sync + 'static,
        sampling: Sampling,
        max_force_n: f64,
    ) -> Self {
        Self { problem: Box::new(problem), problems: Mutex::default(), sampling, max_force_n }
    }

    fn problem(&self, active: u32) -> Arc<Problem> {
        // A worker that panicked while it built one left nothing half-done here.
        let mut problems = self.problems.lock().unwrap_or_else(PoisonError::into_inner);
        let place = problems.entry(active).or_default().clone();
        // Nobody waits for the problem of another node; whoever comes second to this one does.
        drop(problems);
        let mut place = place.lock().unwrap_or_else(PoisonError::into_inner);
        place.upgrade().unwrap_or_else(|| {
            let problem = (self.problem)(active as usize);
            *place = Arc::downgrade(&problem);
            problem
        })
    }
}

impl std::fmt::Debug for Workshop {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Workshop")
            .field("sampling", &self.sampling)
            .field("max_force_n", &self.max_force_n)
            .finish()
    }
}

/// One worker: the solver of the active node it was last asked for.
#[derive(Debug)]
pub struct Worker {
    workshop: Arc<Workshop>,
    stop: Arc<AtomicBool>,
    solver: Option<(u32, Solver)>,
}

/// How hard the first try at a point is. Where a branch ends the space has other neighbours to come from: they cost less than many
/// small steps towards a fold, and without snapping through W stays single-valued where it can be.
const FIRST_TRY: LoadingOptions = LoadingOptions { max_halvings: 3, perturbations: 1, snap_through: false };
/// How hard a later try is: most of those that fail at all have no solution near.
const AGAIN: LoadingOptions = LoadingOptions { max_halvings: 1, perturbations: 0, snap_through: false };

/// The state a job starts from is not one of this body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnusableSeed;

impl Worker {
    /// A worker that has not done anything yet, and that does no more once `stop` is raised.
    pub fn new(workshop: Arc<Workshop>, stop: Arc<AtomicBool>) -> Self {
        Self { workshop, stop, solver: None }
    }

    /// Does what is asked.
    pub fn work(&mut self, work: &Work) -> Result<Done, UnusableSeed> {
        if self.stop.load(Ordering::Relaxed) {
            return Ok(Done::Abandoned);
        }
        match work {
            Work::Point(job) => self.point(job).map(Box::new).map(Done::Point),
            Work::Walk(job) => self.walk(job).map(|walked| walked.map_or(Done::Abandoned, Done::Walk)),
        }
    }

    /// The solver of an active node.
    fn solver(&mut self, active: u32) -> &mut Solver {
        if self.solver.as_ref().is_none_or(|(there, _)| *there != active) {
            // The old one goes first: two factors of a large body need not stand side by side.
            self.solver = None;
        }
        let workshop = &self.workshop;
        let (_, solver) = self.solver.get_or_insert_with(|| (active, Solver::new(workshop.problem(active))));
        solver
    }

    /// A stored state as the seed at a grid point, if it is one of this body.
    fn seed(&mut self, active: u32, at: GridIndex, stored: &StoredSeed) -> Result<Seed, UnusableSeed> {
        let seed = stored.unpack(self.workshop.sampling.displacement_m(at)).ok_or(UnusableSeed)?;
        let fits = seed.state.len() == self.solver(active).problem().body.state_len();
        fits.then_some(seed).ok_or(UnusableSeed)
    }

    fn walk(&mut self, job: &WalkJob) -> Result<Option<WalkOutcome>, UnusableSeed> {
        let (active, max_force_n) = (job.walk.active, self.workshop.max_force_n);
        let start = match &job.start {
            Some((at, stored)) => Some(self.seed(active, *at, stored)?),
            None => None,
        };
        let stop = self.stop.clone();
        let solver = self.solver(active);
        solver.loading = LoadingOptions { snap_through: false, ..LoadingOptions::default() };
        Ok(job.solve(solver, start, max_force_n, &stop))
    }

    fn point(&mut self, job: &Job) -> Result<Outcome, UnusableSeed> {
        let workshop = self.workshop.clone();
        let seed = match (&job.seed, job.task.parent) {
            (Some(stored), Some((parent, _))) => Some(self.seed(job.active, parent, stored)?),
            _ => None,
        };
        let solver = self.solver(job.active);
        solver.loading = if job.task.attempt == 0 { FIRST_TRY } else { AGAIN };
        let start = Instant::now();
        let mut intermediate = Vec::new();
        let to = workshop.sampling.displacement_m(job.task.target);
        let solved = match seed {
            Some(seed) => transition(solver, seed, to, workshop.sampling.increments(), &mut intermediate),
            None => solver.rest(),
        };
        let seconds = start.elapsed().as_secs_f64();
        Ok(match solved {
            Ok(configuration) => {
                let record = Record::solved(&job.task, &configuration, workshop.max_force_n, seconds);
                let seed = record.tag.is_solved().then(|| StoredSeed::pack(&configuration.seed));
                let intermediate = if seed.is_some() { intermediate } else { Vec::new() };
                Outcome { active: job.active, record, seed, intermediate }
            }
            Err(failure) => Outcome {
                active: job.active,
                record: Record::failed(&job.task, &failure, seconds),
                seed: None,
                intermediate: Vec::new(),
            },
        })
    }
}

/// One transition, in equal parts if asked; iterations and the like are summed.
fn transition(
    solver: &mut Solver,
    mut seed: Seed,
    to: [f64; 3],
    increments: Option<u32>,
    on_the_way: &mut Vec<EnergyJet>,
) -> Result<Configuration, SolveFailure> {
    let (from, parts) = (seed.pose.displacement_m, increments.unwrap_or(1).max(1));
    let (mut iterations, mut factorisations, mut steps, mut switched) = (0, 0, 0, false);
    for part in 1..=parts {
        let share = f64::from(part) / f64::from(parts);
        let target =
            if part == parts { to } else { std::array::from_fn(|i| from[i] + share * (to[i] - from[i])) };
        let mut c = solver
            .advance(&seed, target)
            .map_err(|failure| SolveFailure { iterations: iterations + failure.iterations, ..failure })?;
        iterations += c.iterations;
        factorisations += c.factorisations;
        steps += c.increments;
        switched |= c.switched;
        if part == parts {
            (c.iterations, c.factorisations, c.increments) = (iterations, factorisations, steps);
            c.switched = switched;
            return Ok(c);
        }
        on_the_way.push(*c.jet());
        seed = c.seed;
    }
    unreachable!("the last part returns")
}
