//! Refinement of the sensitivities with a factor of another matrix, as generalised conjugate residuals.
//!
//! M is the factor at hand: of the tangent at another state, or with the tool at a neighbouring contact point.
//! Each step solves z = M^-1 r, makes w = K z orthogonal to those of the steps before, with z alike, and takes
//! the length that leaves the smallest residual (Eisenstat, Elman and Schultz 1983):
//!
//! x += a z,   r -= a w,   a = (r . w) / (w . w).
//!
//! The residual falls with every step, also where the plain correction x += M^-1 r grows; a change of the matrix
//! of low rank, as between two contact points, takes about as many steps as it has rank.

use super::factor::{Factor, Matrix, RIGHT_SIDES};
use crate::num::vector::inner;

/// Largest number of steps.
pub(super) const MAX_STEPS: usize = 12;

/// The directions of the steps and their images, of all columns.
#[derive(Debug)]
pub(super) struct ResidualSteps {
    directions: Vec<Vec<f64>>,
    images: Vec<Vec<f64>>,
    /// w . w of each step and column.
    squares: [[f64; RIGHT_SIDES]; MAX_STEPS],
}

impl ResidualSteps {
    pub(super) fn new(unknowns: usize) -> Self {
        let room = || vec![vec![0.0; RIGHT_SIDES * unknowns]; MAX_STEPS];
        Self { directions: room(), images: room(), squares: [[0.0; RIGHT_SIDES]; MAX_STEPS] }
    }

    /// Improves the solutions `x` of K x = right, at most three columns, by at most `most` steps, until the largest relative residual is
    /// below `target`. Returns it and the number of steps.
    pub(super) fn refine(
        &mut self,
        factor: &mut Factor,
        matrix: Matrix<'_>,
        right: &[f64],
        x: &mut [f64],
        (target, most): (f64, usize),
    ) -> (f64, u32) {
        let n = matrix.pattern.unknowns();
        let mut worst = factor.measure(matrix, right, x);
        for step in 0..most.min(MAX_STEPS) {
            // The comparison is false for NaN.
            if worst <= target || worst.is_nan() {
                return (worst, step as u32);
            }
            let (before, rest) = self.directions.split_at_mut(step);
            let (images, others) = self.images.split_at_mut(step);
            let (direction, image) = (&mut rest[0][..x.len()], &mut others[0][..x.len()]);
            factor.correct(matrix, direction);
            for ((z, w), column) in direction.chunks_mut(n).zip(image.chunks_mut(n)).zip(0..) {
                matrix.pattern.multiply(matrix.values, z, w);
                for ((old_z, old_w), squares) in before.iter().zip(images.iter()).zip(&self.squares) {
                    let span = column * n..(column + 1) * n;
                    let share = inner(w, &old_w[span.clone()]) / squares[column];
                    subtract(w, share, &old_w[span.clone()]);
                    subtract(z, share, &old_z[span]);
                }
                // A column that is solved exactly has no direction left.
                self.squares[step][column] = inner(w, w).max(f64::MIN_POSITIVE);
            }
            worst = factor.step(right, (direction, image, &self.squares[step]), x);
        }
        (worst, most.min(MAX_STEPS) as u32)
    }
}

/// y -= share x.
fn subtract(y: &mut [f64], share: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y -= share * x;
    }
}
