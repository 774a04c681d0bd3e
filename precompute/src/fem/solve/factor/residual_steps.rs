//! Solutions of several columns with a factor of another matrix, as block generalised conjugate residuals.
//!
//! M is the factor at hand: of the tangent at another state, or with the tool at a neighbouring contact point. Each
//! step solves z = M^-1 r for every column, makes w = K z orthonormal to those before, with z alike, and takes for
//! all columns the lengths that leave the smallest residuals (Eisenstat, Elman and Schultz 1983):
//!
//! x += a z,   r -= a w,   a = r . w.
//!
//! The residuals fall with every step, also where the plain correction x += M^-1 r grows; a change of the matrix
//! of low rank, as between two contact points, takes about as many steps as it has rank. The directions can be kept
//! for the next matrix and right-hand side of the same state: their images cost a product each instead of a solve.

use super::{Factor, Matrix, RIGHT_SIDES};
use crate::num::vector::{inner, magnitude};

/// Largest number of steps with a factor.
pub(in crate::fem::solve) const MAX_STEPS: usize = 12;
/// More directions are not kept.
const MAX_KEPT: usize = 36;
/// A direction whose image is left with this share by those before is none.
const DEPENDENT: f64 = 1e-10;

/// The directions of the steps and their orthonormal images.
#[derive(Debug, Default)]
pub(super) struct ResidualSteps {
    directions: Vec<Vec<f64>>,
    images: Vec<Vec<f64>>,
    /// Number of those in use.
    len: usize,
    block: Vec<f64>,
    products: Vec<f64>,
}

impl ResidualSteps {
    pub(super) fn new(unknowns: usize) -> Self {
        let room = || vec![vec![0.0; unknowns]; RIGHT_SIDES * MAX_STEPS];
        let columns = || vec![0.0; RIGHT_SIDES * unknowns];
        Self { directions: room(), images: room(), len: 0, block: columns(), products: columns() }
    }

    /// Keeps no direction.
    pub(super) fn forget(&mut self) {
        self.len = 0;
    }

    /// Improves the solutions `x` of K x = right, at most three columns, by at most `most` steps, until the largest relative
    /// residual is below `target`. Begins with the directions that are kept. Returns the residual and the number of
    /// steps.
    pub(super) fn refine(
        &mut self,
        factor: &mut Factor,
        matrix: Matrix<'_>,
        right: &[f64],
        x: &mut [f64],
        (target, most): (f64, usize),
    ) -> (f64, u32) {
        let mut left = factor.measure(matrix, right, x);
        if left.worst() > target {
            self.take_kept(factor, matrix, x);
            left = factor.left(right);
        }
        for step in 0..most {
            // The comparison is false for NaN.
            if left.worst() <= target || left.worst().is_nan() {
                return (left.worst(), step as u32);
            }
            let n = matrix.pattern.unknowns();
            let mut block = std::mem::take(&mut self.block);
            factor.correct(matrix, &mut block[..x.len()]);
            matrix.pattern.multiply_columns(matrix.values, &block[..x.len()], &mut self.products[..x.len()]);
            for (column, direction) in block[..x.len()].chunks(n).enumerate() {
                self.add(direction, column);
                self.take_last(factor, x);
            }
            self.block = block;
            left = factor.left(right);
        }
        (left.worst(), most as u32)
    }

    /// Makes the images of the kept directions anew and steps along them.
    fn take_kept(&mut self, factor: &mut Factor, matrix: Matrix<'_>, x: &mut [f64]) {
        let kept = std::mem::take(&mut self.len);
        let n = matrix.pattern.unknowns();
        for first in (0..kept.min(MAX_KEPT)).step_by(RIGHT_SIDES) {
            let count = RIGHT_SIDES.min(kept - first);
            let mut block = std::mem::take(&mut self.block);
            for (column, direction) in block.chunks_mut(n).zip(&self.directions[first..first + count]) {
                column.copy_from_slice(direction);
            }
            let columns = &block[..count * n];
            matrix.pattern.multiply_columns(matrix.values, columns, &mut self.products[..count * n]);
            for (column, direction) in columns.chunks(n).enumerate() {
                self.add(direction, column);
                self.take_last(factor, x);
            }
            self.block = block;
        }
    }

    /// Adds a direction whose image is a column of the products, unless it depends on those before.
    fn add(&mut self, direction: &[f64], column: usize) {
        let n = direction.len();
        if self.len == self.directions.len() {
            self.directions.push(vec![0.0; n]);
            self.images.push(vec![0.0; n]);
        }
        let (directions, rest) = self.directions.split_at_mut(self.len);
        let (images, others) = self.images.split_at_mut(self.len);
        let (z, w) = (&mut rest[0], &mut others[0]);
        z.copy_from_slice(direction);
        w.copy_from_slice(&self.products[column * n..(column + 1) * n]);
        let before = magnitude(w);
        for (old_z, old_w) in directions.iter().zip(&*images) {
            let share = inner(w, old_w);
            subtract(w, share, old_w);
            subtract(z, share, old_z);
        }
        let left = magnitude(w);
        // The comparison is false for NaN.
        if left > DEPENDENT * before {
            z.iter_mut().chain(w).for_each(|value| *value /= left);
            self.len += 1;
        } else {
            z.fill(0.0);
            w.fill(0.0);
        }
    }

    /// Steps along the last direction with every column.
    fn take_last(&self, factor: &mut Factor, x: &mut [f64]) {
        if let Some(last) = self.len.checked_sub(1) {
            factor.step(&self.directions[last], &self.images[last], x);
        }
    }
}

/// y -= share x.
fn subtract(y: &mut [f64], share: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y -= share * x;
    }
}
