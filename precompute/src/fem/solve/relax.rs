//! Where a body comes to rest when its branch has ended: the motion of a heavily damped body.
//!
//! At a fold the equilibrium that a continuation follows ceases to exist, and Newton's method finds nothing for
//! a while. A real body moves on, downhill in energy, until it rests in another equilibrium. With the force
//! -a du/dt of a damper on every displacement, an implicit step of pseudo-time is
//!
//! (K + a I_u) du = -r,
//!
//! with I_u = 1 for displacements and 0 for pressures, which keep the constraint. As a falls the step becomes
//! that of Newton's method. A step counts if the damped matrix has no more negative pivots than that of a stable
//! state, and if the step does not go far beyond the lowest point in its direction:
//!
//! g(end) <= -g(start) / 4,   g = r_u . du - r_q . dq.
//!
//! At the start g = -du . (K_uu + a I) du - dq . D dq < 0, with D of the pressures' own block. Then a shrinks to
//! 0.4 a; else the step is undone and a grows to 5 a. No value of the potential is compared, because that of a body
//! with pressures has no minimum. The last steps are those of Newton's method.

use super::follow::{FRESH, FollowCount, Followed};
use super::{FailureReason, Seed, SolveFailure, Solver};
use crate::fem::boundary::Pose;
use crate::num::vector::distance;

/// Start of a, in units of the stiffness scale.
const FIRST_DAMPING: f64 = 0.03;
/// Below this a the body has come to rest.
const LAST_DAMPING: f64 = 1e-3;
/// Factors of a after a step that counts, and after one that does not.
const LESS: f64 = 0.4;
const MORE: f64 = 5.0;
/// Longest step of the tool, m.
const RAMP_M: f64 = 2e-3;
/// The body rests if its residual is below this share of the force scale.
const RESIDUAL: f64 = 1e-4;

/// Steps that are enough for every descent that was met.
pub const DESCENT_STEPS: u32 = 80;

impl Solver {
    /// The equilibrium with the tool at `control_m` in which the body comes to rest from the state of `from`,
    /// written into `to`, whose vectors have the lengths of those of `from`. The body is first moved a little, so
    /// that it leaves an equilibrium that is not stable; the tool goes there in short steps, half of `max_steps` at
    /// most. Makes a factorisation a step; the last one is that of the equilibrium.
    ///
    /// # Errors
    ///
    /// [`FailureReason::MaxIterations`] if it does not rest, [`FailureReason::NotFinite`] if no step is finite.
    ///
    /// # Panics
    ///
    /// If the problem uses multipliers: a descent needs elimination.
    pub fn relax(
        &mut self,
        from: &Seed,
        control_m: [f64; 3],
        max_steps: u32,
        to: &mut Seed,
    ) -> Result<Followed, SolveFailure> {
        assert!(self.problem.dofs.multipliers.is_empty(), "a descent needs elimination");
        let pose = Pose { displacement_m: control_m, ..from.pose };
        let mut state = std::mem::take(&mut self.state);
        state.copy_from_slice(&from.state);
        self.perturb(&mut state, 1);
        self.state = state;
        self.history.clear();
        self.descend(from, pose, max_steps, to)
    }

    fn descend(
        &mut self,
        from: &Seed,
        pose: Pose,
        max_steps: u32,
        to: &mut Seed,
    ) -> Result<Followed, SolveFailure> {
        let problem = self.problem.clone();
        let n = problem.unknowns();
        let unit = problem.body.stiffness_scale_n_m();
        let mut count = FollowCount::default();
        let mut damping = FIRST_DAMPING * unit;
        // An element at a held node would invert if it went there at once.
        let way_m = distance(from.pose.displacement_m, pose.displacement_m);
        let steps = (way_m / RAMP_M).ceil().min(f64::from(max_steps / 2));
        for step in 1..steps as u32 {
            self.prescribe(&from.pose.towards(&pose, f64::from(step) / steps));
            self.evaluate(true);
            (count.steps, count.factorisations) = (count.steps + 1, count.factorisations + 1);
            damping *= if self.damped_step(damping) { 1.0 } else { MORE };
        }
        self.prescribe(&pose);
        let mut residual_n = self.evaluate(true);
        while residual_n > RESIDUAL * self.scale_n() || damping >= LAST_DAMPING * unit {
            let failed = |reason| Err(SolveFailure { reason, iterations: count.steps, residual_n });
            if !residual_n.is_finite() {
                return failed(FailureReason::NotFinite);
            }
            if count.steps >= max_steps {
                return failed(FailureReason::MaxIterations);
            }
            count.steps += 1;
            count.factorisations += 1;
            let counts = self.damped_step(damping);
            damping *= if counts { LESS } else { MORE };
            // The tangent of the state that the step ended in, or of the one before it.
            residual_n = self.evaluate(true);
        }
        count.factorisations += 1;
        self.translation_columns();
        let matrix = problem.matrix(&self.assembled.tangent);
        let columns = &mut self.columns[..3 * n];
        let solved = self.factor.factorise_and_solve(matrix, &self.right, columns, FRESH);
        self.conclude(&pose, residual_n, solved.ok(), count, to)
    }

    /// One implicit step of pseudo-time; whether it counts. A step that does not is undone.
    fn damped_step(&mut self, damping: f64) -> bool {
        let problem = self.problem.clone();
        let displacement_len = problem.body.displacement_len();
        for &(equation, position) in problem.positions.iter() {
            if position < displacement_len {
                self.assembled.tangent[problem.pattern.column_starts[equation]] += damping;
            }
        }
        if !self.factor.factorise_first(problem.matrix(&self.assembled.tangent))
            || self.factor.unstable_modes(&problem.symbolic) != Some(0)
        {
            return false;
        }
        self.solve_unrefined();
        let before = self.descent();
        let reached = self.try_step(1.0);
        // The comparisons are false for NaN.
        if reached.is_finite() && self.descent() <= -0.25 * before {
            return true;
        }
        self.undo_step();
        false
    }

    /// r_u . du - r_q . dq along the last step.
    fn descent(&self) -> f64 {
        let displacement_len = self.problem.body.displacement_len();
        let term = |&(equation, position): &(usize, usize)| {
            let sign = if position < displacement_len { 1.0 } else { -1.0 };
            sign * self.residual[equation] * self.step[equation]
        };
        self.problem.positions.iter().map(term).sum()
    }
}
