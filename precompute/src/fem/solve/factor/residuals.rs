//! Residuals of solutions, and the steps that reduce them.

use super::symbolic::Route;
use super::{Factor, Matrix, RIGHT_SIDES};
use crate::num::vector::{inner, magnitude};

/// Relative residuals of the columns.
#[derive(Debug, Clone, Copy)]
pub(in crate::fem::solve) struct Left {
    relative: [f64; RIGHT_SIDES],
}

impl Left {
    /// The largest one, or NaN.
    pub(in crate::fem::solve) fn worst(&self) -> f64 {
        // `max` would ignore a NaN.
        self.relative.iter().fold(0.0, |worst, &r| if r > worst || r.is_nan() { r } else { worst })
    }
}

impl Factor {
    /// Computes the residuals b - K x of all columns of `right`.
    pub(in crate::fem::solve) fn measure(&mut self, matrix: Matrix<'_>, right: &[f64], x: &[f64]) -> Left {
        let residual = &mut self.residual[..right.len()];
        matrix.pattern.multiply_columns(matrix.values, x, residual);
        residual.iter_mut().zip(right).for_each(|(r, b)| *r = b - *r);
        self.left(right)
    }

    /// The residuals relative to their right-hand sides.
    pub(in crate::fem::solve) fn left(&self, right: &[f64]) -> Left {
        let n = self.unknowns;
        let mut left = Left { relative: [0.0; RIGHT_SIDES] };
        for ((b, r), relative) in right.chunks(n).zip(self.residual.chunks(n)).zip(&mut left.relative) {
            let (error, size) = (magnitude(r), magnitude(b));
            *relative = if size > 0.0 { error / size } else { error };
        }
        left
    }

    /// x = factor^-1 r for the residuals of the last [`Factor::measure`], or of the last [`Factor::step`].
    pub(in crate::fem::solve) fn correct(&mut self, matrix: Matrix<'_>, x: &mut [f64]) {
        self.correction[..x.len()].copy_from_slice(&self.residual[..x.len()]);
        self.apply(matrix, x.len());
        x.copy_from_slice(&self.correction[..x.len()]);
    }

    /// Adds to every column of `x` the multiple of a direction that leaves the smallest residual; `image` is K times the
    /// direction and has the norm 1.
    pub(in crate::fem::solve) fn step(&mut self, direction: &[f64], image: &[f64], x: &mut [f64]) {
        let n = direction.len();
        for (x, residual) in x.chunks_mut(n).zip(self.residual.chunks_mut(n)) {
            let share = inner(residual, image);
            for ((r, w), (x, z)) in residual.iter_mut().zip(image).zip(x.iter_mut().zip(direction)) {
                *r -= share * w;
                *x += share * z;
            }
        }
    }

    /// Improves the solutions `x` of K x = right by residual steps, see `ResidualSteps::refine`.
    pub(in crate::fem::solve) fn refine(
        &mut self,
        matrix: Matrix<'_>,
        right: &[f64],
        x: &mut [f64],
        goal: (f64, usize),
    ) -> (f64, u32) {
        let mut steps = std::mem::take(&mut self.residual_steps);
        if self.route != Route::TwoLevel {
            steps.forget();
        }
        let reached = steps.refine(self, matrix, right, x, goal);
        self.residual_steps = steps;
        reached
    }

    /// Begins a new state: a preconditioner follows the next tangent, and no direction of the last state is kept.
    pub(in crate::fem::solve) fn begin_state(&mut self) {
        (self.follows_tangent, self.stagnates) = (false, false);
        self.residual_steps.forget();
    }

    /// The preconditioner follows the tangent of the next solve.
    pub(in crate::fem::solve) fn follow_next_tangent(&mut self) {
        self.follows_tangent = false;
    }

    /// Residuals b - K x of the last checked solve, column after column.
    pub(in crate::fem::solve) fn residuals(&self) -> &[f64] {
        &self.residual
    }
}
