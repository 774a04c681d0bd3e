//! Steps with a frozen factor, accelerated by Broyden's rank-one updates.
//!
//! A factorisation costs as much as dozens of solves. The old factor is therefore worth reusing while the
//! residual decreases fast. Broyden's (good) update approximates the change of the tangent from the steps.
//! With the stored steps s_0 .. s_k it needs one solve and k inner products per step (Kelley 1995, section
//! 7.3):
//!
//! z = -K_0^-1 r;   for j < k: z += s_{j+1} (s_j . z) / (s_j . s_j);
//! s_{k+1} = z / (1 - (s_k . z) / (s_k . s_k)).

use crate::num::vector::inner;

/// Maximum number of stored steps; a longer sequence would not pay.
pub(super) const MAX_STORED_STEPS: usize = 10;

/// The steps since the last factorisation.
#[derive(Debug)]
pub(super) struct StepHistory {
    steps: Vec<Vec<f64>>,
    squares: [f64; MAX_STORED_STEPS],
    len: usize,
}

impl StepHistory {
    pub(super) fn new(unknowns: usize) -> Self {
        Self { steps: vec![vec![0.0; unknowns]; MAX_STORED_STEPS], squares: [0.0; MAX_STORED_STEPS], len: 0 }
    }

    /// Removes all steps, for a new factor.
    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    pub(super) fn is_full(&self) -> bool {
        self.len == MAX_STORED_STEPS
    }

    /// Stores an accepted full step.
    pub(super) fn push(&mut self, step: &[f64]) {
        if self.len < MAX_STORED_STEPS {
            self.steps[self.len].copy_from_slice(step);
            self.squares[self.len] = inner(step, step);
            self.len += 1;
        }
    }

    /// Converts z = -K_0^-1 r to the next step. Returns false if the update is singular.
    pub(super) fn apply_broyden(&self, z: &mut [f64]) -> bool {
        let Some(last) = self.len.checked_sub(1) else { return true };
        for j in 0..last {
            let share = inner(&self.steps[j], z) / self.squares[j];
            for (z, s) in z.iter_mut().zip(&self.steps[j + 1]) {
                *z += share * s;
            }
        }
        let denominator = 1.0 - inner(&self.steps[last], z) / self.squares[last];
        if denominator.is_nan() || denominator.abs() <= 1e-3 {
            return false;
        }
        for z in z {
            *z /= denominator;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Solves A x = b with the inverse of A's diagonal as the frozen factor.
    #[test]
    fn broyden_solves_a_linear_system_that_plain_iteration_does_not() {
        let a = [[2.0, 1.4, 0.3], [1.4, 2.5, -1.2], [0.3, -1.2, 1.5]];
        let residual = |x: &[f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| a[i].iter().zip(x).map(|(a, x)| a * x).sum::<f64>() - 1.0)
        };
        let solve = |accelerated: bool| {
            let (mut x, mut history) = ([0.0; 3], StepHistory::new(3));
            for _ in 0..MAX_STORED_STEPS {
                let r = residual(&x);
                let mut z: [f64; 3] = std::array::from_fn(|i| -r[i] / a[i][i]);
                if accelerated && !history.apply_broyden(&mut z) {
                    break;
                }
                history.push(&z);
                x = std::array::from_fn(|i| x[i] + z[i]);
            }
            residual(&x).iter().map(|r| r * r).sum::<f64>().sqrt()
        };
        assert!(solve(true) < 1e-10, "{:e}", solve(true));
        assert!(solve(false) > 1e-2, "{:e}", solve(false));
    }
}
