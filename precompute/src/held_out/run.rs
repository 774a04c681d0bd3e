//! Solves the held-out walks with an executor and stores the outcomes.
//!
//! Regular and random paths start from rest and do not depend on the space. Uniform positions do: position
//! number n of an active node is tried if a corner of its cell is reachable, from the nearest such corner. It
//! counts if |h| < f_max there. Each round tries as many positions as are still missing. So the choice of the
//! positions depends on their numbers alone, not on the order of the outcomes.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::AtomicBool;

use palpate_core::ConfigTag;

use super::positions::{random_path, regular_directions, regular_path, uniform_position};
use super::{Draw, HeldOutError, Places};
use crate::adaptive::AdaptiveFit;
use crate::space::executor::Dispatcher;
use crate::space::{Done, Executor, ExecutorError, Kind, Store, StoreError, Walk, WalkJob, Work, state};
use crate::spec::{GridIndex, Sampling, corners, displacement_m};

/// The held-out walks to solve.
#[derive(Debug, Clone)]
pub struct HeldOut {
    /// Active nodes: number in the store, and name.
    pub actives: Vec<(usize, String)>,
    /// Definition of the positions of the spaces.
    pub sampling: Sampling,
    /// The draw.
    pub draw: Draw,
    /// The places between contact points; `None` if the tool touches the active nodes one by one.
    pub places: Option<Places>,
    /// Whether the displacements of all nodes are stored at uniform positions.
    pub keep_displacements: bool,
}

/// Progress after each walk.
#[derive(Debug, Clone, Copy, Default)]
pub struct HeldOutProgress {
    /// Finished walks, including those of earlier runs.
    pub walks: usize,
    /// Number of walks known so far; unreachable uniform positions are replaced by others.
    pub total: usize,
    /// Positions solved in this run.
    pub positions_now: usize,
    /// Walks finished in this run.
    pub walks_now: usize,
    /// Steps of the walks finished in this run, including those after an early end, and steps of all known
    /// walks of this run.
    pub steps: (usize, usize),
    /// After a stop request: walks that are cancelled or still running.
    pub stopping: Option<usize>,
}

/// Limit of the draws per position that counts. Beyond it the run gives up on the node, because almost none
/// of its cells is reachable.
const DRAWS_FOR_ONE: u32 = 1000;

impl HeldOut {
    /// Solves the walks that the store does not hold yet, to the end or until `stop` is set.
    pub fn run(
        &self,
        store: &Store,
        executor: &mut dyn Executor,
        stop: &AtomicBool,
        mut progress: impl FnMut(&HeldOutProgress),
    ) -> Result<(), HeldOutError> {
        self.draw.check(self.sampling.radius_m())?;
        store.agree_on_draw(&self.draw.identity(), self.draw.regular_m)?;
        let outcome = self.all(store, executor, stop, &mut progress);
        let committed = store.commit();
        outcome?;
        Ok(committed?)
    }

    fn all(
        &self,
        store: &Store,
        executor: &mut dyn Executor,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(&HeldOutProgress),
    ) -> Result<(), HeldOutError> {
        let mut run = Run {
            held_out: self,
            store,
            stop,
            progress,
            done: BTreeMap::new(),
            state: HeldOutProgress::default(),
        };
        let mut uniform = Vec::new();
        let mut queue = VecDeque::new();
        for (active, name) in &self.actives {
            for ((kind, number), tag) in store.walks_done(*active)? {
                run.done.insert(Walk { active: *active as u32, kind, number }, tag);
            }
            queue.extend(
                self.paths(*active).filter(|walk| !run.done.contains_key(walk)).map(|walk| (walk, None)),
            );
            if self.draw.uniform > 0 {
                uniform.push(Uniform::of(store, *active, name)?);
            }
        }
        let paths = self.paths(0).count();
        run.state.total = self.actives.len() * (paths + self.draw.uniform as usize);
        run.state.walks = self.actives.len() * paths - queue.len();
        run.run_walks(&mut queue, executor, self.actives.len() * self.draw.uniform as usize)?;
        loop {
            // One round: the missing number of positions of every node. Those of earlier runs are answered
            // from the store.
            let mut drawn = 0;
            run.state.walks = self.actives.len() * paths;
            for node in &mut uniform {
                let accepted = node.accepted(&run.done);
                run.state.walks += accepted as usize;
                for _ in accepted..self.draw.uniform {
                    let Some((walk, start)) = self.next_uniform(node) else { break };
                    drawn += 1;
                    if !run.done.contains_key(&walk) {
                        queue.push_back((walk, Some(start)));
                    }
                }
            }
            (run.progress)(&run.state);
            if drawn == 0 {
                return Ok(());
            }
            run.run_walks(&mut queue, executor, 0)?;
        }
    }

    /// The paths of an active node.
    fn paths(&self, active: usize) -> impl Iterator<Item = Walk> + use<> {
        let regular = self.draw.regular_m.map_or(0, |_| regular_directions().count() as u32);
        let walk = move |kind| move |number| Walk { active: active as u32, kind, number };
        (0..regular).map(walk(Kind::Regular)).chain((0..self.draw.random).map(walk(Kind::Random)))
    }

    /// Positions of a walk.
    fn positions_m(&self, walk: &Walk) -> Vec<[f64; 3]> {
        let name = self.actives.iter().find(|(active, _)| *active == walk.active as usize);
        let (name, radius_m) = (name.map_or("", |(_, name)| name), self.sampling.radius_m());
        match walk.kind {
            Kind::Regular => {
                let direction = regular_directions().nth(walk.number as usize);
                let length_m = self.draw.regular_m.unwrap_or(radius_m);
                direction.map_or(Vec::new(), |d| regular_path(d, length_m, self.draw.step_m))
            }
            Kind::Random => random_path(&self.draw, name, walk.number, radius_m),
            Kind::Uniform => vec![uniform_position(&self.draw, name, walk.number, radius_m)],
        }
    }

    /// The next position with a reachable corner.
    fn next_uniform(&self, node: &mut Uniform) -> Option<(Walk, Start)> {
        while node.next < self.draw.uniform.saturating_mul(DRAWS_FOR_ONE) {
            let number = node.next;
            node.next += 1;
            let at = uniform_position(&self.draw, &node.name, number, self.sampling.radius_m());
            if let Some(start) = node.start(&self.sampling, at) {
                return Some((node.walk(number), start));
            }
        }
        None
    }
}

/// A solved point of a space, the attempt whose solution is used, and where the displacements of its chart begin.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Start {
    /// The active node that it belongs to.
    active: usize,
    point: GridIndex,
    attempt: u32,
    /// Zero of that node's displacement from that of the position's, m.
    from_m: [f64; 3],
}

/// One call of [`HeldOut::run`].
struct Run<'a> {
    held_out: &'a HeldOut,
    store: &'a Store,
    stop: &'a AtomicBool,
    progress: &'a mut dyn FnMut(&HeldOutProgress),
    done: BTreeMap<Walk, ConfigTag>,
    state: HeldOutProgress,
}

impl Run<'_> {
    /// Input of a worker for a walk. It is made just before it is sent, so that no states wait in memory.
    fn job(&self, walk: Walk, start: Option<Start>) -> Result<WalkJob, StoreError> {
        let seed = |Start { active, point, attempt, from_m }| {
            let seed = self.store.stored_seed(active, point, attempt)?.moved_by(from_m);
            Ok::<_, StoreError>((point, seed))
        };
        let HeldOut { places, actives, draw, .. } = self.held_out;
        let active = walk.active as usize;
        let place = places.as_ref().filter(|_| walk.kind == Kind::Uniform).and_then(|places| {
            let (_, name) = actives.iter().find(|(number, _)| *number == active)?;
            places.on_skin(&places.drawn(draw, active, name, walk.number)?)
        });
        Ok(WalkJob {
            walk,
            place,
            start: start.map(seed).transpose()?,
            positions_m: self.held_out.positions_m(&walk),
            keep_displacements: self.held_out.keep_displacements && walk.kind == Kind::Uniform,
        })
    }

    /// Executes the queue. At least `to_come` further steps will follow.
    fn run_walks(
        &mut self,
        queue: &mut VecDeque<(Walk, Option<Start>)>,
        executor: &mut dyn Executor,
        to_come: usize,
    ) -> Result<(), HeldOutError> {
        let steps: usize = queue.iter().map(|(walk, _)| self.held_out.positions_m(walk).len()).sum();
        self.state.steps.1 = self.state.steps.0 + steps + to_come;
        let (all, mut done) = (queue.len(), 0);
        let mut dispatcher = Dispatcher::new(executor, self.store, self.stop);
        loop {
            while let Some((worker, _)) = dispatcher.free()
                && let Some((walk, start)) = queue.pop_front()
            {
                dispatcher.give(worker, walk.active as usize, Work::Walk(self.job(walk, start)?))?;
            }
            if dispatcher.is_idle() {
                return if done == all { Ok(()) } else { Err(HeldOutError::Interrupted) };
            }
            let outcome = dispatcher.take::<HeldOutError>()?;
            self.state.stopping = dispatcher.busy_after_stop();
            let Some(outcome) = outcome else {
                (self.progress)(&self.state);
                continue;
            };
            let Done::Walk(outcome) = outcome else { return Err(ExecutorError::UnexpectedResult.into()) };
            done += 1;
            self.state.steps.0 += self.held_out.positions_m(&outcome.walk).len();
            self.store.add_walk(&outcome)?;
            let last = outcome.truths.last().map_or(ConfigTag::Unknown, |truth| truth.tag());
            self.done.insert(outcome.walk, last);
            let counts = outcome.walk.kind != Kind::Uniform || last == ConfigTag::Expandable;
            self.state.walks += usize::from(counts);
            self.state.walks_now += 1;
            self.state.positions_now += outcome.truths.iter().filter(|truth| truth.tag().is_solved()).count();
            (self.progress)(&self.state);
        }
    }
}

/// Uniform positions of one active node.
struct Uniform {
    active: usize,
    name: String,
    /// Reachable points, possible starts of a position, each with the accepted attempt.
    reachable: BTreeMap<GridIndex, u32>,
    /// The fit of adaptive sampling; `None` on a lattice.
    fit: Option<AdaptiveFit>,
    /// The next number to draw.
    next: u32,
}

impl Uniform {
    /// The start of the draw. The space must be complete, because the choice of the positions must not depend
    /// on its progress.
    fn of(store: &Store, active: usize, name: &str) -> Result<Self, HeldOutError> {
        let state = state(store, active)?;
        let records = store.records(active)?;
        let reachable = records.iter().filter(|r| r.tag() == ConfigTag::Expandable);
        let reachable: BTreeMap<GridIndex, u32> = reachable.map(|r| (r.index, r.attempt)).collect();
        if state.open > 0 {
            return Err(HeldOutError::NoSpace(name.into()));
        }
        // A fit predicts what is reachable between rest and configurations beyond f_max; a lattice has no cell
        // there.
        if reachable.is_empty() || state.fit.is_none() && reachable.len() < 2 {
            return Err(HeldOutError::NoReach(name.into()));
        }
        Ok(Self { active, name: name.into(), reachable, fit: state.fit, next: 0 })
    }

    fn walk(&self, number: u32) -> Walk {
        Walk { active: self.active as u32, kind: Kind::Uniform, number }
    }

    /// Start of the solve to `at`: the nearest reachable corner of its cell, or with adaptive sampling the
    /// nearest reachable position, and the attempt of its solution. Ties go to the lowest index. `None` if
    /// `at` is predicted to be unreachable.
    fn start(&self, sampling: &Sampling, at: [f64; 3]) -> Option<Start> {
        let cells = at.map(|x| x / sampling.unit_m());
        let distance = |corner: &GridIndex| -> f64 {
            corner.iter().zip(cells).map(|(n, x)| (f64::from(*n) - x).powi(2)).sum()
        };
        let own = |(point, attempt): (&GridIndex, &u32)| Start {
            active: self.active,
            point: *point,
            attempt: *attempt,
            from_m: [0.0; 3],
        };
        if let Some(fit) = self.fit.as_ref().filter(|fit| fit.is_reachable(at)) {
            // A configuration of another chart may be nearer.
            let nearest = fit.nearest(at);
            if let Some(shared) = nearest.checked_sub(1).and_then(|nearest| fit.shared.get(nearest)) {
                let there_m = displacement_m(shared.index);
                let from_m = std::array::from_fn(|k| shared.jet.control_m[k] - there_m[k]);
                return Some(Start {
                    active: shared.chart as usize,
                    point: shared.index,
                    attempt: 0,
                    from_m,
                });
            }
            return self.reachable.iter().min_by(|a, b| distance(a.0).total_cmp(&distance(b.0))).map(own);
        }
        if self.fit.is_some() {
            return None;
        }
        corners(cells.map(|x| x.floor() as i32))
            .into_iter()
            .filter_map(|corner| self.reachable.get_key_value(&corner))
            .min_by(|a, b| distance(a.0).total_cmp(&distance(b.0)))
            .map(own)
    }

    /// Number of drawn positions that count.
    fn accepted(&self, done: &BTreeMap<Walk, ConfigTag>) -> u32 {
        let drawn = done.range(self.walk(0)..self.walk(self.next));
        drawn.filter(|(_, tag)| **tag == ConfigTag::Expandable).count() as u32
    }
}

#[cfg(test)]
mod tests;
