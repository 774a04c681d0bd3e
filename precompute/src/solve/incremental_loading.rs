//! Incremental loading: from a solved configuration to a new position of the active node.

use super::{Configuration, Seed, SolveFailure, Solver};

/// Step control.
#[derive(Debug, Clone, Copy)]
pub struct LoadingOptions {
    /// The step may be halved this often before the transition is given up.
    pub max_halvings: u32,
}

impl Default for LoadingOptions {
    fn default() -> Self {
        Self { max_halvings: 5 }
    }
}

impl Solver {
    /// Transition from `from` to `target_m` (the paper's C -> C').
    ///
    /// The whole step is tried first, with the tangent predictor state + X dd as the guess (measured: one 5 mm step
    /// takes 3 iterations where five 1 mm increments take 15 to 20); a step that fails is halved, a step that
    /// succeeds is followed by the largest that is left.
    /// Deviation from the paper: it splits every transition into M equal increments without a predictor.
    pub fn advance(&mut self, from: &Seed, target_m: [f64; 3]) -> Result<Configuration, SolveFailure> {
        let (mut done, mut step) = (0.0, 1.0);
        let (mut halvings, mut iterations, mut increments) = (0, 0, 0);
        let mut here: Option<Configuration> = None;
        loop {
            let seed = here.as_ref().map_or(from, |c| &c.seed);
            let last = done + step >= 1.0;
            let position = if last {
                target_m
            } else {
                std::array::from_fn(|i| {
                    from.displacement_m[i] + (done + step) * (target_m[i] - from.displacement_m[i])
                })
            };
            match self.solve_at(position, predicted(seed, position)) {
                Ok(mut configuration) => {
                    iterations += configuration.iterations;
                    increments += 1;
                    done += step;
                    if last {
                        configuration.iterations = iterations;
                        configuration.increments = increments;
                        return Ok(configuration);
                    }
                    here = Some(configuration);
                    step = (2.0 * step).min(1.0 - done);
                }
                Err(failure) => {
                    iterations += failure.iterations;
                    halvings += 1;
                    if halvings > self.loading.max_halvings {
                        return Err(SolveFailure { iterations, ..failure });
                    }
                    step *= 0.5;
                }
            }
        }
    }
}

/// First-order guess of the state at `position_m`.
fn predicted(seed: &Seed, position_m: [f64; 3]) -> Vec<f64> {
    let mut state = seed.state.clone();
    for (axis, column) in seed.sensitivity.iter().enumerate() {
        let change = position_m[axis] - seed.displacement_m[axis];
        if change != 0.0 {
            for (value, slope) in state.iter_mut().zip(column) {
                *value += change * slope;
            }
        }
    }
    state
}
