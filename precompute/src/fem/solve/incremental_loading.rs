//! Incremental loading from a solved configuration to a new pose of the handle: the prescribed nodes, which
//! are the active node or a rigid patch. A [`Seed`] is the solved state from which a solve starts.

use super::{Configuration, Seed, SolveFailure, Solver};
use crate::fem::boundary::{Contact, Pose};
use crate::num::branch::Excess;
use crate::num::jet::EnergyJet;

/// Options of the step control.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LoadingOptions {
    /// Maximum number of halvings of the step in one transition.
    pub max_halvings: u32,
    /// Maximum number of attempts with a perturbed guess in one transition, when no halvings are left. A
    /// small perturbation often moves a guess off a symmetric saddle point, or into Newton's basin of
    /// convergence.
    pub perturbations: u32,
    /// Whether a path may continue beyond a fold, where its branch ends, by snap-through to another branch,
    /// as a real body does. The solver then takes full Newton steps although the residual rises. It accepts
    /// the solution if it is stable and has no more inverted elements than the state before.
    pub snap_through: bool,
}

impl Default for LoadingOptions {
    fn default() -> Self {
        Self { max_halvings: 5, perturbations: 2, snap_through: true }
    }
}

/// Maximum number of full steps with a rising residual in a snap-through.
const MAX_RISING_STEPS: u32 = 3;

/// Largest perturbation of a displacement component, in mean edge lengths.
const MAX_PERTURBATION: f64 = 1e-3;

impl Solver {
    /// Transition from `from` to a displacement of the handle, m (the paper's C -> C').
    pub fn advance(&mut self, from: &Seed, target_m: [f64; 3]) -> Result<Configuration, SolveFailure> {
        let target = Pose { displacement_m: target_m, ..from.pose };
        self.advance_to(from, &target)
    }

    /// Transition from `from` to a pose of the handle.
    ///
    /// The first attempt is the whole step with the tangent predictor state + X dd as the guess (measured:
    /// one 5 mm step takes 3 iterations, five 1 mm increments take 15 to 20). A failed step is halved. A
    /// successful step is followed by one of twice the size, limited to the remaining transition. If a step
    /// fails when no halvings are left, it is tried again with a guess that is perturbed by deterministic
    /// pseudo-random displacements. From then on the guess of every step of this transition is perturbed,
    /// also after a success.
    ///
    /// A solution on a different branch than the last one (test of `num::branch`) counts as a failed step
    /// while halvings are left. When none is left, it is accepted and flagged as a branch jump. If a step
    /// fails when neither halvings nor perturbations are left, the first solution found on a different branch
    /// is accepted and flagged, if it lies ahead. Without such a solution a snap-through is tried once per
    /// transition: over the whole remaining transition, then over half of it.
    ///
    /// Deviation from the paper: the paper divides every transition into M equal increments without a
    /// predictor.
    pub fn advance_to(&mut self, from: &Seed, target: &Pose) -> Result<Configuration, SolveFailure> {
        let (mut done, mut step) = (0.0, 1.0);
        let (mut halvings, mut perturbations_done) = (0, 0);
        let mut may_snap = self.loading.snap_through;
        let mut increments = 0;
        (self.iterations, self.factorisations) = (0, 0);
        let mut here: Option<Configuration> = None;
        let mut switched = false;
        // The first step that jumped to a different branch: the part of the transition up to its end, and its
        // solution.
        let mut on_other_branch: Option<(f64, Configuration)> = None;
        let mut guess = vec![0.0; from.state.len()];
        let pose_at = |done: f64| if done >= 1.0 { *target } else { from.pose.towards(target, done) };
        loop {
            let seed = here.as_ref().map_or(from, |c| &c.seed);
            let pose = pose_at(done + step);
            predict(seed, &pose, &mut guess);
            if perturbations_done > 0 {
                self.perturb(&mut guess, perturbations_done);
            }
            self.begin_columns(seed);
            let configuration = match self.attempt(&pose, &guess) {
                Ok(configuration) => {
                    let jumps = self.leaves_branch(seed, &configuration);
                    if jumps && halvings < self.loading.max_halvings {
                        halvings += 1;
                        on_other_branch.get_or_insert((done + step, configuration));
                        step *= 0.5;
                        continue;
                    }
                    switched |= jumps;
                    configuration
                }
                Err(failure) => {
                    if halvings < self.loading.max_halvings {
                        halvings += 1;
                        step *= 0.5;
                        continue;
                    }
                    if perturbations_done < self.loading.perturbations {
                        perturbations_done += 1;
                        continue;
                    }
                    let left = 1.0 - done;
                    let mut snap = |step: f64| {
                        self.snap_through(seed, &pose_at(done + step), &mut guess)
                            .map(|configuration| (step, configuration))
                    };
                    let landed = match on_other_branch.take().filter(|(reached, _)| *reached > done) {
                        Some((reached, configuration)) => Some((reached - done, configuration)),
                        None if std::mem::take(&mut may_snap) => snap(left).or_else(|| snap(0.5 * left)),
                        None => None,
                    };
                    let Some((landed_step, configuration)) = landed else {
                        return Err(SolveFailure { iterations: self.iterations, ..failure });
                    };
                    switched |= self.leaves_branch(seed, &configuration);
                    step = landed_step;
                    configuration
                }
            };
            increments += 1;
            done += step;
            if done >= 1.0 {
                let (iterations, factorisations) = (self.iterations, self.factorisations);
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

    /// Equilibrium at `pose`, found by Newton's method with full steps that may increase the residual.
    /// Accepted if it is stable and has no more inverted elements than the seed.
    pub(super) fn snap_through(
        &mut self,
        seed: &Seed,
        pose: &Pose,
        guess: &mut [f64],
    ) -> Option<Configuration> {
        self.state.copy_from_slice(&seed.state);
        self.evaluate(false);
        let inverted = self.assembled.inverted;
        predict(seed, pose, guess);
        self.begin_columns(seed);
        let usual_rising_steps = std::mem::replace(&mut self.newton.max_rising_steps, MAX_RISING_STEPS);
        let landed = self.attempt(pose, guess);
        self.newton.max_rising_steps = usual_rising_steps;
        let landed = landed.ok().filter(|c| c.inverted <= inverted)?;
        // The solve of a large body does not tell.
        let is_unknown = landed.unstable_modes.is_none() && self.problem.is_large();
        let unstable_modes =
            if is_unknown { self.unstable_modes_at(&landed.seed) } else { landed.unstable_modes };
        (unstable_modes == Some(0)).then_some(Configuration { unstable_modes, ..landed })
    }

    /// Solves one whole step without the condensed quantities, for benchmarks. Returns the numbers of
    /// iterations and of factorisations.
    pub fn reach(&mut self, from: &Seed, target: &Pose) -> Result<(u32, u32), SolveFailure> {
        let mut guess = vec![0.0; from.state.len()];
        predict(from, target, &mut guess);
        self.state.copy_from_slice(&guess);
        self.prescribe(target);
        self.factorisations = 0;
        let (_, iterations) = self.equilibrate()?;
        Ok((iterations, self.factorisations))
    }

    /// Whether a solution lies on a different branch than the seed. The result is `false` if the handle rotates, because
    /// the test covers only the work of the displacement.
    ///
    /// The test with third derivatives decides where that without them fails, as it does over a long step along a curved
    /// branch. Under a sphere that comes to other edges of the skin they say nothing about the whole step.
    fn leaves_branch(&self, seed: &Seed, found: &Configuration) -> bool {
        let turned = seed.pose.rotation_rad != found.seed.pose.rotation_rad;
        let moved = seed.pose.displacement_m != found.seed.pose.displacement_m;
        let is_sphere = matches!(self.problem.contact, Some(Contact::Sphere(_)));
        let is_jump = |excess: fn(&EnergyJet, &EnergyJet) -> Excess| excess(&seed.jet, found.jet()).is_jump();
        moved && !turned && is_jump(Excess::between) && (is_sphere || is_jump(Excess::with_thirds))
    }

    /// Adds a pseudo-random displacement to every node; `number` determines the sequence.
    pub(super) fn perturb(&self, state: &mut [f64], number: u32) {
        let size = MAX_PERTURBATION * self.problem.body.edge_m;
        let mut bits = 0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(u64::from(number));
        for value in &mut state[..self.problem.body.displacement_len()] {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *value += size * ((bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0);
        }
        // Fixed components stay fixed.
        for (value, fixed) in state.iter_mut().zip(self.problem.body.fixed.as_flattened()) {
            if *fixed {
                *value = 0.0;
            }
        }
    }
}

/// First-order prediction of the state at `pose`.
pub(super) fn predict(seed: &Seed, pose: &Pose, state: &mut [f64]) {
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
