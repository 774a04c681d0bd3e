//! Sparse symmetric solver: supernodal Cholesky without pivoting, iterative refinement with the true matrix, and a residual
//! that is always checked.
//!
//! A body without pressures in a stable state has a positive definite tangent: LL^T, the fastest, is tried first, and that it
//! exists proves the stability. Otherwise, and for every saddle-point matrix, LDL^T: the signs of D are the inertia, so
//! negative entries beyond one a pressure or multiplier count the unstable modes.
//!
//! The saddle-point matrix of an incompressible body has zeros on the pressure diagonal. Subtracting
//! delta_i = delta V_i / mu there makes it quasi-definite for a stable state, so that LDL^T exists in any order;
//! refinement then removes the effect of delta. Where that fails (measured by the residual, never assumed) delta is
//! raised, and at last an LU with pivoting of the whole matrix is tried.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::ldlt::factor::LdltRegularization;
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::prelude::Solve;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LdltRef, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky, supernodal,
};
use faer::sparse::{SparseColMat, SparseColMatRef, SymbolicSparseColMatRef, Triplet};
use faer::{Conj, Mat, MatMut, Par, Side};

use crate::fem::assembly::Pattern;

/// Regularisations tried, in units of V_i / mu.
const DELTAS: [f64; 3] = [1e-9, 1e-7, 1e-5];
/// How well a system is to be solved, as relative residuals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Accuracy {
    /// Refinement ends here ...
    target: f64,
    /// ... and a route that does not get at least here is given up for the next.
    accepted: f64,
}

/// For a Newton step: what is left is below what the step's own linearisation leaves.
pub(super) const STEP: Accuracy = Accuracy { target: 1e-6, accepted: 1e-6 };
/// For sensitivities: seven digits of W_ijk are asked for, and unstable pressures swallow some. (The condensed tangent alone
/// would not need it: its error is the square.)
pub(super) const SENSITIVITY: Accuracy = Accuracy { target: 1e-11, accepted: 1e-9 };
/// A solve above what was asked for is accepted below this one, if ...
const ACCEPTED_AT_FLOOR: f64 = 1e-6;
/// ... it is no more than this share of max|A| |x|: then it is rounding. Parts of very different stiffness have such
/// solves, where a soft right-hand side turns a stiff block. A singular matrix does not pass: its residual stays near 1.
const FLOOR: f64 = 1e-14;
/// Refinement steps at most; each gains at least four digits when the factor is any good.
const REFINEMENTS: usize = 6;

/// The matrix could not be solved well enough by any route.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SingularMatrix {
    /// Relative residual of the best attempt.
    pub(super) residual: f64,
}

/// Symbolic analysis of one pattern, shared by all threads.
#[derive(Debug)]
pub(super) struct SymbolicFactor {
    symbolic: SymbolicCholesky<usize>,
    /// Place of each pressure unknown's diagonal entry, and its regularisation for delta = 1.
    pressure_diagonal: Vec<(usize, f64)>,
    /// Negative pivots of a stable state: one for each pressure and each multiplier.
    negative_when_stable: usize,
}

/// Factorisation tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Route {
    /// LL^T: positive definite or nothing.
    Positive,
    /// LDL^T with the regularisation of this index into [`DELTAS`].
    Indefinite(usize),
    /// LU with pivoting.
    Pivoted,
}

impl SymbolicFactor {
    /// Analyses `pattern`, whose unknowns already stand in elimination order; `pressure_diagonal` lists
    /// (equation, V_i / mu in scaled units) of every pressure unknown without a block of its own.
    pub(super) fn new(
        pattern: &Pattern,
        pressure_diagonal: &[(usize, f64)],
        negative_when_stable: usize,
    ) -> Self {
        let n = pattern.unknowns();
        // With the order given, faer analyses the upper triangle as it stands whatever side is named.
        let (starts, rows) = pattern.upper_triangle();
        let symbolic = factorize_symbolic_cholesky(
            SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows),
            Side::Upper,
            SymmetricOrdering::Identity,
            // AUTO may fall to the simplicial path, which is slower and as unpivoted.
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        )
        .expect("the pattern is square, sorted and fits in memory");
        let pressure_diagonal = pressure_diagonal
            .iter()
            .map(|&(equation, size)| (pattern.column_starts[equation], size))
            .collect();
        Self { symbolic, pressure_diagonal, negative_when_stable }
    }

    /// The routes in the order they are tried.
    fn routes(&self) -> &'static [Route] {
        const SADDLE: [Route; 4] =
            [Route::Indefinite(0), Route::Indefinite(1), Route::Indefinite(2), Route::Pivoted];
        match (self.negative_when_stable, self.pressure_diagonal.is_empty()) {
            (0, _) => &[Route::Positive, Route::Indefinite(0), Route::Pivoted],
            // Nothing to regularise: a second level would repeat the first.
            (_, true) => &[Route::Indefinite(0), Route::Pivoted],
            (_, false) => &SADDLE,
        }
    }

    /// Floating-point operations of a factorisation over those of one solve: sum n_j^2 / sum 4 n_j over the columns of the
    /// factor. A static measure of what a frozen factor saves, the same on every machine.
    pub(super) fn factor_over_solve(&self) -> f64 {
        let (factor, solve) = self.flops();
        factor / solve
    }

    /// Floating-point operations of a factorisation and of a solve.
    pub(super) fn flops(&self) -> (f64, f64) {
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else { return (1.0, 1.0) };
        let (mut factor, mut solve) = (0.0, 0.0);
        for s in 0..symbolic.n_supernodes() {
            let columns = symbolic.supernode_end()[s] - symbolic.supernode_begin()[s];
            let below = symbolic.supernode(s).pattern().len();
            for column in 0..columns {
                let height = (columns - column + below) as f64;
                factor += height * height;
                solve += 4.0 * height;
            }
        }
        (factor, solve)
    }

    /// Entries of the factor.
    pub(super) fn factor_entries(&self) -> usize {
        self.symbolic.len_val()
    }
}

/// Numeric factor and scratch of one thread; nothing is allocated after the first use.
pub(super) struct Factor {
    values: Vec<f64>,
    scratch: MemBuffer,
    regularised: Vec<f64>,
    right: Vec<f64>,
    residual: Vec<f64>,
    product: Vec<f64>,
    correction: Vec<f64>,
    route: Route,
    pivoted: Option<Box<faer::sparse::linalg::solvers::Lu<usize, f64>>>,
}

impl std::fmt::Debug for Factor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Factor").field("entries", &self.values.len()).field("route", &self.route).finish()
    }
}

impl Factor {
    /// Room for the factor of `symbolic` and three right-hand sides.
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
            right: vec![0.0; n],
            residual: vec![0.0; n],
            product: vec![0.0; pattern.unknowns()],
            correction: vec![0.0; n],
            route: Route::Pivoted,
            pivoted: None,
        }
    }

    /// Factorises `matrix` (lower triangle on `pattern`) by one route.
    fn factorise(
        &mut self,
        symbolic: &SymbolicFactor,
        pattern: &Pattern,
        matrix: &[f64],
        route: Route,
    ) -> bool {
        self.route = route;
        self.pivoted = None;
        if route == Route::Pivoted {
            return self.factorise_pivoted(pattern, matrix);
        }
        self.regularised.copy_from_slice(&matrix[..pattern.entries()]);
        if let Route::Indefinite(level) = route {
            for &(place, size) in &symbolic.pressure_diagonal {
                self.regularised[place] -= DELTAS[level] * size;
            }
        }
        let n = pattern.unknowns();
        let structure =
            SymbolicSparseColMatRef::new_checked(n, n, &pattern.column_starts, None, &pattern.rows);
        let matrix = SparseColMatRef::new(structure, &self.regularised);
        let stack = MemStack::new(&mut self.scratch);
        let values = &mut self.values;
        let factorised = if route == Route::Positive {
            symbolic
                .symbolic
                .factorize_numeric_llt(
                    values,
                    matrix,
                    Side::Lower,
                    LltRegularization::default(),
                    Par::Seq,
                    stack,
                    Default::default(),
                )
                .is_ok()
        } else {
            symbolic
                .symbolic
                .factorize_numeric_ldlt(
                    values,
                    matrix,
                    Side::Lower,
                    LdltRegularization::default(),
                    Par::Seq,
                    stack,
                    Default::default(),
                )
                .is_ok()
        };
        // Values that are not finite show in the residual, which every solve checks.
        factorised
    }

    fn factorise_pivoted(&mut self, pattern: &Pattern, matrix: &[f64]) -> bool {
        let n = pattern.unknowns();
        let mut triplets = Vec::with_capacity(2 * pattern.entries());
        for column in 0..n {
            let span = pattern.column_starts[column]..pattern.column_starts[column + 1];
            for (&row, &value) in pattern.rows[span.clone()].iter().zip(&matrix[span]) {
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

    /// Solves with the present factor, no refinement.
    fn apply(&mut self, symbolic: &SymbolicFactor, n: usize, columns: usize) {
        let rhs = &mut self.correction[..n * columns];
        if let Some(lu) = &self.pivoted {
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
    }

    /// Sets the residuals b - K x of every column and returns the worst relative to its right-hand side.
    fn measure(&mut self, pattern: &Pattern, matrix: &[f64], x: &[f64], columns: usize) -> f64 {
        let n = pattern.unknowns();
        let mut worst = 0.0f64;
        for span in (0..columns).map(|j| j * n..(j + 1) * n) {
            pattern.multiply(matrix, &x[span.clone()], &mut self.product);
            let (mut error, mut size) = (0.0, 0.0);
            for ((r, b), p) in
                self.residual[span.clone()].iter_mut().zip(&self.right[span]).zip(&self.product)
            {
                *r = b - p;
                error += *r * *r;
                size += b * b;
            }
            let relative = if size > 0.0 { (error / size).sqrt() } else { error.sqrt() };
            // `max` would hide a NaN.
            worst = if relative > worst || relative.is_nan() { relative } else { worst };
        }
        worst
    }

    /// Refines `x` against the right-hand sides in `self.right`; returns the worst relative residual.
    fn refine(
        &mut self,
        symbolic: &SymbolicFactor,
        pattern: &Pattern,
        matrix: &[f64],
        x: &mut [f64],
        columns: usize,
        accuracy: Accuracy,
    ) -> f64 {
        let n = pattern.unknowns();
        x.fill(0.0);
        let mut best = f64::INFINITY;
        self.residual[..n * columns].copy_from_slice(&self.right[..n * columns]);
        for _ in 0..=REFINEMENTS {
            self.correction[..n * columns].copy_from_slice(&self.residual[..n * columns]);
            self.apply(symbolic, n, columns);
            for (x, c) in x.iter_mut().zip(&self.correction) {
                *x += c;
            }
            let worst = self.measure(pattern, matrix, x, columns);
            if worst.is_nan() {
                return f64::INFINITY;
            }
            if worst > best {
                // The last correction made it worse: take it back, so that x is what `best` speaks of.
                for (x, c) in x.iter_mut().zip(&self.correction) {
                    *x -= c;
                }
                self.measure(pattern, matrix, x, columns);
                break;
            }
            // Good enough, or no longer gaining a digit a step.
            let stalled = worst > 0.3 * best;
            best = worst;
            if worst <= accuracy.target || stalled {
                break;
            }
        }
        best
    }

    /// Factorises `matrix` by the first route that exists, without a solve that would check it.
    pub(super) fn factorise_first(
        &mut self,
        symbolic: &SymbolicFactor,
        pattern: &Pattern,
        matrix: &[f64],
    ) -> bool {
        symbolic.routes().iter().any(|&route| self.factorise(symbolic, pattern, matrix, route))
    }

    /// Factorises `matrix` and solves for the columns of `right` (column-major, at most [`RIGHT_SIDES`]); refined to the
    /// accuracy asked for. The factor stays for [`Factor::correct`].
    pub(super) fn factorise_and_solve(
        &mut self,
        symbolic: &SymbolicFactor,
        pattern: &Pattern,
        matrix: &[f64],
        right: &[f64],
        x: &mut [f64],
        accuracy: Accuracy,
    ) -> Result<f64, SingularMatrix> {
        let mut best = f64::INFINITY;
        if pattern.unknowns() == 0 {
            return Err(SingularMatrix { residual: best });
        }
        for &route in symbolic.routes() {
            if !self.factorise(symbolic, pattern, matrix, route) {
                continue;
            }
            let residual = self.solve(symbolic, pattern, matrix, right, x, accuracy);
            best = best.min(residual);
            let accepted = residual <= accuracy.accepted
                || residual <= ACCEPTED_AT_FLOOR && residual <= rounding(matrix, x, right);
            if accepted {
                return Ok(residual);
            }
        }
        Err(SingularMatrix { residual: best })
    }

    /// Solves for the columns of `right` with the factor in place, refined; returns the relative residual reached.
    pub(super) fn solve(
        &mut self,
        symbolic: &SymbolicFactor,
        pattern: &Pattern,
        matrix: &[f64],
        right: &[f64],
        x: &mut [f64],
        accuracy: Accuracy,
    ) -> f64 {
        self.right[..right.len()].copy_from_slice(right);
        self.refine(symbolic, pattern, matrix, x, right.len() / pattern.unknowns(), accuracy)
    }

    /// Residuals b - K x of the last checked solve, column after column.
    pub(super) fn residuals(&self) -> &[f64] {
        &self.residual
    }

    /// Unstable modes of the matrix factorised last: negative pivots beyond those of a stable state. `None` after an LU, which
    /// tells no inertia.
    pub(super) fn unstable_modes(&self, symbolic: &SymbolicFactor) -> Option<u32> {
        match self.route {
            Route::Positive => Some(0),
            Route::Pivoted => None,
            Route::Indefinite(_) => {
                let SymbolicCholeskyRaw::Supernodal(analysis) = symbolic.symbolic.raw() else { return None };
                let factor = supernodal::SupernodalLdltRef::new(analysis, &self.values);
                let negative = (0..analysis.n_supernodes())
                    .map(|s| {
                        let block = factor.supernode(s).val();
                        (0..block.ncols()).filter(|&j| block[(j, j)] < 0.0).count()
                    })
                    .sum::<usize>();
                Some(negative.abs_diff(symbolic.negative_when_stable) as u32)
            }
        }
    }

    /// x = factor^-1 right with the factor in place, one column, neither refined nor checked: for steps whose success is
    /// judged by the residual of the equilibrium itself.
    pub(super) fn correct(&mut self, symbolic: &SymbolicFactor, right: &[f64], x: &mut [f64]) {
        self.correction[..right.len()].copy_from_slice(right);
        self.apply(symbolic, right.len(), 1);
        x.copy_from_slice(&self.correction[..right.len()]);
    }
}

/// Relative residual that rounding alone may leave.
fn rounding(matrix: &[f64], x: &[f64], right: &[f64]) -> f64 {
    let largest = matrix.iter().fold(0.0f64, |m, a| m.max(a.abs()));
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    FLOOR * largest * norm(x) / norm(right)
}

/// Right-hand sides that can be solved for at once: one per axis of the active node.
pub(super) const RIGHT_SIDES: usize = 3;

#[cfg(test)]
mod tests;
