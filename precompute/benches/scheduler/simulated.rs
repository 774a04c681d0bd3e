//! An executor in simulated time for the real expansion; nothing is solved. Times are integer nanoseconds.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::time::Duration;

use palpate_precompute::fem::{Pose, Seed};
use palpate_precompute::num::{EnergyJet, split_mix};
use palpate_precompute::space::{Done, Executor, ExecutorError, Outcome, Record, StoredSeed, Task, Work};
use palpate_precompute::spec::{GridIndex, SpaceGrid};

/// Costs other than the solves, ns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Costs {
    /// Time of rank 0 to prepare and send a job.
    pub(crate) give: u64,
    /// Time of rank 0 for an outcome.
    pub(crate) take: u64,
    /// Latency of a message in either direction.
    pub(crate) message: u64,
}

/// An attempt: active node, grid point, attempt number.
pub(crate) type Try = (u32, GridIndex, u32);

/// Durations of solves, ns, sorted. Those drawn from them are the same for a point in every run.
#[derive(Debug)]
pub(crate) struct Durations {
    /// Of the solves at rest, with which the space of an active node begins.
    pub(crate) at_rest: Vec<u64>,
    /// Of all others.
    pub(crate) others: Vec<u64>,
}

impl Durations {
    /// The same duration of every solve, s.
    pub(crate) fn constant(seconds: f64) -> Self {
        Self { at_rest: Vec::new(), others: vec![nanoseconds(seconds)] }
    }

    /// Mean, s.
    pub(crate) fn mean_s(&self) -> f64 {
        let all = self.at_rest.iter().chain(&self.others);
        all.map(|&ns| ns as f64 * 1e-9).sum::<f64>() / (self.at_rest.len() + self.others.len()) as f64
    }

    fn draw(&self, active: u32, task: &Task) -> u64 {
        let is_at_rest = task.parent.is_none() && !self.at_rest.is_empty();
        let pool = if is_at_rest { &self.at_rest } else { &self.others };
        let [i, j, k] = task.target.map(|n| n as u32 as u64);
        let attempt = u64::from(active) << 32 | u64::from(task.attempt);
        let number = split_mix(i ^ split_mix(j ^ split_mix(k ^ split_mix(attempt))));
        pool[(number % pool.len() as u64) as usize]
    }
}

/// Results and durations of the solves.
#[derive(Debug)]
pub(crate) enum Solves<'a> {
    /// Every point of the grid is solved at the first attempt.
    Spring(SpaceGrid, &'a Durations),
    /// The recorded attempts, with their own durations or with drawn ones.
    Known(&'a HashMap<Try, Record>, Option<&'a Durations>),
}

/// Times of a simulated run, ns.
#[derive(Debug)]
pub(crate) struct SimulatedRun {
    /// Time from the first job to the last stored outcome.
    pub(crate) makespan: u64,
    /// Sum of all solves.
    pub(crate) work: u64,
    /// Longest chain of solves, each of which starts from the one before.
    pub(crate) chain: u64,
    /// Busy time of rank 0.
    pub(crate) rank0_busy: u64,
    /// Number of points beside those at rest.
    pub(crate) points: usize,
    /// Number of attempts.
    pub(crate) tries: usize,
    /// Number of attempts by active node, level and round.
    pub(crate) levels: BTreeMap<(u32, u32), usize>,
}

/// Workers that take time and compute nothing.
#[derive(Debug)]
pub(crate) struct Simulated<'a> {
    costs: Costs,
    solves: &'a Solves<'a>,
    seed: StoredSeed,
    /// Rank 0's clock.
    now: u64,
    /// Time at which each worker has finished its jobs.
    free: Vec<u64>,
    /// Outcomes by their arrival at rank 0; the number keeps the order of simultaneous arrivals.
    under_way: BinaryHeap<Reverse<(u64, usize, usize)>>,
    outcomes: HashMap<usize, Outcome>,
    /// End of the chain that leads to an attempt.
    chains: HashMap<Try, u64>,
    ran: SimulatedRun,
}

/// `seconds` in ns.
pub(crate) fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// The smallest state that the store accepts.
fn blank_seed() -> StoredSeed {
    StoredSeed::pack(&Seed {
        pose: Pose::translation([0.0; 3]),
        state: vec![0.0],
        sensitivity: [vec![0.0], vec![0.0], vec![0.0]],
        jet: EnergyJet::from_numbers([0.0; 3], &[0.0; 20]),
        coupling: None,
    })
}

impl<'a> Simulated<'a> {
    /// An executor with `workers` idle workers.
    pub(crate) fn new(workers: usize, costs: Costs, solves: &'a Solves<'a>) -> Self {
        Self {
            costs,
            solves,
            seed: blank_seed(),
            now: 0,
            free: vec![0; workers],
            under_way: BinaryHeap::new(),
            outcomes: HashMap::new(),
            chains: HashMap::new(),
            ran: SimulatedRun {
                makespan: 0,
                work: 0,
                chain: 0,
                rank0_busy: 0,
                points: 0,
                tries: 0,
                levels: BTreeMap::new(),
            },
        }
    }

    /// The result of the run.
    pub(crate) fn ran(self) -> SimulatedRun {
        SimulatedRun { makespan: self.now, ..self.ran }
    }

    fn solve(&self, active: u32, task: &Task) -> Result<(u64, Record), ExecutorError> {
        match self.solves {
            Solves::Spring(grid, durations) => Ok((durations.draw(active, task), harmonic(task, grid))),
            Solves::Known(records, drawn) => {
                let record = records.get(&(active, task.target, task.attempt)).ok_or_else(|| {
                    ExecutorError::Lost(format!(
                        "the file has no attempt {} at {:?}",
                        task.attempt, task.target
                    ))
                })?;
                let duration =
                    drawn.map_or_else(|| nanoseconds(record.seconds), |times| times.draw(active, task));
                Ok((duration, record.clone()))
            }
        }
    }
}

/// A point of a spring of 1 N/m: solved, and consistent with its neighbours.
fn harmonic(task: &Task, grid: &SpaceGrid) -> Record {
    let d = grid.displacement_m(task.target);
    let energy_j = 0.5 * d.iter().map(|x| x * x).sum::<f64>();
    let mut numbers = [0.0; 20];
    (numbers[0], numbers[4], numbers[7], numbers[9]) = (energy_j, 1.0, 1.0, 1.0);
    numbers[1..4].copy_from_slice(&d);
    let jet = EnergyJet::from_numbers(d, &numbers);
    let record = Record::of_jet(task, &jet, false);
    Record { iterations: 1, factorisations: 1, increments: 1, ..record }
}

impl Executor for Simulated<'_> {
    fn size(&self) -> usize {
        self.free.len()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        let Work::Point(job) = work else {
            return Err(ExecutorError::Lost("only points are simulated".into()));
        };
        self.now += self.costs.give;
        self.ran.rank0_busy += self.costs.give;
        let (duration, record) = self.solve(job.active, &job.task)?;
        let done = self.free[worker].max(self.now + self.costs.message) + duration;
        self.free[worker] = done;
        let parent = job.task.parent.map(|(index, attempt)| (job.active, index, attempt));
        let chain = duration + parent.and_then(|p| self.chains.get(&p)).copied().unwrap_or(0);
        self.chains.insert((job.active, record.index, record.attempt), chain);
        self.ran.chain = self.ran.chain.max(chain);
        self.ran.work += duration;
        *self.ran.levels.entry((job.active, job.task.round)).or_default() += 1;
        let number = self.ran.tries;
        self.ran.tries += 1;
        self.ran.points += usize::from(job.task.attempt == 0 && job.task.parent.is_some());
        let seed = record.tag().is_solved().then(|| self.seed.clone());
        self.outcomes.insert(number, Outcome { active: job.active, record, seed, intermediate: Vec::new() });
        self.under_way.push(Reverse((done + self.costs.message, number, worker)));
        Ok(())
    }

    fn take(&mut self, _: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        let idle = || ExecutorError::Lost("no message is in flight".into());
        let Reverse((arrival, number, worker)) = self.under_way.pop().ok_or_else(idle)?;
        self.now = self.now.max(arrival) + self.costs.take;
        self.ran.rank0_busy += self.costs.take;
        let outcome = self.outcomes.remove(&number).ok_or_else(idle)?;
        Ok(Some((worker, Done::Point(Box::new(outcome)))))
    }

    fn stop(&mut self) {}
}
