//! Stagnation test of adaptive sampling: whether further configurations still reduce the prediction errors.
//!
//! The errors of a smooth body decrease by orders of magnitude with the first few dozen configurations. At a
//! branch jump they do not decrease, because a smooth kernel oscillates there for any data. The test uses the
//! large errors and not the mean: about one prediction in five is affected by a jump, and the errors of the
//! others continue to decrease.

use super::prediction::Test;

/// Number of predictions in each of the two compared windows. On the bundled organ, nodes that pass after 100
/// configurations are never classified as stagnating with 40; with 30, three of 297 were.
const WINDOW: usize = 40;
/// The window is represented by its 90th percentile: one error in ten is larger.
const ONE_IN_PERCENTILE: usize = 10;
/// The errors decrease if the percentile is below this share of the previous one.
const MAX_RATIO: f64 = 0.7;

/// Whether the errors of these predictions, in order of time, stopped decreasing before they reached the
/// tolerance.
pub(super) fn is_stagnant(tests: &[Test]) -> bool {
    let shares: Vec<f64> =
        tests.iter().filter(|test| test.counts).map(|test| test.error_n / test.tolerance_n).collect();
    let Some(from) = shares.len().checked_sub(2 * WINDOW) else { return false };
    let (before, now) = shares[from..].split_at(WINDOW);
    let (before, now) = (large(before), large(now));
    now > 1.0 && now > MAX_RATIO * before
}

/// The 90th percentile.
fn large(shares: &[f64]) -> f64 {
    let mut sorted = shares.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() - sorted.len() / ONE_IN_PERCENTILE).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Predictions with these errors, as shares of the tolerance.
    fn tests(shares: impl Iterator<Item = f64>) -> Vec<Test> {
        let test =
            |share: f64| Test { index: [0; 3], error_n: 0.02 * share, tolerance_n: 0.02, counts: true };
        shares.map(test).collect()
    }

    #[test]
    fn errors_that_fall_slowly_are_no_stall_and_large_ones_that_stay_are() {
        let falling = |n: usize| 30.0 * f64::powf(0.97, n as f64);
        assert!(!is_stagnant(&tests((0..200).map(falling))));
        // One prediction in five is affected by the jump; the errors of the others decrease.
        let folded = |n: usize| if n.is_multiple_of(5) { 6.0 } else { falling(n) };
        assert!(is_stagnant(&tests((0..160).map(folded))));
        assert!(!is_stagnant(&tests((0..2 * WINDOW - 1).map(folded))), "too few predictions for a decision");
        // Errors within tolerance need not decrease; predictions beyond the force limit are ignored.
        assert!(!is_stagnant(&tests((0..200).map(|_| 0.9))));
        let mut beyond = tests((0..200).map(folded));
        beyond.iter_mut().filter(|test| test.error_n > 0.1).for_each(|test| test.counts = false);
        assert!(!is_stagnant(&beyond));
    }
}
