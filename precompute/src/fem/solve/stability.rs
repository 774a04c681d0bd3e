//! Stability of an equilibrium that was found without a factor of its tangent.

use super::factor::STEP_ACCURACY;
use super::{Problem, Seed, Solver};

/// Operations that the checks of stability may cost a solve of a large body on average: about a second.
const CHECK_FLOPS: f64 = 4e10;

impl Problem {
    /// Of so many solves of a large body one has its stability determined.
    pub fn solves_a_check(&self) -> u64 {
        (self.factor_flops() / CHECK_FLOPS).ceil().max(1.0) as u64
    }
}

impl Solver {
    /// The configuration at this control gets a factor, so that its stability is known, also if the body is large.
    pub fn determine_stability_at(&mut self, control_m: Option<[f64; 3]>) {
        self.factor_at_m = control_m;
    }

    /// Number of unstable modes of a solved configuration, from a factor of its tangent that is made for this purpose
    /// alone; `None` if the factor does not give it, or does not solve the tangent. For a large body, whose solves make
    /// none.
    pub fn unstable_modes_at(&mut self, seed: &Seed) -> Option<u32> {
        self.state.copy_from_slice(&seed.state);
        self.prescribe(&seed.pose);
        self.history.clear();
        self.factor.begin_state();
        self.evaluate(true);
        self.translation_columns();
        let problem = self.problem.clone();
        let symbolic = &problem.symbolic;
        let matrix = problem.matrix(&self.assembled.tangent);
        self.factorisations += 1;
        // In double precision: near an instability single precision has the wrong sign.
        let is_made = self.factor.factorise_first(matrix);
        // A factor that does not solve the tangent may have wrong signs, too.
        let Self { factor, right, columns, .. } = self;
        let serves = is_made && STEP_ACCURACY.accepts(factor.solve(matrix, right, columns, STEP_ACCURACY));
        serves.then(|| self.factor.unstable_modes(symbolic)).flatten()
    }
}
