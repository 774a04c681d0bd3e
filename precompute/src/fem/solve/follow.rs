//! Continuation with the factor at hand: a new jet in a fraction of the time of [`Solver::advance`].
//!
//! A solver beside the haptic loop needs many jets near each other and none to the last digit. From a seed with
//! the state u, the sensitivities X and the control d0, the state at d is guessed as u + X (d - d0). Broyden steps
//! with the factor of an earlier jet bring the residual r down to a share of the force, and sweeps of refinement
//! with the same factor bring X to the tangent of the new state. Then
//!
//! h = dL/dd + X^T r           the error is of second order in that of the state (adjoint correction),
//! S by the formula of `condensed_stiffness`, of second order in the error of X,
//! W = L,                      of second order in the error of the state,
//! W_ijk = D3 L [X_i, X_j, X_k], of first order in the error of X.
//!
//! A new factorisation is made if it is asked for, if there is no factor yet, if the steps do not converge, or if
//! X does not.

use nalgebra::Matrix3;

use super::factor::{Accuracy, MAX_STEPS};
use super::{FailureReason, Seed, SolveFailure, Solver};
use crate::fem::boundary::Pose;
use crate::num::jet::EnergyJet;
use crate::num::vector::inner;

/// How accurate a continuation is, and what it may cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FollowOptions {
    /// The state is good enough if its residual is below this share of the force scale.
    pub residual: f64,
    /// Largest number of steps with one factor.
    pub max_frozen_steps: u32,
    /// Largest number of all steps.
    pub max_steps: u32,
    /// X is good enough below this relative residual.
    pub sensitivity: f64,
    /// Largest number of sweeps for it.
    pub max_sweeps: u32,
    /// Above this relative residual after the sweeps a new factor is made.
    pub worst_sensitivity: f64,
    /// Whether a new factor is made where the one at hand does not serve for Broyden steps and sweeps. If not,
    /// Newton steps are solved with it by generalised conjugate residuals.
    pub renews: bool,
    /// Whether the continuation of a large body is given up where its preconditioner does not serve, because factors of its
    /// tangents take seconds.
    pub gives_up: bool,
}

impl Default for FollowOptions {
    fn default() -> Self {
        Self {
            residual: 1e-3,
            max_frozen_steps: 8,
            max_steps: 30,
            sensitivity: 3e-3,
            max_sweeps: 6,
            worst_sensitivity: 0.3,
            renews: true,
            gives_up: false,
        }
    }
}

/// Accuracy of X after a new factorisation for it.
pub(super) const FRESH: Accuracy = Accuracy::new(1e-4, 1e-2);

/// A Newton step that is solved with a factor of another tangent ends below this relative residual,
const STEP_RESIDUAL: f64 = 0.03;
/// and is taken below this one.
const WORST_STEP_RESIDUAL: f64 = 0.5;

/// Work of a continuation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FollowCount {
    /// Steps, with a frozen or a new factor.
    pub steps: u32,
    /// Factorisations.
    pub factorisations: u32,
    /// Sweeps of refinement of the sensitivities, and of Newton steps.
    pub sweeps: u32,
}

/// Figures of a continuation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Followed {
    /// Work.
    pub count: FollowCount,
    /// Norm of the residual, N.
    pub residual_n: f64,
    /// Largest relative residual of the sensitivities.
    pub sensitivity: f64,
    /// Number of elements with J <= 0.
    pub inverted: usize,
    /// Number of directions in which the energy decreases; known only from a factor of this continuation.
    pub unstable_modes: Option<u32>,
}

impl Solver {
    /// The equilibrium at `control_m`, continued from `from`, written into `to`, whose vectors have the lengths of
    /// those of `from`. With `refresh` the first step makes a new factor. Allocates nothing once a factor was made
    /// (unless the matrix needs pivoting).
    ///
    /// # Panics
    ///
    /// If the problem uses multipliers: continuation needs elimination.
    pub fn follow(
        &mut self,
        from: &Seed,
        control_m: [f64; 3],
        refresh: bool,
        options: &FollowOptions,
        to: &mut Seed,
    ) -> Result<Followed, SolveFailure> {
        assert!(self.problem.dofs.multipliers.is_empty(), "continuation needs elimination");
        let pose = Pose { displacement_m: control_m, ..from.pose };
        let mut count = FollowCount::default();
        self.factor.gives_up = options.gives_up;
        let reached = self.reach_frozen(from, &pose, refresh, options, &mut count).map(|residual_n| {
            self.evaluate(true);
            (residual_n, self.follow_sensitivity(from, options, &mut count))
        });
        self.factor.gives_up = false;
        let (residual_n, sensitivity) = reached?;
        self.conclude(&pose, residual_n, sensitivity, count, to)
    }

    /// Writes the state that was reached, with its tangent and sensitivities in place, and its jet into `to`.
    /// `sensitivity` is the largest relative residual of the columns X, or `None` if they could not be solved.
    pub(super) fn conclude(
        &mut self,
        pose: &Pose,
        residual_n: f64,
        sensitivity: Option<f64>,
        count: FollowCount,
        to: &mut Seed,
    ) -> Result<Followed, SolveFailure> {
        let fail = |reason| SolveFailure { reason, iterations: count.steps, residual_n };
        let sensitivity = sensitivity.ok_or(fail(FailureReason::SingularTangent))?;
        if self.is_pierced() {
            return Err(fail(FailureReason::Pierced));
        }
        let (problem, n) = (self.problem.clone(), self.problem.unknowns());
        let stiffness = self.condensed_stiffness(&problem);
        self.sensitivity_into(&mut to.sensitivity);
        let (mut force_n, _) = self.resultants(pose);
        for (axis, force) in force_n.iter_mut().enumerate() {
            *force += inner(&self.columns[axis * n..(axis + 1) * n], &self.residual);
        }
        to.pose = *pose;
        to.state.copy_from_slice(&self.state);
        let is_free = problem.is_elastic() && self.elastic.own_n_m == Matrix3::zeros();
        to.jet = EnergyJet {
            control_m: pose.displacement_m,
            energy_j: self.assembled.energy_j - problem.body.rest_energy_j
                + self.elastic.energy_j
                + self.of_partner().0,
            force_n,
            stiffness_n_m: 0.5 * (stiffness + stiffness.transpose()),
            third_n_m2: self.third(&to.sensitivity),
        };
        if is_free {
            // The rest is what the sweeps have left of the columns.
            let energy_j = to.jet.energy_j;
            to.jet = EnergyJet { energy_j, ..EnergyJet::from_numbers(pose.displacement_m, &[0.0; 20]) };
            to.sensitivity.iter_mut().for_each(|column| column.fill(0.0));
        }
        to.coupling = self.coupling(&to.sensitivity);
        if !is_free {
            self.complete(&mut to.coupling);
        }
        if !to.jet.is_finite() {
            return Err(fail(FailureReason::NotFinite));
        }
        let unstable_modes =
            (count.factorisations > 0).then(|| self.factor.unstable_modes(&problem.symbolic)).flatten();
        let inverted = self.assembled.inverted;
        Ok(Followed { count, residual_n, sensitivity, inverted, unstable_modes })
    }

    /// Brings `self.state` to the equilibrium at `pose`; returns the residual.
    fn reach_frozen(
        &mut self,
        from: &Seed,
        pose: &Pose,
        refresh: bool,
        options: &FollowOptions,
        count: &mut FollowCount,
    ) -> Result<f64, SolveFailure> {
        let mut state = std::mem::take(&mut self.state);
        super::incremental_loading::predict(from, pose, &mut state);
        self.problem.body.let_follow(&mut state);
        self.state = state;
        self.prescribe(pose);
        self.history.clear();
        self.factor.begin_state();
        let mut is_fresh = refresh || !self.factor.is_ready();
        let renews = options.renews || is_fresh;
        let mut frozen = 0;
        let mut residual_n = self.evaluate(is_fresh);
        loop {
            let failed = |reason, steps| Err(SolveFailure { reason, iterations: steps, residual_n });
            if !residual_n.is_finite() {
                return failed(FailureReason::NotFinite, count.steps);
            }
            let enough_n = options.residual * self.scale_n();
            // A factor that is asked for is made in any case: it serves the sensitivities and later jets.
            if residual_n <= enough_n && !(is_fresh && renews && count.factorisations == 0) {
                return Ok(residual_n);
            }
            if count.steps >= options.max_steps {
                return failed(FailureReason::MaxIterations, count.steps);
            }
            count.steps += 1;
            if is_fresh {
                let is_solved = if renews {
                    count.factorisations += 1;
                    self.newton_step()
                } else {
                    self.newton_step_by_residual_steps(&mut count.sweeps)
                };
                if !is_solved {
                    return failed(FailureReason::SingularTangent, count.steps);
                }
                let Some((reached, full)) = self.line_search(residual_n, count.steps == 1) else {
                    // At the rounding floor no step helps.
                    if residual_n <= enough_n {
                        return Ok(residual_n);
                    }
                    return failed(FailureReason::LineSearch, count.steps);
                };
                self.history.clear();
                if full && renews {
                    self.history.push(&self.step);
                }
                (residual_n, is_fresh, frozen) = (reached, !renews, 0);
                if is_fresh && residual_n > enough_n {
                    self.evaluate(true);
                }
                continue;
            }
            frozen += 1;
            let reached = self.frozen_step(residual_n);
            let goes_on = reached.is_some_and(|reached| {
                let steps = libm::log(enough_n / reached) / libm::log(reached / residual_n);
                reached <= enough_n
                    || frozen < options.max_frozen_steps
                        && !self.history.is_full()
                        && steps <= f64::from(options.max_frozen_steps - frozen)
            });
            is_fresh = !goes_on;
            residual_n = match reached {
                Some(reached) if goes_on => reached,
                _ => self.evaluate(true),
            };
        }
    }

    /// The columns X of a seed, as a start.
    pub(super) fn begin_columns(&mut self, from: &Seed) {
        let Self { problem, columns, .. } = self;
        let body = &problem.body;
        let (displacement_len, pressure_scale) = (body.displacement_len(), body.pressure_scale());
        // The components of a held node have no part in it.
        columns.fill(0.0);
        for (column, sensitivity) in columns.chunks_mut(problem.unknowns()).zip(&from.sensitivity) {
            for &(equation, position) in problem.positions.iter() {
                let unit = if position < displacement_len { 1.0 } else { pressure_scale };
                column[equation] = sensitivity[position] / unit;
            }
        }
    }

    /// A Newton step with a factor of another tangent; whether it is solved well enough.
    fn newton_step_by_residual_steps(&mut self, sweeps: &mut u32) -> bool {
        self.negate_residual();
        self.step.fill(0.0);
        let matrix = self.problem.tangent(&self.assembled.tangent, &self.state);
        let (right, goal) = (&self.right[..self.residual.len()], (STEP_RESIDUAL, MAX_STEPS));
        let (left, steps) = self.factor.refine(matrix, right, &mut self.step, goal);
        *sweeps += steps;
        left <= WORST_STEP_RESIDUAL
    }

    /// Brings the columns X from those of a seed to the tangent at hand; returns their largest relative residual.
    /// `None` if also a new factor does not solve them.
    fn follow_sensitivity(
        &mut self,
        from: &Seed,
        options: &FollowOptions,
        count: &mut FollowCount,
    ) -> Option<f64> {
        let problem = self.problem.clone();
        self.translation_columns();
        self.begin_columns(from);
        let matrix = problem.tangent(&self.assembled.tangent, &self.state);
        let goal = (options.sensitivity, options.max_sweeps as usize);
        let (mut residual, sweeps) = self.factor.refine(matrix, &self.right, &mut self.columns, goal);
        count.sweeps += sweeps;
        if residual.is_nan() || residual > options.worst_sensitivity {
            if !options.renews {
                return None;
            }
            count.factorisations += 1;
            let solved = self.factor.factorise_and_solve(matrix, &self.right, &mut self.columns, FRESH);
            residual = solved.ok()?;
            self.history.clear();
        }
        Some(residual)
    }
}
