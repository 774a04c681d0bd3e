//! Errors of a force at a set of positions: of its components, as in the paper, and of the vector.

use serde::{Deserialize, Serialize};

use crate::num::vector::distance;
use crate::spec::Tolerance;

/// Force of a method at one position, with the reference solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// h by finite elements, N.
    pub truth_n: [f64; 3],
    /// h by the method, N.
    pub found_n: [f64; 3],
    /// Whether the method's own data surround the position.
    pub covered: bool,
}

/// Components below this are excluded from relative errors (paper, 6.3), N.
pub(crate) const RELATIVE_FROM_N: f64 = 0.5;

impl Compared {
    /// |error vector|, N.
    pub fn error_n(&self) -> f64 {
        distance(self.truth_n, self.found_n)
    }

    /// Whether the error is within [`Tolerance::IMPERCEPTIBLE`].
    pub(crate) fn is_imperceptible(&self) -> bool {
        self.error_n() <= Tolerance::IMPERCEPTIBLE.at(self.truth_n)
    }
}

/// Errors over a set of positions; all zero for an empty set.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Errors {
    /// Number of positions.
    pub count: usize,
    /// Number of positions that the method's own data surround.
    pub covered: usize,
    /// Mean |error vector|, N.
    pub mean_n: f64,
    /// Median of |error vector|, N.
    pub p50_n: f64,
    /// 95th percentile of |error vector|, N.
    pub p95_n: f64,
    /// 99th percentile of |error vector|, N.
    pub p99_n: f64,
    /// Maximum of |error vector|, N.
    pub max_n: f64,
    /// Mean absolute error of a component, N (paper, Eq. 13).
    pub component_mean_n: f64,
    /// Largest absolute error of a component, N.
    pub component_max_n: f64,
    /// Mean relative error of the components of at least 0.5 N (paper, Eq. 14).
    pub relative_mean: f64,
    /// Largest relative error of these components.
    pub relative_max: f64,
    /// Mean absolute error of the smaller components, N.
    pub small_mean_n: f64,
    /// Number of positions with an imperceptible error.
    #[serde(alias = "not_felt")]
    pub below_jnd: usize,
}

impl Errors {
    /// Errors of these positions.
    pub fn of<'c>(compared: impl IntoIterator<Item = &'c Compared>) -> Self {
        let mut errors = Self::default();
        let (mut sizes, mut relatives, mut smalls) = (Vec::new(), 0usize, 0usize);
        for c in compared {
            errors.count += 1;
            errors.covered += usize::from(c.covered);
            errors.below_jnd += usize::from(c.is_imperceptible());
            sizes.push(c.error_n());
            for (truth, found) in c.truth_n.iter().zip(c.found_n) {
                let error = (truth - found).abs();
                errors.component_mean_n += error;
                errors.component_max_n = errors.component_max_n.max(error);
                if truth.abs() >= RELATIVE_FROM_N {
                    relatives += 1;
                    errors.relative_mean += error / truth.abs();
                    errors.relative_max = errors.relative_max.max(error / truth.abs());
                } else {
                    smalls += 1;
                    errors.small_mean_n += error;
                }
            }
        }
        let share = |sum: f64, count: usize| sum / count.max(1) as f64;
        errors.mean_n = share(sizes.iter().sum(), sizes.len());
        errors.component_mean_n = share(errors.component_mean_n, 3 * errors.count);
        errors.relative_mean = share(errors.relative_mean, relatives);
        errors.small_mean_n = share(errors.small_mean_n, smalls);
        sizes.sort_by(f64::total_cmp);
        [errors.p50_n, errors.p95_n, errors.p99_n] = [0.5, 0.95, 0.99].map(|share| percentile(&sizes, share));
        errors.max_n = sizes.last().copied().unwrap_or(0.0);
        errors
    }
}

/// Positions within a tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Within {
    /// The tolerance.
    pub tolerance: Tolerance,
    /// Number of positions within it.
    pub count: usize,
    /// Lower bound of the share of all positions within it, with 95 % confidence.
    pub certified: f64,
}

impl Within {
    /// Result for these positions.
    pub(crate) fn of<'c>(tolerance: Tolerance, compared: impl IntoIterator<Item = &'c Compared>) -> Self {
        let (mut tests, mut count) = (0, 0);
        for c in compared {
            tests += 1;
            count += usize::from(c.error_n() <= tolerance.at(c.truth_n));
        }
        Self { tolerance, count, certified: certified_share(tests, tests - count) }
    }
}

/// The smallest value that at least the share `share` of the sorted values does not exceed.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let place = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(place.max(1) - 1).copied().unwrap_or(0.0)
}

/// Lower bound of the share of all positions within a tolerance, with 95 % confidence, when `exceeded` of
/// `tests` independent ones are beyond it (Clopper and Pearson). 299 tests without an exceedance certify 99
/// %.
pub fn certified_share(tests: usize, exceeded: usize) -> f64 {
    if tests == 0 || exceeded >= tests {
        return 0.0;
    }
    // P(at most `exceeded` failures) decreases with the failure probability. The bound is the probability at
    // which it equals 5 %.
    let (mut low, mut high) = (0.0f64, 1.0f64);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if binomial_cdf(tests, exceeded, middle) > 0.05 { low = middle } else { high = middle }
    }
    1.0 - high
}

/// Probability of at most k events in n independent trials of probability p.
fn binomial_cdf(n: usize, k: usize, p: f64) -> f64 {
    let mut log_term = n as f64 * libm::log(1.0 - p);
    let mut sum = libm::exp(log_term);
    for i in 0..k {
        log_term += libm::log((n - i) as f64 / (i + 1) as f64) + libm::log(p / (1.0 - p));
        sum += libm::exp(log_term);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tolerance_of_the_scenes_own_is_held_against_the_same_positions() {
        let compared = [0.0, 0.001, 0.004, 0.03].map(|error| Compared {
            truth_n: [1.0, 0.0, 0.0],
            found_n: [1.0 + error, 0.0, 0.0],
            covered: true,
        });
        let count = |relative, absolute_n| Within::of(Tolerance { relative, absolute_n }, &compared).count;
        assert_eq!(
            (count(0.0, 0.002), count(0.0035, 0.002), count(0.0045, 0.002), count(0.0, 0.1)),
            (2, 2, 3, 4)
        );
        let within = Within::of(Tolerance { relative: 0.0, absolute_n: 0.002 }, &compared);
        assert!((within.certified - certified_share(4, 2)).abs() < 1e-12 && within.certified < 0.5);
    }

    #[test]
    fn the_numbers_of_tests_that_certify_99_percent() {
        for (tests, exceeded) in [(299, 0), (473, 1), (628, 2)] {
            assert!(certified_share(tests, exceeded) >= 0.99, "{tests} {exceeded}");
            assert!(certified_share(tests - 1, exceeded) < 0.99, "{tests} {exceeded}");
        }
        assert_eq!((certified_share(0, 0), certified_share(5, 5)), (0.0, 0.0));
    }

    #[test]
    fn errors_of_a_hand_made_set() {
        let compared =
            |truth_n: [f64; 3], found_n: [f64; 3]| Compared { truth_n, found_n, covered: truth_n[0] > 0.0 };
        let all = [
            compared([1.0, 0.0, 0.0], [1.1, 0.0, 0.0]),
            compared([2.0, -1.0, 0.25], [2.0, -1.0, 0.25]),
            compared([-4.0, 0.0, 3.0], [-4.0, 0.12, 3.16]),
        ];
        let e = Errors::of(&all);
        assert_eq!((e.count, e.covered, e.below_jnd), (3, 2, 1));
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        near(e.mean_n, 0.1);
        near(e.max_n, 0.2);
        near(e.p50_n, 0.1);
        near(e.component_mean_n, 0.38 / 9.0);
        near(e.component_max_n, 0.16);
        // 1, 2, -1, -4 and 3 N.
        near(e.relative_mean, (0.1 + 0.16 / 3.0) / 5.0);
        near(e.small_mean_n, 0.12 / 4.0);
    }
}
