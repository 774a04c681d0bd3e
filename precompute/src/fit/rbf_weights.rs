//! Weights of the radial basis functions (paper, Eq. 12).

use faer::prelude::Solve;
use faer::{Mat, Side};

use super::Sample;

/// The kernel phi(r), r in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// phi = r.
    Linear,
    /// phi = r^3.
    Cubic,
}

impl Kernel {
    /// phi(r).
    #[inline]
    pub fn value(self, r: f64) -> f64 {
        match self {
            Self::Linear => r,
            Self::Cubic => r * r * r,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Cubic => "cubic",
        }
    }
}

/// Centres and weights of one space.
#[derive(Debug, Clone, PartialEq)]
pub struct RbfFit {
    /// x, y, z of the centres, in cells.
    pub centres: [Vec<f64>; 3],
    /// x, y, z of the weights, N.
    pub weights: [Vec<f64>; 3],
    /// Largest misfit at a centre, N.
    pub misfit_n: f64,
}

/// The weights could not be found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitError {
    kernel: Kernel,
    centres: usize,
    misfit_n: f64,
}

impl std::fmt::Display for FitError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "the rbf-{} system of {} centres is singular (misfit {:.1e} N); pack without this method",
            self.kernel.name(),
            self.centres,
            self.misfit_n
        )
    }
}

impl std::error::Error for FitError {}

/// A misfit beyond this share of the largest force means that the matrix was singular.
const MISFIT: f64 = 1e-6;

/// Weights w with sum_j w_j phi(|x_i - x_j|) = h_i at every sample, per component.
///
/// Distances are in cells, so the matrix does not depend on the unit of length. No polynomial tail, as in the paper
/// (whose sum to N-1 is a misprint for N). The matrix is symmetric indefinite with zeros on the diagonal: LBL^T
/// with pivoting, N^3/3 operations. Memory 8 N^2 bytes, twice.
pub fn fit_rbf(kernel: Kernel, samples: &[Sample]) -> Result<RbfFit, FitError> {
    let n = samples.len();
    let position = |i: usize| samples[i].index.map(f64::from);
    let matrix = Mat::from_fn(n, n, |i, j| {
        let (a, b) = (position(i), position(j));
        let squared: f64 = a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum();
        kernel.value(squared.sqrt())
    });
    let forces = Mat::from_fn(n, 3, |i, axis| samples[i].force_n[axis]);
    let factor = matrix.lblt(Side::Lower);
    let mut weights = factor.solve(&forces);
    // One refinement: cond of the cubic matrix is 1e6 at 514 points, 1e8 at 4168.
    let residual = &forces - &matrix * &weights;
    weights += factor.solve(&residual);
    let misfit = &forces - &matrix * &weights;
    // faer's norm passes a NaN over; a fit with one must not pass for good.
    let finite =
        (0..n).all(|i| (0..3).all(|axis| weights[(i, axis)].is_finite() && misfit[(i, axis)].is_finite()));
    let misfit_n = if finite { misfit.norm_max() } else { f64::INFINITY };
    let largest = forces.norm_max();
    if misfit_n > MISFIT * largest.max(f64::MIN_POSITIVE) {
        return Err(FitError { kernel, centres: n, misfit_n });
    }
    Ok(RbfFit {
        centres: std::array::from_fn(|axis| (0..n).map(|i| position(i)[axis]).collect()),
        weights: std::array::from_fn(|axis| (0..n).map(|i| weights[(i, axis)]).collect()),
        misfit_n,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::configuration_space::SpaceGrid;

    #[test]
    fn the_fit_passes_through_every_centre() {
        let grid = SpaceGrid::new(0.01, 0.03).unwrap();
        let samples: Vec<Sample> = grid
            .lattice
            .points()
            .chain([[0; 3]])
            .map(|index| {
                let [x, y, z] = index.map(|n| f64::from(n) / 3.0);
                Sample {
                    attempt: 0,
                    energy_j: 0.0,
                    third_n_m2: [0.0; 10],
                    index,
                    force_n: [(2.0 * x).sinh() + y * z, y - x * z * z, (z + x).tanh()],
                    stiffness_n_m: [[0.0; 3]; 3],
                    terminating: false,
                    inverted: false,
                }
            })
            .collect();
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let fit = fit_rbf(kernel, &samples).unwrap();
            for (i, sample) in samples.iter().enumerate() {
                let at: [f64; 3] = std::array::from_fn(|axis| fit.centres[axis][i]);
                for axis in 0..3 {
                    let value: f64 = (0..samples.len())
                        .map(|j| {
                            let r2: f64 = (0..3).map(|a| (fit.centres[a][j] - at[a]).powi(2)).sum();
                            fit.weights[axis][j] * kernel.value(r2.sqrt())
                        })
                        .sum();
                    assert!((value - sample.force_n[axis]).abs() < 1e-9, "{kernel:?} {at:?}");
                }
            }
        }
    }

    #[test]
    fn two_values_at_one_place_are_refused() {
        let sample = |force| Sample {
            attempt: 0,
            energy_j: 0.0,
            third_n_m2: [0.0; 10],
            index: [1, 2, 3],
            force_n: [force; 3],
            stiffness_n_m: [[0.0; 3]; 3],
            terminating: false,
            inverted: false,
        };
        assert!(fit_rbf(Kernel::Cubic, &[sample(1.0), sample(2.0)]).is_err());
    }
}
