//! Sparse symmetric solver: supernodal Cholesky without pivoting, iterative refinement with the unregularised
//! matrix, and a check of every residual.
//!
//! A body without pressures in a stable state has a positive definite tangent. LL^T is then the fastest
//! factorisation and is tried first; its existence proves the stability. Otherwise, and for every
//! saddle-point matrix, LDL^T is used. The signs of D give the inertia: the number of negative entries minus
//! one per pressure or multiplier is the number of unstable modes.
//!
//! The saddle-point matrix of an incompressible body has zeros on the pressure diagonal. Subtracting delta_i
//! = delta V_i / mu from them makes the matrix of a stable state quasi-definite, so that LDL^T exists for any
//! order. Refinement then removes the effect of delta. If the measured residual shows that this fails (a part
//! of the body is about a million times softer than the rest), an LU factorisation with pivoting is used.

mod held_by_loads;
mod packed;
mod residual_steps;
mod residuals;
mod single;
mod symbolic;
mod two_level;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::ldlt::factor::LdltRegularization;
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::prelude::Solve;
use faer::sparse::linalg::cholesky::{LdltRef, LltRef};
use faer::sparse::{SparseColMat, SparseColMatRef, SymbolicSparseColMatRef, Triplet};
use faer::{Conj, Mat, MatMut, Par, Side};

use held_by_loads::HeldByLoads;
pub(super) use held_by_loads::held_stiffness;
pub(super) use packed::PackedFactor;
pub(super) use residual_steps::MAX_STEPS;
use residual_steps::ResidualSteps;
use single::{SingleFactor, SingleScratch};
pub(super) use symbolic::SymbolicFactor;
use symbolic::{Route, negative_pivots};
pub(super) use two_level::NearEquations;
use two_level::TwoLevel;

use super::Problem;

use crate::fem::assembly::Pattern;
use crate::num::vector::magnitude;

/// Regularisation delta, in units of `pressure_share` V_i / mu.
const DELTA: f64 = 1e-9;
/// Required accuracy of a solution, as relative residuals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Accuracy {
    /// Refinement ends below this residual.
    target: f64,
    /// A factorisation that does not reach this residual is replaced by the next one.
    accepted: f64,
}

impl Accuracy {
    pub(super) const fn new(target: f64, accepted: f64) -> Self {
        Self { target, accepted }
    }

    /// Whether a solution with this residual serves.
    pub(super) fn accepts(self, residual: f64) -> bool {
        residual <= self.accepted
    }
}

/// For a Newton step; the error is below the linearisation error of the step.
pub(super) const STEP_ACCURACY: Accuracy = Accuracy { target: 1e-6, accepted: 1e-6 };
/// For sensitivities: W_ijk needs seven digits, and unstable pressures cost some digits. (The condensed
/// tangent would need less, because its error is the square of theirs.)
pub(super) const SENSITIVITY_ACCURACY: Accuracy = Accuracy { target: 1e-11, accepted: 1e-9 };
/// Largest relative residual of a solution that is accepted because it has reached the rounding floor, see
/// [`FLOOR`].
const ACCEPTED_AT_FLOOR: f64 = 1e-6;
/// Rounding floor: a residual of at most this share of max|A| |x|. A body with parts of very different
/// stiffness has such solutions if a soft right-hand side rotates a stiff block. A singular matrix is not
/// accepted, because its relative residual stays near 1.
const FLOOR: f64 = 1e-14;
/// Maximum number of refinement steps; each gains at least four digits with a good factor.
const REFINEMENTS: usize = 6;
/// Default of [`Factor::max_steps_without`].
const MAX_STEPS_WITHOUT: usize = 30;

/// A symmetric matrix: the values of its lower triangle on a pattern, and the analysis of the pattern.
#[derive(Clone, Copy)]
pub(super) struct Matrix<'a> {
    pub(super) symbolic: &'a SymbolicFactor,
    pub(super) pattern: &'a Pattern,
    pub(super) values: &'a [f64],
    /// The problem and the state of a tangent that may be solved without a factor.
    pub(super) at: Option<(&'a Problem, &'a [f64])>,
}

/// Error: no factorisation solved the matrix to the required accuracy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SingularMatrix {
    /// Relative residual of the best attempt.
    pub(super) residual: f64,
}

/// Numeric factor and scratch memory of one thread; no allocation after the first use.
pub(super) struct Factor {
    values: Vec<f64>,
    scratch: MemBuffer,
    regularised: Vec<f64>,
    unknowns: usize,
    residual: Vec<f64>,
    correction: Vec<f64>,
    route: Route,
    pivoted: Option<Box<faer::sparse::linalg::solvers::Lu<usize, f64>>>,
    /// Holds a node that the factorised matrix leaves free.
    held: Option<Box<HeldByLoads>>,
    residual_steps: ResidualSteps,
    two_level: Option<Box<TwoLevel>>,
    /// Whether the preconditioner is that of a tangent of the present state.
    follows_tangent: bool,
    /// Whether residual steps have failed in the present state.
    stagnates: bool,
    /// Largest number of residual steps with a preconditioner; beyond it the matrix is factorised.
    pub(super) max_steps_without: usize,
    /// Whether the tangent of a large body is not factorised where the steps with its preconditioner fail.
    pub(super) gives_up: bool,
}

impl std::fmt::Debug for Factor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Factor").field("entries", &self.values.len()).field("route", &self.route).finish()
    }
}

impl Factor {
    /// Scratch memory for the factor of `symbolic` and three right-hand sides.
    pub(super) fn new(symbolic: &SymbolicFactor, pattern: &Pattern) -> Self {
        let analysis = &symbolic.symbolic;
        let scratch = analysis
            .factorize_numeric_ldlt_scratch::<f64>(Par::Seq, Default::default())
            .or(analysis.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default()))
            .or(analysis.solve_in_place_scratch::<f64>(RIGHT_SIDES, Par::Seq));
        let n = RIGHT_SIDES * pattern.unknowns();
        Self {
            values: vec![0.0; analysis.len_val()],
            scratch: MemBuffer::new(scratch),
            regularised: vec![0.0; pattern.entries()],
            residual: vec![0.0; n],
            unknowns: pattern.unknowns(),
            correction: vec![0.0; n],
            route: Route::Pivoted,
            pivoted: None,
            held: None,
            residual_steps: ResidualSteps::new(pattern.unknowns()),
            two_level: None,
            follows_tangent: false,
            stagnates: false,
            max_steps_without: MAX_STEPS_WITHOUT,
            gives_up: false,
        }
    }

    /// Becomes a copy of another factor of the same analysis; whether that has one to copy.
    pub(super) fn copy_from(&mut self, other: &Self) -> bool {
        if matches!(other.route, Route::Pivoted | Route::TwoLevel) {
            return false;
        }
        (self.route, self.pivoted, self.held) = (other.route, None, None);
        self.values.copy_from_slice(&other.values);
        true
    }

    /// Holds three equations at zero from now on, by the solutions Y for unit loads on them; whether these can.
    pub(super) fn hold(&mut self, equations: [usize; 3], unit_loads: &[f64]) -> bool {
        self.held = HeldByLoads::new(equations, unit_loads).map(Box::new);
        self.held.is_some()
    }

    /// Factorises a matrix by one kind of factorisation. Non-finite values show in the residual, which every
    /// solve checks.
    fn factorise(&mut self, matrix: Matrix<'_>, route: Route) -> bool {
        self.route = route;
        (self.pivoted, self.held) = (None, None);
        if route == Route::Pivoted {
            return self.factorise_pivoted(matrix);
        }
        let Matrix { symbolic, pattern, values, .. } = matrix;
        self.regularised.copy_from_slice(&values[..pattern.entries()]);
        if route == Route::Indefinite {
            for &(place, size) in &symbolic.pressure_diagonal {
                self.regularised[place] -= DELTA * size;
            }
        }
        let n = pattern.unknowns();
        let structure =
            SymbolicSparseColMatRef::new_checked(n, n, &pattern.column_starts, None, &pattern.rows);
        let matrix = SparseColMatRef::new(structure, &self.regularised);
        let stack = MemStack::new(&mut self.scratch);
        let (analysis, factor, parallel) = (&symbolic.symbolic, &mut self.values, Par::Seq);
        if route == Route::Positive {
            let (shift, options) = (LltRegularization::default(), Default::default());
            analysis
                .factorize_numeric_llt(factor, matrix, Side::Lower, shift, parallel, stack, options)
                .is_ok()
        } else {
            let (shift, options) = (LdltRegularization::default(), Default::default());
            analysis
                .factorize_numeric_ldlt(factor, matrix, Side::Lower, shift, parallel, stack, options)
                .is_ok()
        }
    }

    fn factorise_pivoted(&mut self, Matrix { pattern, values, .. }: Matrix<'_>) -> bool {
        let n = pattern.unknowns();
        let mut triplets = Vec::with_capacity(2 * pattern.entries());
        for column in 0..n {
            let span = pattern.column_starts[column]..pattern.column_starts[column + 1];
            for (&row, &value) in pattern.rows[span.clone()].iter().zip(&values[span]) {
                triplets.push(Triplet::new(row, column, value));
                if row != column {
                    triplets.push(Triplet::new(column, row, value));
                }
            }
        }
        self.pivoted = SparseColMat::try_new_from_triplets(n, n, &triplets)
            .ok()
            .and_then(|full| full.sp_lu().ok())
            .map(Box::new);
        self.pivoted.is_some()
    }

    /// Solves for the first `length` numbers of `self.correction` (columns of `n`) with the current factor,
    /// without refinement.
    fn apply(&mut self, matrix: Matrix<'_>, length: usize) {
        let (symbolic, n) = (matrix.symbolic, matrix.pattern.unknowns());
        let columns = length / n;
        let rhs = &mut self.correction[..length];
        if let Some(two_level) = self.two_level.as_mut().filter(|_| self.route == Route::TwoLevel) {
            two_level.apply(matrix, rhs);
        } else if let Some(lu) = &self.pivoted {
            let solved = lu.solve(Mat::from_fn(n, columns, |i, j| rhs[j * n + i]));
            for j in 0..columns {
                for i in 0..n {
                    rhs[j * n + i] = solved[(i, j)];
                }
            }
        } else {
            let rhs = MatMut::from_column_major_slice_mut(rhs, n, columns);
            let stack = MemStack::new(&mut self.scratch);
            if self.route == Route::Positive {
                let factor = LltRef::new(&symbolic.symbolic, &self.values);
                factor.solve_in_place_with_conj(Conj::No, rhs, Par::Seq, stack);
            } else {
                let factor = LdltRef::new(&symbolic.symbolic, &self.values);
                factor.solve_in_place_with_conj(Conj::No, rhs, Par::Seq, stack);
            }
        }
        if let Some(held) = &self.held {
            held.hold(&mut self.correction[..length]);
        }
    }

    /// Whether there is a factor to solve with.
    pub(super) fn is_ready(&self) -> bool {
        self.route != Route::Pivoted || self.pivoted.is_some()
    }

    /// Solves for the columns of `right` with the current factor and refines; returns the largest relative
    /// residual.
    pub(super) fn solve(
        &mut self,
        matrix: Matrix<'_>,
        right: &[f64],
        x: &mut [f64],
        accuracy: Accuracy,
    ) -> f64 {
        x.fill(0.0);
        if self.route == Route::TwoLevel {
            return self.refine(matrix, right, x, (accuracy.target, self.max_steps_without)).0;
        }
        let mut best = f64::INFINITY;
        self.residual[..right.len()].copy_from_slice(right);
        for _ in 0..=REFINEMENTS {
            self.correction[..right.len()].copy_from_slice(&self.residual[..right.len()]);
            self.apply(matrix, right.len());
            for (x, c) in x.iter_mut().zip(&self.correction) {
                *x += c;
            }
            let worst = self.measure(matrix, right, x).worst();
            if worst.is_nan() {
                return f64::INFINITY;
            }
            if worst > best {
                // The last correction increased the residual: undo it, so that `best` is the residual of x.
                for (x, c) in x.iter_mut().zip(&self.correction) {
                    *x -= c;
                }
                self.measure(matrix, right, x);
                break;
            }
            // Refinement ends at the target, or if a step leaves more than 0.3 of the residual.
            let stalled = worst > 0.3 * best;
            best = worst;
            if worst <= accuracy.target || stalled {
                break;
            }
        }
        best
    }

    /// Takes the preconditioner of a large body to the matrix and its state; whether it has one that serves.
    fn precondition(&mut self, matrix: Matrix<'_>) -> bool {
        let Some((problem, state)) = matrix.at.filter(|(problem, _)| problem.is_large() && !self.stagnates)
        else {
            return false;
        };
        if self.two_level.is_none() {
            self.two_level = TwoLevel::new(problem).map(Box::new);
        }
        let Some(two_level) = &mut self.two_level else { return false };
        let serves = self.route == Route::TwoLevel && self.follows_tangent
            || two_level.refresh(matrix.values, problem, state)
                && two_level.unstable_near().is_none_or(|modes| modes == 0);
        self.follows_tangent = serves;
        if serves {
            self.route = Route::TwoLevel;
            (self.pivoted, self.held) = (None, None);
        }
        serves
    }

    /// Whether the last solve made residual steps without a factor of its matrix.
    #[cfg(test)]
    pub(super) fn steps_without(&self) -> bool {
        self.route == Route::TwoLevel
    }

    #[cfg(test)]
    pub(super) fn two_level(&mut self) -> &mut TwoLevel {
        self.two_level.as_mut().expect("a large body has a preconditioner")
    }

    /// Factorises `matrix` by the first factorisation that exists, without checking a solution. The tangent of a large
    /// body gets a preconditioner instead.
    pub(super) fn factorise_first(&mut self, matrix: Matrix<'_>) -> bool {
        self.precondition(matrix)
            || matrix.symbolic.routes().iter().any(|&route| self.factorise(matrix, route))
    }

    /// Factorises `matrix` and solves for the columns of `right` (column-major, at most [`RIGHT_SIDES`]),
    /// refined to the required accuracy. The factor remains for further solves. That of a large body is a
    /// preconditioner, and the solution is improved from `x`.
    pub(super) fn factorise_and_solve(
        &mut self,
        matrix: Matrix<'_>,
        right: &[f64],
        x: &mut [f64],
        accuracy: Accuracy,
    ) -> Result<f64, SingularMatrix> {
        let mut best = f64::INFINITY;
        if matrix.pattern.unknowns() == 0 {
            return Err(SingularMatrix { residual: best });
        }
        if self.precondition(matrix) {
            let most = if self.gives_up { MAX_STEPS } else { self.max_steps_without };
            self.refine(matrix, right, x, (accuracy.target, most));
            // That of the steps is not measured.
            let residual = self.measure(matrix, right, x).worst();
            if accuracy.accepts(residual) {
                return Ok(residual);
            }
            self.stagnates = true;
        }
        if self.gives_up && matrix.at.is_some_and(|(problem, _)| problem.is_large()) {
            return Err(SingularMatrix { residual: best });
        }
        for &route in matrix.symbolic.routes() {
            if !self.factorise(matrix, route) {
                continue;
            }
            let residual = self.solve(matrix, right, x, accuracy);
            best = best.min(residual);
            let accepted = accuracy.accepts(residual)
                || residual <= ACCEPTED_AT_FLOOR && residual <= rounding(matrix.values, x, right);
            if accepted {
                return Ok(residual);
            }
        }
        Err(SingularMatrix { residual: best })
    }

    /// Number of unstable modes of the last factorised matrix: negative pivots minus those of a stable state.
    /// `None` after LU or without a factor, which does not give the inertia.
    pub(super) fn unstable_modes(&self, symbolic: &SymbolicFactor) -> Option<u32> {
        match self.route {
            Route::Positive => Some(0),
            Route::Pivoted | Route::TwoLevel => None,
            Route::Indefinite => {
                let negative = negative_pivots(symbolic, &self.values)?;
                Some(negative.abs_diff(symbolic.negative_when_stable) as u32)
            }
        }
    }

    /// x = factor^-1 right with the current factor, one column, without refinement and check. For steps that
    /// the residual of the equilibrium checks.
    pub(super) fn solve_unrefined(&mut self, matrix: Matrix<'_>, right: &[f64], x: &mut [f64]) {
        if right.is_empty() {
            return;
        }
        self.correction[..right.len()].copy_from_slice(right);
        self.apply(matrix, right.len());
        x.copy_from_slice(&self.correction[..right.len()]);
    }
}

/// Largest relative residual that rounding alone can cause.
fn rounding(matrix: &[f64], x: &[f64], right: &[f64]) -> f64 {
    let largest = matrix.iter().fold(0.0f64, |m, a| m.max(a.abs()));
    FLOOR * largest * magnitude(x) / magnitude(right)
}

/// Maximum number of simultaneous right-hand sides: one per axis of the active node.
pub(super) const RIGHT_SIDES: usize = 3;

#[cfg(test)]
mod tests;
