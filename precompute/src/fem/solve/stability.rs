//! Stability of an equilibrium that was found without a factor of its tangent.

use super::factor::{SingleFactor, SingleScratch};
use super::{Seed, Solver};

impl Solver {
    /// Number of unstable modes of a solved configuration, from a factor of its tangent that is made for this purpose
    /// alone; `None` if the factor does not give it. For a large body, whose solves make none.
    pub fn unstable_modes_at(&mut self, seed: &Seed) -> Option<u32> {
        self.state.copy_from_slice(&seed.state);
        self.prescribe(&seed.pose);
        self.history.clear();
        self.factor.begin_state();
        self.evaluate(true);
        let problem = self.problem.clone();
        let (symbolic, n) = (&problem.symbolic, problem.unknowns());
        let matrix = problem.matrix(&self.assembled.tangent);
        self.factorisations += 1;
        // Half the time and memory of double precision, and both are freed at once.
        let mut single = SingleFactor::new(symbolic, n);
        if single.make(matrix, &mut SingleScratch::new(symbolic, n))
            && single.unstable_modes(symbolic) == Some(0)
        {
            return Some(0);
        }
        drop(single);
        // An instability is not left to single precision.
        self.factorisations += 1;
        let is_made = self.factor.factorise_first(matrix);
        is_made.then(|| self.factor.unstable_modes(symbolic)).flatten()
    }
}
