//! What the residuals at the solution tell: standard errors, correlations, and whether the model describes the data.
//!
//! With the Jacobian J of the residuals r by the constants, the influence psi and its slope psi' of the loss, m
//! residuals and p constants,
//!
//! C = m / (m - p) A^-1 B A^-1,   A = J^T diag(psi') J,   B = J^T J sum psi^2 / m.
//!
//! With the linear loss this is s^2 (J^T J)^-1, s^2 = sum r^2 / (m - p). The interval of a constant is its value plus
//! and minus Student's t with m - p degrees of freedom times sqrt(C_kk). Source: Huber 1981, section 7.6.
//!
//! Noise has no memory. If the model is wrong, residuals that follow each other in a test have the same sign: their
//! correlation over n pairs is then far above 1 / sqrt(n), the standard deviation of that of noise.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::loss::Loss;

/// Residuals that follow each other are systematic above this many standard deviations of noise, or, in a short test,
/// above this correlation,
const SYSTEMATIC: f64 = 3.3;
const SHORT: f64 = 0.8;
/// of at least so many pairs,
const PAIRS: f64 = 5.0;
/// if they are also above this share of the forces.
const MISFIT: f64 = 1e-3;
/// Smallest share of the largest eigenvalue of the scaled J^T J that the data still determine.
const DETERMINED: f64 = 1e-16;

/// Precision of the constants at the solution.
#[derive(Debug, Clone)]
pub(super) struct Precision {
    /// Standard errors.
    pub standard_errors: Vec<f64>,
    /// Factor of a standard error that gives the interval.
    pub t: f64,
    /// Correlations, row-major.
    pub correlation: Vec<Vec<f64>>,
    /// Covariance.
    pub covariance: DMatrix<f64>,
}

impl Precision {
    /// From the Jacobian, the residuals, and scale of the loss. The error is the index of a constant that the data
    /// do not determine.
    pub(super) fn of(
        jacobian: &DMatrix<f64>,
        residuals: &[f64],
        (loss, scale): (Loss, f64),
        confidence: f64,
    ) -> Result<Self, usize> {
        let (m, p) = jacobian.shape();
        let lengths: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let largest = lengths.iter().copied().fold(0.0, f64::max);
        // A column of zeros: the forces do not depend on the constant.
        if let Some(dead) = lengths.iter().position(|length| *length == 0.0 || largest.is_nan()) {
            return Err(dead);
        }
        let scaled = DMatrix::from_fn(m, p, |i, k| jacobian[(i, k)] / lengths[k]);
        let influence: Vec<(f64, f64)> = residuals.iter().map(|&r| loss.influence(r, scale)).collect();
        let slopes = DVector::from_iterator(m, influence.iter().map(|(_, slope)| *slope));
        let spread = influence.iter().map(|(psi, _)| psi * psi).sum::<f64>() / m as f64;
        let bent = DMatrix::from_fn(m, p, |i, k| slopes[i] * scaled[(i, k)]);
        let (a, b) = (scaled.transpose() * bent, scaled.transpose() * &scaled * spread);
        let eigen = SymmetricEigen::new(a.clone());
        let (low, high) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
        let weakest = eigen.eigenvectors.column(eigen.eigenvalues.imin()).iamax();
        if low.is_nan() || low <= DETERMINED * high {
            return Err(weakest);
        }
        let inverse = a.try_inverse().ok_or(weakest)?;
        let freedom = (m - p) as f64;
        let covariance = &inverse * b * &inverse * (m as f64 / freedom);
        let covariance = DMatrix::from_fn(p, p, |i, k| covariance[(i, k)] / (lengths[i] * lengths[k]));
        let standard_errors: Vec<f64> = (0..p).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect();
        let of = |i: usize, k: usize| covariance[(i, k)] / (standard_errors[i] * standard_errors[k]);
        let entry = |i: usize, k: usize| {
            if i == k { 1.0 } else { Some(of(i, k)).filter(|c| c.is_finite()).unwrap_or(0.0) }
        };
        let correlation = (0..p).map(|i| (0..p).map(|k| entry(i, k)).collect()).collect();
        let student = StudentsT::new(0.0, 1.0, freedom).expect("at least one degree of freedom");
        Ok(Self {
            standard_errors,
            t: student.inverse_cdf(0.5 * (1.0 + confidence)),
            correlation,
            covariance,
        })
    }

    /// The combination theta_i + w theta_k that the data determine best, and its standard error.
    pub(super) fn combination(&self, i: usize, k: usize) -> (f64, f64) {
        let c = &self.covariance;
        // The variance c_ii + 2 w c_ik + w^2 c_kk is smallest here.
        let w = -c[(i, k)] / c[(k, k)];
        let variance = c[(i, i)] + 2.0 * w * c[(i, k)] + w * w * c[(k, k)];
        (w, variance.max(0.0).sqrt())
    }
}

/// Root mean square.
pub(super) fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// How residuals that follow each other are related.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Succession {
    /// Correlation of each residual with the next one of its test, -1 to 1.
    pub correlation: f64,
    /// Number of pairs of all tests and components.
    pub pairs: f64,
}

impl Succession {
    /// Of sequences of residuals in the order of their tests.
    pub(super) fn of(sequences: &[Vec<f64>]) -> Self {
        let pairs = || sequences.iter().flat_map(|s| s.windows(2).map(|pair| (pair[0], pair[1])));
        let (count, products) = (pairs().count() as f64, pairs().map(|(a, b)| a * b).sum::<f64>());
        let [before, after]: [f64; 2] =
            [pairs().map(|(a, _)| a * a).sum(), pairs().map(|(_, b)| b * b).sum()];
        let size = (before * after).sqrt();
        let correlation = if size > 0.0 { products / size } else { 0.0 };
        Self { correlation, pairs: count }
    }

    /// Whether the model does not describe the data. `share` is the RMS residual over the RMS force.
    pub(super) fn is_systematic(&self, share: f64) -> bool {
        let limit = (SYSTEMATIC / self.pairs.sqrt()).min(SHORT);
        self.pairs >= PAIRS && self.correlation > limit && share > MISFIT
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::sequence::{split_mix, unit_interval};

    /// Gaussian noise of unit standard deviation.
    fn noise(random: &mut u64) -> f64 {
        let mut next = || {
            *random += 1;
            unit_interval(split_mix(split_mix(*random)))
        };
        (0..12).map(|_| next()).sum::<f64>() - 6.0
    }

    /// A line y = a + b x with noise has the textbook's standard errors, and the interval holds the truth in 95 of
    /// 100 fits.
    #[test]
    fn intervals_of_a_straight_line_hold_the_truth() {
        let x: Vec<f64> = (0..20).map(|i| f64::from(i) / 19.0).collect();
        let jacobian = DMatrix::from_fn(20, 2, |i, k| if k == 0 { 1.0 } else { x[i] });
        let mut random = 3_u64 << 32;
        let (mut held, runs) = ([0_u32; 2], 2000);
        for _ in 0..runs {
            let y = DVector::from_iterator(20, x.iter().map(|x| 2.0 + 3.0 * x + 0.1 * noise(&mut random)));
            let normal = (jacobian.transpose() * &jacobian).try_inverse().expect("regular");
            let fit = &normal * jacobian.transpose() * &y;
            let residuals: Vec<f64> = (&jacobian * &fit - &y).iter().copied().collect();
            let found = Precision::of(&jacobian, &residuals, (Loss::Linear, 1.0), 0.95).expect("determined");
            let s = (residuals.iter().map(|r| r * r).sum::<f64>() / 18.0).sqrt();
            assert!((found.standard_errors[1] - s * normal[(1, 1)].sqrt()).abs() < 1e-12);
            assert!((found.t - 2.100_922).abs() < 1e-6, "Student's t of 18");
            for (k, truth) in [2.0, 3.0].into_iter().enumerate() {
                held[k] += u32::from((fit[k] - truth).abs() <= found.t * found.standard_errors[k]);
            }
            let expected = normal[(0, 1)] / (normal[(0, 0)] * normal[(1, 1)]).sqrt();
            assert!((found.correlation[0][1] - expected).abs() < 1e-12);
        }
        assert!(held.iter().all(|&h| (1875..1925).contains(&h)), "{held:?} of {runs}");
    }

    /// One constant and a Huber loss of scale 1: the formulas written out.
    #[test]
    fn a_robust_loss_has_the_sandwich_of_its_influence() {
        let (x, r): ([f64; 5], [f64; 5]) = ([1.0, 2.0, 3.0, 4.0, 5.0], [0.5, -3.0, 0.2, 6.0, -0.8]);
        let jacobian = DMatrix::from_fn(5, 1, |i, _| x[i]);
        let found = Precision::of(&jacobian, &r, (Loss::Huber, 1.0), 0.95).expect("determined");
        // Residuals beyond the scale have the influence 1 and no slope.
        let a = 1.0 + 9.0 + 25.0;
        let b = 55.0 * (0.25 + 1.0 + 0.04 + 1.0 + 0.64) / 5.0;
        let expected = f64::sqrt(5.0 / 4.0 * b / (a * a));
        assert!(
            (found.standard_errors[0] - expected).abs() < 1e-12,
            "{} {expected}",
            found.standard_errors[0]
        );
    }

    #[test]
    fn the_best_combination_of_two_constants_has_the_smallest_error() {
        let jacobian = DMatrix::from_fn(6, 2, |i, k| 1.0 + 0.1 * (i * k) as f64);
        let found = Precision::of(&jacobian, &[0.1, -0.2, 0.1, 0.0, 0.2, -0.1], (Loss::Linear, 1.0), 0.95);
        let found = found.expect("determined");
        let (w, error) = found.combination(0, 1);
        let c = &found.covariance;
        let variance = |w: f64| c[(0, 0)] + 2.0 * w * c[(0, 1)] + w * w * c[(1, 1)];
        assert!(w > 0.5 && (variance(w).sqrt() - error).abs() < 1e-12, "{w}");
        assert!(
            variance(w) < variance(w + 0.1)
                && variance(w) < variance(w - 0.1)
                && error < 0.2 * found.standard_errors[0]
        );
    }

    #[test]
    fn a_constant_without_effect_is_named() {
        let dead = DMatrix::from_fn(5, 2, |i, k| if k == 0 { i as f64 } else { 0.0 });
        assert_eq!(Precision::of(&dead, &[0.1; 5], (Loss::Linear, 1.0), 0.95).err(), Some(1));
        let equal = DMatrix::from_fn(5, 2, |i, _| i as f64);
        assert!(Precision::of(&equal, &[0.1; 5], (Loss::Linear, 1.0), 0.95).is_err());
    }

    #[test]
    fn smooth_residuals_are_systematic_and_noise_is_not() {
        let smooth: Vec<f64> = (0..20).map(|i| libm::sin(0.3 * f64::from(i))).collect();
        assert!(Succession::of(&[smooth]).is_systematic(0.02));
        let mut random = 5_u64 << 32;
        let alarms = (0..1000).filter(|_| {
            let rows = [(); 3].map(|()| (0..20).map(|_| noise(&mut random)).collect());
            Succession::of(&rows).is_systematic(0.02)
        });
        assert!(alarms.count() <= 3, "false alarms");
        let short: Vec<f64> = (0..8).map(|i| f64::from(i) - 2.5).collect();
        let is_systematic = |rows: &[f64]| Succession::of(&[rows.to_vec()]).is_systematic(0.02);
        assert!(is_systematic(&short) && !is_systematic(&short[..5]));
        let alarms = (0..1000)
            .filter(|_| Succession::of(&[(0..8).map(|_| noise(&mut random)).collect()]).is_systematic(0.02));
        assert!(alarms.count() <= 25, "false alarms of a short test");
    }
}
