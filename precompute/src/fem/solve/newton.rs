//! Newton-Raphson iteration with line search at one prescribed pose. Near the solution, frozen steps reuse
//! the last factorisation with Broyden updates.

use super::factor::{Accuracy, STEP_ACCURACY};
use super::{Configuration, LARGE_FLOPS, Solver};
use crate::fem::boundary::Pose;
use crate::num::vector::magnitude;

/// Convergence options.
#[derive(Debug, Clone, Copy)]
pub struct NewtonOptions {
    /// Maximum number of iterations, including those with a frozen factor.
    pub max_iterations: u32,
    /// A state is converged if its residual is below this share of the force scale. One more correction
    /// reuses the factorisation made for the sensitivities, so that the final relative residual is about the
    /// square of this tolerance.
    pub tolerance: f64,
    /// Maximum number of halvings of a step that does not reduce the residual.
    pub max_halvings: u32,
    /// Maximum number of full steps that are accepted although no fraction of them reduces the residual. Zero
    /// except for a snap-through, see `LoadingOptions::snap_through`.
    pub max_rising_steps: u32,
    /// Whether to use steps with a frozen factor if their estimated cost is lower.
    pub frozen_factor: bool,
    /// Number of floating-point operations of a factorisation from which on the tangent is solved by residual steps.
    pub large_flops: f64,
    /// Share of the equations of a large body, those nearest to the tool, of whose tangent a factor is made at every
    /// state.
    pub near_share: f64,
    /// Whether the factor of a large body at rest turns with its nodes.
    pub turns: bool,
    /// Whether a solution with inverted elements is a failure. By default it is kept and flagged: such states
    /// are stable and smooth, and a missing configuration costs much more accuracy.
    pub reject_inverted: bool,
}

impl Default for NewtonOptions {
    fn default() -> Self {
        Self {
            max_iterations: 40,
            tolerance: 1e-8,
            max_halvings: 5,
            max_rising_steps: 0,
            frozen_factor: true,
            large_flops: LARGE_FLOPS,
            near_share: 0.05,
            turns: true,
            reject_inverted: false,
        }
    }
}

/// Why a position could not be solved. The configuration space stores it with the tag `failed`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FailureReason {
    /// The residual or the state is infinite or NaN.
    #[error("not-finite")]
    NotFinite,
    /// The residual exceeds 1e8 times the larger of the initial residual and the force scale.
    #[error("diverged")]
    Diverged,
    /// No fraction of the Newton step reduces the residual.
    #[error("line-search")]
    LineSearch,
    /// The iteration limit is reached.
    #[error("max-iterations")]
    MaxIterations,
    /// The tangent cannot be solved to the required accuracy.
    #[error("singular-tangent")]
    SingularTangent,
    /// The solution has inverted elements, and the options reject them.
    #[error("inverted")]
    Inverted,
    /// The skin is deep inside a sphere.
    #[error("pierced")]
    Pierced,
    /// A sphere overlaps skin whose nodes are all fixed.
    #[error("fixed-part")]
    FixedPart,
}

/// Error of a solve.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("no equilibrium found ({reason} after {iterations} iterations, residual {residual_n:.1e} N)")]
pub struct SolveFailure {
    /// Why.
    pub reason: FailureReason,
    /// Number of iterations.
    pub iterations: u32,
    /// Last residual norm, N.
    pub residual_n: f64,
}

/// Above this multiple of the larger of the initial residual and the force scale, the iteration counts as
/// diverged.
const DIVERGENCE_FACTOR: f64 = 1e8;
/// Frozen steps start after a Newton step has reduced the residual below this share of the force scale.
const FROZEN_FROM: f64 = 0.1;
/// Frozen steps end if a step leaves at least this share of the residual.
const MIN_GAIN: f64 = 0.3;
/// Estimated costs, in units of a solve with the factor. A flop of the factorisation counts as half a flop of
/// a solve. Besides the factorisation, a Newton step assembles the tangent and solves once. A frozen step
/// evaluates the residual and solves once.
const FACTOR_OPERATION_COST: f64 = 0.5;
const NEWTON_STEP_COST: f64 = 2.0;
const FROZEN_STEP_COST: f64 = 2.0;

/// A residual below this multiple of the tolerance is accepted if no step reduces it further: it has reached
/// its rounding floor. Example: in a part a million times stiffer than the mean, internal forces are so large
/// that their rounding error (1e-16 of them) exceeds the tolerance.
const ROUNDING_FLOOR_FACTOR: f64 = 100.0;
/// A step of a large body; Broyden's updates of the following ones gain what it leaves.
const LARGE_STEP_ACCURACY: Accuracy = Accuracy::new(1e-2, 0.3);

impl Solver {
    /// Equilibrium with the tool at `pose`, from the guess `state`.
    pub fn solve_at(&mut self, pose: &Pose, state: &[f64]) -> Result<Configuration, SolveFailure> {
        (self.iterations, self.factorisations) = (0, 0);
        self.columns.fill(0.0);
        self.attempt(pose, state)
    }

    /// Like [`Solver::solve_at`], but adds its counts to those of the earlier attempts of a transition.
    pub(super) fn attempt(&mut self, pose: &Pose, state: &[f64]) -> Result<Configuration, SolveFailure> {
        self.state.copy_from_slice(state);
        self.prescribe(pose);
        self.factor.begin_state();
        let reached = self.equilibrate();
        let reached =
            reached.and_then(|(residual_n, iterations)| self.condense(pose, residual_n, iterations));
        self.iterations += reached.as_ref().map_or_else(|failure| failure.iterations, |c| c.iterations);
        reached
    }

    /// Newton iteration from `self.state` until the residual is below the tolerance; returns the residual and
    /// the number of iterations.
    ///
    /// The first step may increase the residual; it only has to be finite. Later steps are halved until the
    /// residual decreases. Near the solution the steps use the current factor while this is estimated to be
    /// cheaper than a new factorisation.
    pub(super) fn equilibrate(&mut self) -> Result<(f64, u32), SolveFailure> {
        let (mut iterations, mut rising_steps) = (0, 0);
        // The guess may be a state of the same body with other elements.
        self.problem.body.let_follow(&mut self.state);
        let mut residual_n = self.evaluate(true);
        let first = residual_n.max(self.scale_n());
        let (mut is_frozen, mut has_tangent) = (false, true);
        loop {
            let failed = |reason| Err(SolveFailure { reason, iterations, residual_n });
            if !residual_n.is_finite() {
                return failed(FailureReason::NotFinite);
            }
            if residual_n > DIVERGENCE_FACTOR * first {
                return failed(FailureReason::Diverged);
            }
            if residual_n <= self.newton.tolerance * self.scale_n() {
                return Ok((residual_n, iterations));
            }
            if iterations >= self.newton.max_iterations {
                return failed(FailureReason::MaxIterations);
            }
            iterations += 1;
            if is_frozen {
                if let Some(reached) = self.frozen_step(residual_n) {
                    has_tangent = false;
                    is_frozen = self.stays_frozen(residual_n, reached);
                    residual_n = reached;
                    continue;
                }
                // The frozen step was rejected and the state restored; the residual must be evaluated again.
                residual_n = self.evaluate(true);
                has_tangent = true;
            }
            if !has_tangent {
                self.evaluate(true);
            }
            let floor_n = ROUNDING_FLOOR_FACTOR * self.newton.tolerance * self.scale_n();
            let moved = if self.newton_step() {
                let mut moved = self.line_search(residual_n, iterations == 1);
                if moved.is_none() && residual_n > floor_n && rising_steps < self.newton.max_rising_steps {
                    rising_steps += 1;
                    moved = self.line_search(residual_n, true).map(|(reached, _)| (reached, false));
                }
                moved.ok_or(FailureReason::LineSearch)
            } else {
                Err(FailureReason::SingularTangent)
            };
            let (reached, full) = match moved {
                Ok(moved) => moved,
                Err(_) if residual_n <= floor_n => return Ok((residual_n, iterations)),
                Err(reason) => return Err(SolveFailure { reason, iterations, residual_n }),
            };
            has_tangent = false;
            is_frozen = false;
            if full && self.newton.frozen_factor {
                self.history.clear();
                self.history.push(&self.step);
                is_frozen = reached <= FROZEN_FROM * self.scale_n();
            }
            residual_n = reached;
        }
    }

    /// Whether to continue with the frozen factor after a step from residual `before` to `reached`.
    fn stays_frozen(&self, before: f64, reached: f64) -> bool {
        let tolerance = self.newton.tolerance * self.scale_n();
        let gain = reached / before;
        if gain >= MIN_GAIN || self.history.is_full() {
            return false;
        }
        // Model: a new factorisation squares the relative residual; every frozen step has the gain of the
        // last one.
        let frozen_steps = (libm::log(tolerance / reached) / libm::log(gain)).ceil().max(1.0);
        let relative = reached / self.scale_n();
        let newton_steps = if relative * relative <= self.newton.tolerance { 1.0 } else { 2.0 };
        let newton_cost =
            FACTOR_OPERATION_COST * self.problem.symbolic.factor_over_solve() + NEWTON_STEP_COST;
        frozen_steps * FROZEN_STEP_COST <= newton_steps * newton_cost
    }

    /// One quasi-Newton step with the current factor. `None`, with an unchanged state, if it does not reduce
    /// the residual.
    pub(super) fn frozen_step(&mut self, residual_n: f64) -> Option<f64> {
        self.solve_unrefined();
        if !self.history.apply_broyden(&mut self.step) {
            return None;
        }
        let reached = self.try_step(1.0);
        if reached.is_nan() || reached >= residual_n {
            self.undo_step();
            return None;
        }
        self.history.push(&self.step);
        Some(reached)
    }

    /// Takes the largest step of 1, 1/2, 1/4 .. that reduces the residual; if it `may_rise`, a finite
    /// residual is enough. Returns the new residual and whether the step was the full one. If no step
    /// qualifies, restores the state and returns `None`.
    pub(super) fn line_search(&mut self, residual_n: f64, may_rise: bool) -> Option<(f64, bool)> {
        let mut omega = 1.0;
        for halvings in 0..=self.newton.max_halvings {
            let reached = self.try_step(omega);
            // A step to a non-finite residual is always halved, including the first step.
            if reached < residual_n || (may_rise && reached.is_finite()) {
                return Some((reached, halvings == 0));
            }
            self.undo_step();
            omega *= 0.5;
        }
        None
    }

    /// Assembles at the state and returns the residual norm, N.
    pub(super) fn evaluate(&mut self, with_tangent: bool) -> f64 {
        let problem = &*self.problem;
        if with_tangent {
            self.assembled.assemble(&problem.body, &problem.pattern, &self.state);
        } else {
            self.assembled.assemble_residual(&problem.body, &self.state);
        }
        self.assembled.residual_into(&problem.body, &problem.positions, &mut self.residual);
        self.add_elastic(with_tangent);
        let problem = &*self.problem;
        let scale = problem.body.stiffness_scale_n_m();
        if let Some(held) = problem.held.as_ref().filter(|_| with_tangent) {
            held.split(&mut self.assembled.tangent, &mut self.coupling, scale);
        }
        let held = problem.dofs.multipliers.iter().zip(&self.multipliers).zip(&self.targets_m);
        for ((m, multiplier), target) in held {
            let displacement = problem.dofs.displacement(m.node)[m.axis];
            let u = self.state[3 * m.node as usize + m.axis];
            self.residual[displacement as usize] -= scale * multiplier;
            self.residual[m.equation as usize] = -scale * (u - target);
        }
        magnitude(&self.residual)
    }

    /// Force scale of the residual: the reaction, plus the body force, plus 1e-6 mu l^2 so that it is not
    /// zero at rest.
    pub(super) fn scale_n(&self) -> f64 {
        let body = &self.problem.body;
        let reaction_n = if self.problem.is_elastic() {
            self.elastic.force_n.norm() + self.of_partner().1
        } else {
            magnitude(&self.assembled.force_on(self.problem.handle_nodes()))
        };
        reaction_n
            + self.assembled.load_factor * magnitude(&body.external_force_n)
            + 1e-6 * body.force_scale_n()
    }

    /// Adds omega times the step to the state (pressures converted to Pa) and to the multipliers, and returns
    /// the residual norm there, N.
    pub(super) fn try_step(&mut self, omega: f64) -> f64 {
        let body = &self.problem.body;
        let (displacement_len, pressure_scale) = (body.displacement_len(), body.pressure_scale());
        self.previous.copy_from_slice(&self.state);
        for &(equation, position) in self.problem.positions.iter() {
            let unit = if position < displacement_len { 1.0 } else { pressure_scale };
            self.state[position] += omega * unit * self.step[equation];
        }
        body.let_follow(&mut self.state);
        for (value, m) in self.multipliers.iter_mut().zip(&self.problem.dofs.multipliers) {
            *value += omega * self.step[m.equation as usize];
        }
        self.moved_by = omega;
        self.evaluate(false)
    }

    /// Restores the state and the multipliers before the last [`Solver::try_step`].
    pub(super) fn undo_step(&mut self) {
        std::mem::swap(&mut self.state, &mut self.previous);
        for (value, m) in self.multipliers.iter_mut().zip(&self.problem.dofs.multipliers) {
            *value -= self.moved_by * self.step[m.equation as usize];
        }
    }

    /// right = -residual.
    pub(super) fn negate_residual(&mut self) {
        for (right, r) in self.right.iter_mut().zip(&self.residual) {
            *right = -r;
        }
    }

    /// Solves K step = -residual with the last assembled tangent.
    pub(super) fn newton_step(&mut self) -> bool {
        self.negate_residual();
        self.factorisations += 1;
        self.step.fill(0.0);
        let accuracy = if self.problem.is_large() { LARGE_STEP_ACCURACY } else { STEP_ACCURACY };
        let matrix = self.problem.tangent(&self.assembled.tangent, &self.state);
        let right = &self.right[..self.residual.len()];
        self.factor.factorise_and_solve(matrix, right, &mut self.step, accuracy).is_ok()
    }

    /// Solves K step = -residual with the current factor, without refinement.
    pub(super) fn solve_unrefined(&mut self) {
        self.negate_residual();
        let right = &self.right[..self.residual.len()];
        let matrix = self.problem.matrix(&self.assembled.tangent);
        self.factor.solve_unrefined(matrix, right, &mut self.step);
    }

    /// Last correction of a converged state: one step with the current factor, kept if it does not raise the
    /// residual.
    pub(super) fn final_correction(&mut self, residual_n: f64) -> f64 {
        self.solve_unrefined();
        let reached = self.try_step(1.0);
        if reached <= residual_n {
            return reached;
        }
        // The residual was at its rounding floor before the step.
        self.undo_step();
        self.evaluate(false)
    }
}
