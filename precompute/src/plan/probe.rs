//! Probing solves on one active node: the first batches of adaptive sampling within the time limit, two
//! lattice steps, and the probes again from other starts. A different solution there shows a branch jump of
//! the space.
//!
//! A space of adaptive sampling begins with the same solves, so their reach and time predict those of the
//! space.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::adaptive::{Search, SolveResult, Step, Verdict};
use crate::fem::{Configuration, Problem, Seed, SolveFailure, Solver};
use crate::fit::SurfaceMotionSample;
use crate::num::{EnergyJet, distance, norm};
use crate::spec::Requirements;

/// Minimum number of probes of a node, for any time limit.
const MIN_PROBES: usize = 2;
/// Maximum number of probes of a node: more would not improve the plan enough for their time.
const MAX_PROBES: usize = 16;

/// Results of one active node.
#[derive(Debug, Clone)]
pub(super) struct Probed {
    /// Its number in the scene.
    pub active: usize,
    /// The sampling parameters of its space.
    pub wanted: Requirements,
    /// Rest first, then every probe on its branch.
    pub jets: Vec<EnergyJet>,
    /// The surface at each of them.
    pub moved: Vec<([f64; 3], SurfaceMotionSample)>,
    /// Wall seconds of the solve at rest: one factorisation and the derivatives.
    pub rest_s: f64,
    /// Wall seconds of each probe of adaptive sampling.
    pub far_s: Vec<f64>,
    /// Wall seconds of each lattice step.
    pub near_s: Vec<f64>,
    /// Whether adaptive sampling ended with these probes.
    pub has_ended: bool,
    /// Number of probes that failed or left their branch.
    pub lost: usize,
    /// Number of probes that failed.
    pub failed: usize,
    /// Number of probes beyond the force limit.
    pub beyond: usize,
    /// Number of probes that were solved again from another start.
    pub again: usize,
    /// Number of these with a different solution.
    pub elsewhere: usize,
    /// Why the largest force cannot move the node as far as a space needs; `None` if it can.
    pub too_stiff: Option<String>,
    /// Unknowns, entries of the matrix and of its factor.
    pub size: [usize; 3],
}

impl Probed {
    /// Displacements of the probes, shortest and longest, m.
    pub(super) fn reach_m(&self) -> [f64; 2] {
        let size = |jet: &EnergyJet| jet.control_m.iter().map(|x| x * x).sum::<f64>().sqrt();
        let probes = || self.jets[1..].iter().map(size);
        [probes().fold(f64::INFINITY, f64::min).min(self.wanted.radius_m), probes().fold(0.0, f64::max)]
    }
}

/// Parameters of the probing.
pub(super) struct Order {
    /// Number of the active node.
    pub active: usize,
    /// Its problem.
    pub problem: Arc<Problem>,
    /// The sampling parameters of its space.
    pub wanted: Requirements,
    /// The surface nodes for display; empty if no display is needed.
    pub surface: Vec<u32>,
    /// Length of the lattice step whose time is measured, m.
    pub step_m: f64,
    /// Time limit after the minimum number of probes.
    pub patience: Duration,
}

/// Largest number of solves of [`probe`] before the probes are solved again, with rest and lattice steps.
pub(super) const MAX_SOLVES: usize = 1 + MAX_PROBES + 2;

/// Probes one active node. Calls `solved` after each of the first [`MAX_SOLVES`] solves.
pub(super) fn probe(order: &Order, solved: &dyn Fn()) -> Result<Probed, SolveFailure> {
    let begun = Instant::now();
    let mut solver = Solver::new(order.problem.clone());
    let (rest, rest_s) = timed(|| solver.rest());
    let rest = rest?;
    solved();
    let problem = &order.problem;
    let (matrix, factor) = problem.entries();
    let mut probed = Probed {
        active: order.active,
        wanted: order.wanted,
        jets: Vec::new(),
        moved: Vec::new(),
        rest_s,
        far_s: Vec::new(),
        near_s: Vec::new(),
        has_ended: false,
        lost: 0,
        failed: 0,
        beyond: 0,
        again: 0,
        elsewhere: 0,
        too_stiff: None,
        size: [problem.unknowns(), matrix, factor],
    };
    let mut probing = Probing { order, begun, solver: &mut solver, seeds: Vec::new(), kept: Vec::new() };
    probing.search(&mut probed, &rest, solved);
    probing.lattice_steps(&mut probed, solved);
    probing.again(&mut probed);
    Ok(probed)
}

/// The solves of a node in progress.
struct Probing<'p> {
    order: &'p Order,
    begun: Instant,
    solver: &'p mut Solver,
    /// States of the configurations of the search: rest first.
    seeds: Vec<Seed>,
    /// The probes that were solved within the force limit.
    kept: Vec<Solved>,
}

impl Probing<'_> {
    fn is_late(&self) -> bool {
        self.begun.elapsed() > self.order.patience
    }

    /// The first batches of adaptive sampling.
    fn search(&mut self, probed: &mut Probed, rest: &Configuration, solved: &dyn Fn()) {
        let order = self.order;
        // The force at rest is zero by definition.
        let jet = EnergyJet { energy_j: 0.0, force_n: [0.0; 3], ..*rest.jet() };
        probed.keep(jet, rest, rest, &order.surface);
        self.seeds.push(rest.seed.clone());
        let mut search = Search::new(order.wanted, &jet);
        loop {
            let targets = match search.step() {
                Step::Solve(targets) => targets,
                Step::Done(verdict) => {
                    probed.has_ended = true;
                    probed.too_stiff =
                        (verdict == Verdict::TooStiff).then(|| search.fitted.too_stiff_in_words());
                    return;
                }
            };
            let mut found = Vec::new();
            let mut learned = Vec::new();
            for target in &targets {
                if probed.far_s.len() >= MAX_PROBES || (self.is_late() && probed.far_s.len() >= MIN_PROBES) {
                    return;
                }
                // A parent outside the stored seeds would be known only to the search. This does not occur;
                // the last seed is a valid start in any case.
                let seed = &self.seeds[target.parent.min(self.seeds.len() - 1)];
                let (reached, seconds) = timed(|| self.solver.advance(seed, target.displacement_m));
                solved();
                probed.far_s.push(seconds);
                found.push(match reached {
                    Ok(c) if !c.switched => {
                        let jet = *c.jet();
                        probed.keep(jet, &c, rest, &order.surface);
                        let is_beyond = norm(jet.force_n) > order.wanted.max_force_n;
                        probed.beyond += usize::from(is_beyond);
                        if !is_beyond {
                            let is_from_rest = target.parent == 0;
                            self.kept.push(Solved { at: jet, seed: c.seed.clone(), is_from_rest });
                        }
                        learned.push((jet, c.seed));
                        SolveResult::Solved(jet)
                    }
                    Ok(c) => {
                        probed.lost += 1;
                        SolveResult::OtherBranch(*c.jet())
                    }
                    Err(_) => {
                        probed.lost += 1;
                        probed.failed += 1;
                        SolveResult::Failed
                    }
                });
            }
            search.take(&found);
            // The search drops configurations far beyond the limit; parents are indices into those that it
            // kept.
            let kept = |at: [f64; 3]| search.fitted.jets.iter().any(|jet| jet.control_m == at);
            let kept = learned.into_iter().filter(|(jet, _)| kept(jet.control_m));
            self.seeds.extend(kept.map(|(_, seed)| seed));
        }
    }

    /// A lattice step from rest, and one from the first probe.
    fn lattice_steps(&mut self, probed: &mut Probed, solved: &dyn Fn()) {
        for n in 0..self.seeds.len().min(2) {
            if self.is_late() && !probed.near_s.is_empty() {
                break;
            }
            let seed = &self.seeds[n];
            let from = seed.pose.displacement_m;
            let back = if norm(from) > 0.0 { from.map(|x| -x / norm(from)) } else { [0.0, 0.0, 1.0] };
            let to = std::array::from_fn(|i| from[i] + self.order.step_m * back[i]);
            let (step, seconds) = timed(|| self.solver.advance(seed, to));
            solved();
            if step.is_ok() {
                probed.near_s.push(seconds);
            }
        }
        if probed.near_s.is_empty() {
            probed.near_s.push(probed.rest_s);
        }
    }

    /// The probes again from other starts, the farthest first, because a branch jump is most probable there.
    fn again(&mut self, probed: &mut Probed) {
        self.kept.sort_by(|a, b| norm(b.at.control_m).total_cmp(&norm(a.at.control_m)));
        for (n, probe) in self.kept.iter().enumerate() {
            if self.is_late() {
                break;
            }
            let from = if probe.is_from_rest { nearest(&self.kept, n) } else { self.seeds.first() };
            let found = from.map(|seed| self.solver.advance(seed, probe.at.control_m));
            if let Some(Ok(other)) = found {
                let apart: [f64; 3] = std::array::from_fn(|i| other.jet().force_n[i] - probe.at.force_n[i]);
                probed.again += 1;
                probed.elsewhere +=
                    usize::from(norm(apart) > self.order.wanted.tolerance.at(probe.at.force_n));
            }
        }
    }
}

/// A probe that was solved within the force limit.
struct Solved {
    at: EnergyJet,
    seed: Seed,
    is_from_rest: bool,
}

/// State of the probe nearest to number `n`.
fn nearest(solved: &[Solved], n: usize) -> Option<&Seed> {
    let away = |other: &Solved| -> f64 {
        let [a, b] = [other, &solved[n]].map(|probe| probe.at.control_m);
        distance(a, b)
    };
    let others = solved.iter().enumerate().filter(|(other, _)| *other != n);
    others.min_by(|a, b| away(a.1).total_cmp(&away(b.1))).map(|(_, probe)| &probe.seed)
}

impl Probed {
    fn keep(&mut self, jet: EnergyJet, at: &Configuration, rest: &Configuration, surface: &[u32]) {
        self.jets.push(jet);
        let of = |state: &[f64], less: Option<&[f64]>| -> Vec<f32> {
            let components =
                surface.iter().flat_map(|&node| (0..3).map(move |axis| 3 * node as usize + axis));
            components.map(|k| (state[k] - less.map_or(0.0, |less| less[k])) as f32).collect()
        };
        let displacement_m = of(&at.seed.state, Some(&rest.seed.state));
        let slopes = at.seed.sensitivity.each_ref().map(|column| of(column, None));
        self.moved.push((jet.control_m, SurfaceMotionSample { displacement_m, slopes }));
    }
}

/// Solves another discretisation at rest. Returns the seconds, the solution and the size.
pub(super) fn rest_of(problem: &Arc<Problem>) -> Option<(f64, EnergyJet, [usize; 3])> {
    let mut solver = Solver::new(problem.clone());
    let (rest, seconds) = timed(|| solver.rest());
    let (matrix, factor) = problem.entries();
    Some((seconds, rest.ok()?.jet().as_rest(), [problem.unknowns(), matrix, factor]))
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let begun = Instant::now();
    let done = work();
    (done, begun.elapsed().as_secs_f64())
}
