//! One worker: the solver of its current active node, and the data that all workers share.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use super::job::{Done, ExecutorError, Job, Outcome, Work};
use super::record::{Record, StoredSeed};
use super::walk::{WalkJob, WalkOutcome};
use crate::fem::solve::{Configuration, LoadingOptions, Problem, Seed, SolveFailure, Solver};
use crate::mesh::SkinPoint;
use crate::num::jet::EnergyJet;
use crate::spec::{GridIndex, Sampling};

/// The problem of an active node, or of the tool at another place of the skin.
type ProblemAt = dyn Fn(usize, Option<SkinPoint>) -> Arc<Problem> + Send + Sync;

/// Context that all workers share.
pub struct WorkerContext {
    problem: Box<ProblemAt>,
    /// The problem of an active node while a worker uses it. All workers on that node share its numbering and
    /// symbolic analysis.
    problems: Mutex<HashMap<u32, Arc<Mutex<Weak<Problem>>>>>,
    /// Definition of the positions.
    pub sampling: Sampling,
    /// Force limit of expandable configurations, N.
    pub max_force_n: f64,
}

impl WorkerContext {
    /// Context in which `problem` builds the problem of an active node, or of the tool at another place.
    pub fn new(
        problem: impl Fn(usize, Option<SkinPoint>) -> Arc<Problem> + Send + Sync + 'static,
        sampling: Sampling,
        max_force_n: f64,
    ) -> Self {
        Self { problem: Box::new(problem), problems: Mutex::default(), sampling, max_force_n }
    }

    fn problem(&self, (active, place): At) -> Arc<Problem> {
        if place.is_some() {
            return (self.problem)(active as usize, place);
        }
        // A panic while a problem is built leaves this map consistent.
        let mut problems = self.problems.lock().unwrap_or_else(PoisonError::into_inner);
        let place = problems.entry(active).or_default().clone();
        // Released here: only a second request for the same node waits, not a request for another one.
        drop(problems);
        let mut place = place.lock().unwrap_or_else(PoisonError::into_inner);
        place.upgrade().unwrap_or_else(|| {
            let problem = (self.problem)(active as usize, None);
            *place = Arc::downgrade(&problem);
            problem
        })
    }
}

impl std::fmt::Debug for WorkerContext {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WorkerContext")
            .field("sampling", &self.sampling)
            .field("max_force_n", &self.max_force_n)
            .finish()
    }
}

/// Where the tool touches: at an active node, or at a place near it.
type At = (u32, Option<SkinPoint>);

/// One worker with the solver of its current active node.
#[derive(Debug)]
pub(crate) struct Worker {
    context: Arc<WorkerContext>,
    stop: Arc<AtomicBool>,
    solver: Option<(At, Solver)>,
}

/// Effort of the first attempt at a point. Where a branch ends, a solve from another neighbour is cheaper
/// than many small steps towards the bifurcation. Without snap-through W stays single-valued where that is
/// possible.
const FIRST_ATTEMPT: LoadingOptions =
    LoadingOptions { max_halvings: 3, perturbations: 1, snap_through: false };
/// Effort of a later attempt. Most points that still fail have no solution nearby.
const LATER_ATTEMPT: LoadingOptions =
    LoadingOptions { max_halvings: 1, perturbations: 0, snap_through: false };

impl Worker {
    /// A worker without a solver, which stops working once `stop` is set.
    pub(crate) fn new(context: Arc<WorkerContext>, stop: Arc<AtomicBool>) -> Self {
        Self { context, stop, solver: None }
    }

    /// Executes a piece of work.
    pub(crate) fn execute(&mut self, work: &Work) -> Result<Done, ExecutorError> {
        if self.stop.load(Ordering::Relaxed) {
            return Ok(Done::Abandoned);
        }
        match work {
            Work::Point(job) => self.point(job).map(Box::new).map(Done::Point),
            Work::Walk(job) => self.walk(job).map(|walked| walked.map_or(Done::Abandoned, Done::Walk)),
        }
    }

    fn solver(&mut self, at: At) -> &mut Solver {
        if self.solver.as_ref().is_none_or(|(there, _)| *there != at) {
            // The old solver is dropped first, so that two factors of a large body are not in memory
            // together.
            self.solver = None;
        }
        let context = &self.context;
        let (_, solver) = self.solver.get_or_insert_with(|| (at, Solver::new(context.problem(at))));
        solver
    }

    /// The stored state as the seed at a grid point, if it fits this body.
    fn seed(&mut self, at: At, index: GridIndex, stored: &StoredSeed) -> Result<Seed, ExecutorError> {
        let seed =
            stored.unpack(self.context.sampling.displacement_m(index)).ok_or(ExecutorError::StartState)?;
        let fits = seed.state.len() == self.solver(at).problem().body.state_len();
        fits.then_some(seed).ok_or(ExecutorError::StartState)
    }

    fn walk(&mut self, job: &WalkJob) -> Result<Option<WalkOutcome>, ExecutorError> {
        let (at, max_force_n) = ((job.walk.active, job.place), self.context.max_force_n);
        let start = job.start.as_ref().map(|(index, stored)| self.seed(at, *index, stored)).transpose()?;
        let stop = self.stop.clone();
        let solver = self.solver(at);
        solver.loading = LoadingOptions { snap_through: false, ..LoadingOptions::default() };
        Ok(job.solve(solver, start, max_force_n, &stop))
    }

    fn point(&mut self, job: &Job) -> Result<Outcome, ExecutorError> {
        let context = self.context.clone();
        let seed = match (&job.seed, job.task.parent) {
            (Some(stored), Some((parent, _))) => Some(self.seed((job.active, None), parent, stored)?),
            _ => None,
        };
        let solver = self.solver((job.active, None));
        let is_due = job.task.checks_stability(job.active, solver.problem().solves_a_check());
        solver.loading = if job.task.attempt == 0 { FIRST_ATTEMPT } else { LATER_ATTEMPT };
        let start = Instant::now();
        let mut intermediate = Vec::new();
        let to = context.sampling.displacement_m(job.task.target);
        solver.determine_stability_at(is_due.then_some(to));
        let solved = match seed {
            Some(seed) => transition(solver, seed, to, context.sampling.increments(), &mut intermediate),
            None => solver.rest(),
        };
        let solved = solved.map(|found| if is_due { with_stability(solver, found) } else { found });
        solver.determine_stability_at(None);
        let seconds = start.elapsed().as_secs_f64();
        Ok(match solved {
            Ok(configuration) => Outcome {
                active: job.active,
                record: Record::solved(&job.task, &configuration, context.max_force_n, seconds),
                seed: Some(StoredSeed::pack(&configuration.seed)),
                intermediate,
            },
            Err(failure) => Outcome {
                active: job.active,
                record: Record::failed(&job.task, &failure, seconds),
                seed: None,
                intermediate: Vec::new(),
            },
        })
    }
}

/// The configuration of a large body with its stability, also if its last solve made no factor.
fn with_stability(solver: &mut Solver, mut solved: Configuration) -> Configuration {
    if solved.unstable_modes.is_none() && solver.problem().is_large() {
        solved.unstable_modes = solver.unstable_modes_at(&solved.seed);
        solved.factorisations += 1;
    }
    solved
}

/// One transition, in equal parts if requested. Iterations and the other counters are summed.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::body::{Body, Model};
    use crate::fem::boundary::{Constraints, Handle};
    use crate::fem::material::{Lame, Material, NeoHookean};
    use crate::mesh::testing::{box_mesh, nodes_where};
    use crate::space::Task;
    use crate::spec::{Lattice, SpaceGrid};

    #[test]
    fn the_configurations_of_a_body_that_is_solved_without_a_factor_have_their_stability() {
        let mesh = box_mesh([4, 2, 2], 0.01);
        let fixed = nodes_where(&mesh, |x| x[2] == 0.0);
        let top = nodes_where(&mesh, |x| (x[0] - 0.02).abs() < 0.003 && (x[1] - 0.01).abs() < 0.003)[2];
        let law = Material::NeoHookean(NeoHookean { lame: Lame::from_young_poisson(15480.0, 0.45) });
        let body = Arc::new(Body::new(&mesh, &Model::uniform(law, &fixed)).expect("a body"));
        let problem = move |_: usize, _: Option<SkinPoint>| {
            let mut free = Problem::with(body.clone(), None, Constraints::Elimination);
            free.newton.large_flops = 0.0;
            Arc::new(free.at(Handle::node(top)))
        };
        let grid = SpaceGrid::new(5e-4, 5e-3).expect("a lattice");
        let sampling = Sampling::Lattice(Lattice { grid, complete_cells: false, increments: None });
        let mut worker = Worker::new(Arc::new(WorkerContext::new(problem, sampling, 100.0)), Arc::default());
        let mut point = |task: Task, seed: Option<StoredSeed>| match worker.execute(&Work::Point(Job {
            active: 0,
            task,
            seed,
        })) {
            Ok(Done::Point(outcome)) => *outcome,
            other => panic!("{other:?}"),
        };
        let modes = |outcome: &Outcome| outcome.record.equilibrium().expect("it is solved").unstable_modes;
        let task = |n, attempt, parent| Task { target: [0, 0, n], attempt, round: 0, parent, chart: None };
        let rest = point(task(0, 0, None), None);
        assert_eq!(modes(&rest), Some(0));
        for n in -4..0 {
            let found = point(task(n, 0, Some(([0; 3], 0))), rest.seed.clone());
            assert_eq!(modes(&found), Some(0), "{n}");
        }
    }
}
