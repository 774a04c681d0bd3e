//! Time profile of a Newton iteration, for `palpate bench fem`. No decision of the solver depends on it.

use std::time::Instant;

use serde::Serialize;

use super::factor::{SENSITIVITY_ACCURACY, STEP_ACCURACY};
use super::{Seed, SolveFailure, Solver};
use crate::fem::assembly::third_derivatives;

/// Duration of each part of one Newton iteration, s.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct IterationProfile {
    /// Assembly of residual and tangent.
    pub assembly_s: f64,
    /// Assembly of the residual alone, as in a line search or a frozen step.
    pub residual_s: f64,
    /// Numeric factorisation; of a large body, of the part near the tool.
    pub factorisation_s: f64,
    /// One solve with the factor, with refinement and check.
    pub solve_s: f64,
    /// One solve with the factor, without refinement and check, as in a frozen step; of a large body, with its
    /// preconditioner.
    pub bare_solve_s: f64,
    /// Three sensitivities, condensed tangent and third derivatives, without the factorisation.
    pub derivatives_s: f64,
    /// The whole iteration: assembly, factorisation, solve, residual at the new state.
    pub iteration_s: f64,
}

impl Solver {
    /// Measures the parts of a Newton iteration at a solved configuration's state.
    pub fn profile(&mut self, seed: &Seed) -> Result<IterationProfile, SolveFailure> {
        let here = self.solve_at(&seed.pose, &seed.state)?;
        self.state.copy_from_slice(&here.seed.state);
        // Fills the caches before the first measurement.
        self.evaluate(true);
        let mut profile = IterationProfile::default();
        let clock = |work: &mut dyn FnMut()| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        };
        profile.assembly_s = clock(&mut || {
            self.evaluate(true);
        });
        profile.residual_s = clock(&mut || {
            self.evaluate(false);
        });
        self.evaluate(true);
        // The right-hand side must resemble a residual: the product of the tangent with a rough step. For an
        // arbitrary vector, unstable pressures (P1/P1) would have no bounded solution.
        for (i, x) in self.step.iter_mut().enumerate() {
            *x = 1e-3 * (((i * 7919 + 13) % 101) as f64 / 101.0 - 0.5);
        }
        self.problem.pattern.multiply(&self.assembled.tangent, &self.step, &mut self.residual);
        let rough = self.residual.clone();
        profile.factorisation_s = clock(&mut || {
            self.factorise_only();
        });
        profile.bare_solve_s = clock(&mut || {
            let matrix = self.problem.matrix(&self.assembled.tangent);
            self.factor.solve_unrefined(matrix, &rough, &mut self.step);
        });
        profile.solve_s = clock(&mut || {
            let matrix = self.problem.matrix(&self.assembled.tangent);
            self.factor.solve(matrix, &rough, &mut self.step, STEP_ACCURACY);
        });
        profile.iteration_s = clock(&mut || {
            self.evaluate(true);
            self.residual.copy_from_slice(&rough);
            self.newton_step();
            self.try_step(1e-9);
        });
        self.state.copy_from_slice(&here.seed.state);
        self.evaluate(true);
        self.translation_columns();
        self.factorise_only();
        profile.derivatives_s = clock(&mut || {
            self.translation_columns();
            let problem = self.problem.clone();
            let matrix = problem.matrix(&self.assembled.tangent);
            self.factor.solve(matrix, &self.right, &mut self.columns, SENSITIVITY_ACCURACY);
            let stiffness = self.condensed_stiffness(&problem);
            let sensitivity = self.sensitivity_of_state();
            std::hint::black_box((stiffness, third_derivatives(&problem.body, &self.state, &sensitivity)));
        });
        Ok(profile)
    }

    fn factorise_only(&mut self) {
        self.factor.follow_next_tangent();
        self.factor.factorise_first(self.problem.tangent(&self.assembled.tangent, &self.state));
    }
}
