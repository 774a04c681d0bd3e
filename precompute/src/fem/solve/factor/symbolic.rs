//! Symbolic analysis: structure and cost of the factor, and the order of the factorisations that are tried.

use faer::Side;
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky, supernodal,
};
use faer::traits::RealField;

use crate::fem::assembly::Pattern;

/// Symbolic analysis of one pattern, shared by all threads.
#[derive(Debug)]
pub(in crate::fem::solve) struct SymbolicFactor {
    pub(super) symbolic: SymbolicCholesky<usize>,
    /// Position of each pressure unknown's diagonal entry, and its regularisation for delta = 1.
    pub(super) pressure_diagonal: Vec<(usize, f64)>,
    /// Number of negative pivots of a stable state: one for each pressure and each multiplier.
    pub(super) negative_when_stable: usize,
    /// Numbers of floating-point operations of a factorisation and of a solve.
    flops: (f64, f64),
}

/// Kind of factorisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Route {
    /// LL^T; exists only for a positive definite matrix.
    Positive,
    /// LDL^T with the regularisation [`super::DELTA`].
    Indefinite,
    /// LU with pivoting.
    Pivoted,
    /// None: residual steps with the preconditioner of `two_level`.
    TwoLevel,
}

impl SymbolicFactor {
    /// Analyses `pattern`, whose unknowns are in elimination order. `pressure_diagonal` lists (equation, V_i
    /// / mu in scaled units) of every pressure unknown without a block.
    pub(in crate::fem::solve) fn new(
        pattern: &Pattern,
        pressure_diagonal: &[(usize, f64)],
        negative_when_stable: usize,
    ) -> Self {
        let n = pattern.unknowns();
        // With a given order, faer analyses the upper triangle as it is, independent of the named side.
        let (starts, rows) = pattern.upper_triangle();
        let symbolic = factorize_symbolic_cholesky(
            SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows),
            Side::Upper,
            SymmetricOrdering::Identity,
            // AUTO can select the simplicial method, which is slower and has no pivoting either.
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
        let flops = flops(&symbolic);
        Self { symbolic, pressure_diagonal, negative_when_stable, flops }
    }

    /// The factorisations in the order of the attempts.
    pub(super) fn routes(&self) -> &'static [Route] {
        match self.negative_when_stable {
            0 => &[Route::Positive, Route::Indefinite],
            _ => &[Route::Indefinite, Route::Pivoted],
        }
    }

    /// Ratio of the floating-point operations of a factorisation to those of a solve: sum n_j^2 / sum 4 n_j
    /// over the columns of the factor. It estimates the saving of a frozen factor and is the same on every
    /// machine.
    pub(in crate::fem::solve) fn factor_over_solve(&self) -> f64 {
        let (factor, solve) = self.flops;
        factor / solve
    }

    /// Numbers of floating-point operations of a factorisation and of a solve.
    pub(in crate::fem::solve) fn flops(&self) -> (f64, f64) {
        self.flops
    }

    /// Number of entries of the factor.
    pub(in crate::fem::solve) fn factor_entries(&self) -> usize {
        self.symbolic.len_val()
    }
}

/// Number of negative pivots of an LDL^T factor of this analysis.
pub(super) fn negative_pivots<T: RealField>(symbolic: &SymbolicFactor, values: &[T]) -> Option<usize> {
    let SymbolicCholeskyRaw::Supernodal(analysis) = symbolic.symbolic.raw() else { return None };
    let factor = supernodal::SupernodalLdltRef::new(analysis, values);
    let count = (0..analysis.n_supernodes()).map(|s| {
        let block = factor.supernode(s).val();
        (0..block.ncols()).filter(|&j| block[(j, j)] < T::zero_impl()).count()
    });
    Some(count.sum())
}

/// Numbers of floating-point operations of a factorisation and of a solve.
fn flops(symbolic: &SymbolicCholesky<usize>) -> (f64, f64) {
    let SymbolicCholeskyRaw::Supernodal(symbolic) = symbolic.raw() else { return (1.0, 1.0) };
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
