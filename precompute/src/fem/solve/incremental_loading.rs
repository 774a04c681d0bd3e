//! Incremental loading: from a solved configuration to a new pose of the handle.

use super::{Configuration, Seed, SolveFailure, Solver};
use crate::fem::boundary::Pose;
use crate::num::branch::Excess;

/// Step control.
#[derive(Debug, Clone, Copy)]
pub struct LoadingOptions {
    /// The step may be halved this often before the transition is given up.
    pub max_halvings: u32,
    /// Tries of the smallest step from a slightly disturbed guess, before the transition is given up: a guess that sits on
    /// a symmetric saddle or at the edge of Newton's basin often needs no more than a push.
    pub perturbations: u32,
    /// Whether a path may go on beyond a fold, where its branch ends, by snapping to another branch as a real body does:
    /// full Newton steps are then taken uphill, and where they end is accepted if it is stable and has no more inverted
    /// elements than the state before.
    pub snap_through: bool,
}

impl Default for LoadingOptions {
    fn default() -> Self {
        Self { max_halvings: 5, perturbations: 2, snap_through: true }
    }
}

/// What a solve took.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Newton and quasi-Newton steps.
    pub iterations: u32,
    /// Factorisations among them.
    pub factorisations: u32,
}

/// Full steps uphill that a snap may take.
const UPHILL: u32 = 3;

/// Largest disturbance of a displacement component, in mean edge lengths.
const PUSH: f64 = 1e-3;

impl Solver {
    /// Transition from `from` to a displacement of the handle (the paper's C -> C').
    pub fn advance(&mut self, from: &Seed, target_m: [f64; 3]) -> Result<Configuration, SolveFailure> {
        let target = Pose { displacement_m: target_m, ..from.pose };
        self.advance_to(from, &target)
    }

    /// Transition from `from` to a pose of the handle.
    ///
    /// The whole step is tried first, with the tangent predictor state + X dd as the guess (measured: one 5 mm step
    /// takes 3 iterations where five 1 mm increments take 15 to 20); a step that fails is halved, a step that
    /// succeeds is followed by the largest that is left. Then the guess is disturbed, by a fixed pseudo-random push, and at
    /// last the body may snap through, once with all of the step that is left and once with half of it.
    ///
    /// A solution that does not join the last one smoothly ([`Excess`]) counts as failed while the step can be halved; then it
    /// is taken and flagged: the branch ended, or another one crossed it. If the small steps find nothing at all, the solution
    /// that a large one jumped to is better than none, and flagged too.
    /// Deviation from the paper: it splits every transition into M equal increments without a predictor.
    pub fn advance_to(&mut self, from: &Seed, target: &Pose) -> Result<Configuration, SolveFailure> {
        let (mut done, mut step) = (0.0, 1.0);
        let (mut halvings, mut pushes) = (0, 0);
        let mut may_snap = self.loading.snap_through;
        let mut spent = Spent::default();
        let mut here: Option<Configuration> = None;
        let mut switched = false;
        // How far a step got that jumped, and where to.
        let mut elsewhere: Option<(f64, Configuration)> = None;
        let mut guess = vec![0.0; from.state.len()];
        let pose_at = |done: f64| if done >= 1.0 { *target } else { from.pose.towards(target, done) };
        loop {
            let seed = here.as_ref().map_or(from, |c| &c.seed);
            let pose = pose_at(done + step);
            predict(seed, &pose, &mut guess);
            if pushes > 0 {
                self.push(&mut guess, pushes);
            }
            let configuration = match self.solve_at(&pose, &guess) {
                Ok(configuration) => {
                    let jumps = leaves_branch(seed, &configuration);
                    if jumps && halvings < self.loading.max_halvings {
                        spent.add(configuration.iterations, configuration.factorisations);
                        halvings += 1;
                        let counted = Configuration { iterations: 0, factorisations: 0, ..configuration };
                        elsewhere.get_or_insert((done + step, counted));
                        step *= 0.5;
                        continue;
                    }
                    switched |= jumps;
                    configuration
                }
                Err(failure) => {
                    spent.add(failure.iterations, self.factorisations);
                    if halvings < self.loading.max_halvings {
                        halvings += 1;
                        step *= 0.5;
                        continue;
                    }
                    if pushes < self.loading.perturbations {
                        pushes += 1;
                        continue;
                    }
                    let left = 1.0 - done;
                    let mut snap = |share: f64| {
                        self.snap_through(seed, &pose_at(done + share), &mut guess, &mut spent)
                            .map(|configuration| (share, configuration))
                    };
                    let landed = match elsewhere.take().filter(|(reached, _)| *reached > done) {
                        Some((reached, configuration)) => Some((reached - done, configuration)),
                        None if std::mem::take(&mut may_snap) => snap(left).or_else(|| snap(0.5 * left)),
                        None => None,
                    };
                    let Some((share, configuration)) = landed else {
                        return Err(SolveFailure { iterations: spent.iterations, ..failure });
                    };
                    switched |= leaves_branch(seed, &configuration);
                    step = share;
                    configuration
                }
            };
            spent.add(configuration.iterations, configuration.factorisations);
            spent.increments += 1;
            done += step;
            if done >= 1.0 {
                let Spent { iterations, factorisations, increments } = spent;
                return Ok(Configuration {
                    iterations,
                    factorisations,
                    increments,
                    switched,
                    ..configuration
                });
            }
            here = Some(configuration);
            step = (2.0 * step).min(1.0 - done);
        }
    }

    /// Equilibrium at `pose` on whatever branch full steps uphill lead to, if it is stable and has no more inverted
    /// elements than the seed.
    fn snap_through(
        &mut self,
        seed: &Seed,
        pose: &Pose,
        guess: &mut [f64],
        spent: &mut Spent,
    ) -> Option<Configuration> {
        self.state.copy_from_slice(&seed.state);
        self.evaluate(false);
        let inverted = self.assembled.inverted;
        predict(seed, pose, guess);
        let downhill = std::mem::replace(&mut self.newton.max_uphill, UPHILL);
        let landed = self.solve_at(pose, guess);
        self.newton.max_uphill = downhill;
        match landed {
            Ok(c) if c.unstable_modes == Some(0) && c.inverted <= inverted => Some(c),
            Ok(c) => {
                spent.add(c.iterations, c.factorisations);
                None
            }
            Err(failure) => {
                spent.add(failure.iterations, self.factorisations);
                None
            }
        }
    }

    /// The bare solve of one whole step, without what is read off the solution: what a benchmark compares.
    pub fn reach(&mut self, from: &Seed, target: &Pose) -> Result<Effort, SolveFailure> {
        let mut guess = vec![0.0; from.state.len()];
        predict(from, target, &mut guess);
        self.state.copy_from_slice(&guess);
        self.hold(target);
        self.factorisations = 0;
        let (_, iterations) = self.equilibrate()?;
        Ok(Effort { iterations, factorisations: self.factorisations })
    }

    /// Adds a pseudo-random displacement to every node; the same one for the same `number`.
    fn push(&self, state: &mut [f64], number: u32) {
        let size = PUSH * self.problem.body.edge_m;
        let mut bits = 0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(u64::from(number));
        for value in &mut state[..self.problem.body.displacement_len()] {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *value += size * ((bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0);
        }
        // What is held stays where it is held.
        for (value, fixed) in state.iter_mut().zip(self.problem.body.fixed.as_flattened()) {
            if *fixed {
                *value = 0.0;
            }
        }
    }
}

/// Whether a solution does not join the seed's smoothly. A turned handle moves W by more than the displacement, which is
/// all that is known of it: then nothing is said.
fn leaves_branch(seed: &Seed, found: &Configuration) -> bool {
    let turned = seed.pose.rotation_rad != found.seed.pose.rotation_rad;
    let moved = seed.pose.displacement_m != found.seed.pose.displacement_m;
    moved && !turned && Excess::between(&seed.jet, found.jet()).is_jump()
}

/// What a transition has cost so far.
#[derive(Debug, Clone, Copy, Default)]
struct Spent {
    iterations: u32,
    factorisations: u32,
    increments: u32,
}

impl Spent {
    fn add(&mut self, iterations: u32, factorisations: u32) {
        self.iterations += iterations;
        self.factorisations += factorisations;
    }
}

/// First-order guess of the state at `pose`.
fn predict(seed: &Seed, pose: &Pose, state: &mut [f64]) {
    state.copy_from_slice(&seed.state);
    for (axis, column) in seed.sensitivity.iter().enumerate() {
        let change = pose.displacement_m[axis] - seed.pose.displacement_m[axis];
        if change != 0.0 {
            for (value, slope) in state.iter_mut().zip(column) {
                *value += change * slope;
            }
        }
    }
}
