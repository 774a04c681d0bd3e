//! Weights of the radial basis functions (paper, Eq. 12).

use faer::prelude::Solve;
use faer::{Mat, Side};
use palpate_core::RBF_LANES;
use thiserror::Error;

use super::Centre;
use super::rbf_iterative::solve_iteratively;
use crate::num::parallel::ThreadError;

/// The kernel phi(r), r in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// phi = r.
    Linear,
    /// phi = r^3.
    Cubic,
}

impl Kernel {
    /// phi of the distance between two positions.
    fn between(self, a: [f64; 3], b: [f64; 3]) -> f64 {
        let squared: f64 = a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum();
        self.value(squared.sqrt())
    }

    /// phi(r).
    #[inline]
    pub(crate) fn value(self, r: f64) -> f64 {
        match self {
            Self::Linear => r,
            Self::Cubic => r * r * r,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Linear => "rbf-linear",
            Self::Cubic => "rbf-cubic",
        }
    }
}

/// Centres and weights of one space, padded to the core's lane count with centres of zero weight.
#[derive(Debug, Clone, PartialEq)]
pub struct RbfFit {
    /// x, y, z of the centres, in cells.
    pub centres: [Vec<f64>; 3],
    /// x, y, z of the weights, N.
    pub weights: [Vec<f64>; 3],
    /// Largest misfit at a centre, N.
    pub misfit_n: f64,
}

/// Why the weights could not be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FitError {
    /// The factorisation would exceed the memory limit.
    #[error(
        "{centres} centres are too many for {} (at most {}); pack without this method", .kernel.name(), MAX_CENTRES
    )]
    TooMany {
        /// The kernel.
        kernel: Kernel,
        /// Number of centres.
        centres: usize,
    },
    /// The matrix is singular: the weights do not reproduce the forces at the centres, or are not finite.
    #[error(
        "the {} system of {centres} centres is singular (misfit {misfit_n:.1e} N); pack without this method",
        .kernel.name()
    )]
    Singular {
        /// The kernel.
        kernel: Kernel,
        /// Number of centres.
        centres: usize,
        /// Largest misfit, N.
        misfit_n: f64,
    },
    /// The threads could not be started.
    #[error(transparent)]
    Threads(#[from] ThreadError),
}

/// Maximum number of centres for linear weights by factorisation: 6.4 GB. With 6,204 centres the
/// factorisation takes 5 s and the iteration 25 s.
const MAX_DENSE_CENTRES: usize = 20_000;
/// Maximum number of centres of the cubic kernel: 14 GB during the factorisation.
const MAX_CENTRES: usize = 30_000;

/// A misfit above this share of the largest force means a singular matrix.
const MISFIT: f64 = 1e-6;

/// Weights w with sum_j w_j phi(|x_i - x_j|) = h_i at every sample, per component.
///
/// Distances are in cells, so the matrix is independent of the unit of length. There is no polynomial tail,
/// as in the paper (whose sum to N-1 is a misprint for N). The matrix is symmetric indefinite with zeros on
/// the diagonal: LBL^T with pivoting, N^3/3 operations, 8 N^2 bytes twice. If that exceeds the memory, linear
/// weights are computed iteratively on `threads` threads, to the same misfit.
pub fn fit_rbf(kernel: Kernel, centres: &[Centre], threads: usize) -> Result<RbfFit, FitError> {
    let n = centres.len();
    let (weights, misfit_n) = match kernel {
        Kernel::Linear if n > MAX_DENSE_CENTRES => solve_iteratively(centres, threads)?,
        Kernel::Cubic if n > MAX_CENTRES => return Err(FitError::TooMany { kernel, centres: n }),
        _ => solve_densely(kernel, centres),
    };
    let largest = centres.iter().flat_map(|c| c.force_n).fold(0.0, |m: f64, h| m.max(h.abs()));
    if misfit_n.is_nan() || misfit_n > MISFIT * largest.max(f64::MIN_POSITIVE) {
        return Err(FitError::Singular { kernel, centres: n, misfit_n });
    }
    let padded = |mut plane: Vec<f64>| {
        plane.resize(n.next_multiple_of(RBF_LANES), 0.0);
        plane
    };
    Ok(RbfFit {
        centres: std::array::from_fn(|axis| padded(centres.iter().map(|c| c.position[axis]).collect())),
        weights: weights.map(padded),
        misfit_n,
    })
}

/// Weights by factorisation, and the largest misfit, N.
fn solve_densely(kernel: Kernel, centres: &[Centre]) -> ([Vec<f64>; 3], f64) {
    let forces = Mat::from_fn(centres.len(), 3, |i, axis| centres[i].force_n[axis]);
    let positions: Vec<[f64; 3]> = centres.iter().map(|c| c.position).collect();
    let (weights, misfit_n) = solve(kernel, &positions, &forces);
    (std::array::from_fn(|axis| weights.col(axis).iter().copied().collect()), misfit_n)
}

/// Weights for each column of `values` (one row per centre), and the largest misfit; infinite for a singular
/// matrix.
fn solve(kernel: Kernel, positions: &[[f64; 3]], values: &Mat<f64>) -> (Mat<f64>, f64) {
    let n = positions.len();
    let matrix = Mat::from_fn(n, n, |i, j| kernel.between(positions[i], positions[j]));
    let factor = matrix.lblt(Side::Lower);
    let mut weights = factor.solve(values);
    // One step of refinement: the condition number of the cubic matrix is 1e6 at 514 points, 1e8 at 4168.
    let residual = values - &matrix * &weights;
    weights += factor.solve(&residual);
    let misfit = values - &matrix * &weights;
    // faer's norm ignores NaN, so the check for finite values is separate.
    let finite = |m: &Mat<f64>| m.col_iter().all(|column| column.iter().all(|x| x.is_finite()));
    let misfit = if finite(&weights) && finite(&misfit) { misfit.norm_max() } else { f64::INFINITY };
    (weights, misfit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::SpaceGrid;

    fn field(position: [f64; 3]) -> Centre {
        let [x, y, z] = position.map(|n| n / 3.0);
        Centre { position, force_n: [(2.0 * x).sinh() + y * z, y - x * z * z, (z + x).tanh()] }
    }

    /// Points of a ball with this number of cells, and some between them.
    fn centres(cells: i32) -> Vec<Centre> {
        let grid = SpaceGrid::new(0.03 / f64::from(cells), 0.03).unwrap();
        let on_grid = grid.lattice.points().chain([[0; 3]]).map(|p| p.map(f64::from));
        let between = (0..40).map(|n| {
            [0.37, 0.61, 0.83].map(|x| f64::from(cells) * (2.0 * (x * f64::from(n + 1)).fract() - 1.0) * 0.5)
        });
        let small = |p: [f64; 3]| p.map(|x| 3.0 * x / f64::from(cells));
        on_grid.chain(between).map(|p| Centre { position: p, ..field(small(p)) }).collect()
    }

    #[test]
    fn the_fit_passes_through_every_centre() {
        let centres = centres(3);
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let fit = fit_rbf(kernel, &centres, 1).unwrap();
            for (i, centre) in centres.iter().enumerate() {
                let at: [f64; 3] = std::array::from_fn(|axis| fit.centres[axis][i]);
                for axis in 0..3 {
                    let value: f64 = (0..centres.len())
                        .map(|j| {
                            let r2: f64 = (0..3).map(|a| (fit.centres[a][j] - at[a]).powi(2)).sum();
                            fit.weights[axis][j] * kernel.value(r2.sqrt())
                        })
                        .sum();
                    assert!((value - centre.force_n[axis]).abs() < 1e-9, "{kernel:?} {at:?}");
                }
            }
        }
    }

    #[test]
    fn the_iterative_route_finds_the_same_weights_whatever_the_threads() {
        let centres = centres(7);
        let (dense, _) = solve_densely(Kernel::Linear, &centres);
        let solve = |threads| solve_iteratively(&centres, threads).expect("threads start");
        let (iterative, misfit_n) = solve(2);
        assert!(misfit_n < 1e-8, "{misfit_n} N");
        let largest = dense.iter().flatten().fold(0.0, |m: f64, w| m.max(w.abs()));
        let apart = dense.iter().flatten().zip(iterative.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-7 * largest);
        assert_eq!(iterative, solve(1).0, "the bits depend on the threads");
    }

    #[test]
    fn two_values_at_one_place_are_refused() {
        let centre = |force| Centre { position: [1.0, 2.0, 3.0], force_n: [force; 3] };
        assert!(fit_rbf(Kernel::Cubic, &[centre(1.0), centre(2.0)], 1).is_err());
    }
}
