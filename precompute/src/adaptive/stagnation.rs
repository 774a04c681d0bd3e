//! When more configurations do not help: the predictions do not fall.
//!
//! A smooth body's errors fall by orders of magnitude while its few dozen configurations come in. Where the space folds they do not: a smooth
//! kernel rings at a jump, wherever its data are. What is looked at is the large errors and not the mean of all: a fold is met by one
//! prediction in five, and the other four go on falling.

use super::Test;

/// Predictions that are looked at together, and compared with as many before them. On the bundled organ nodes that pass after 100
/// configurations are never taken for stalled with 40; with 30 three of 297 were.
const WINDOW: usize = 40;
/// The error that stands for them: one in ten is larger.
const ONE_IN: usize = 10;
/// It falls if it is now below this share of what it was.
const FALLS: f64 = 0.7;

/// Whether the errors of these predictions, in the order they were made, have ceased to fall before they came within tolerance.
pub(super) fn is_stalled(tests: &[Test]) -> bool {
    let shares: Vec<f64> =
        tests.iter().filter(|test| test.within).map(|test| test.error_n / test.tolerance_n).collect();
    let Some(from) = shares.len().checked_sub(2 * WINDOW) else { return false };
    let (before, now) = shares[from..].split_at(WINDOW);
    let (before, now) = (large(before), large(now));
    now > 1.0 && now > FALLS * before
}

/// One in ten is larger.
fn large(shares: &[f64]) -> f64 {
    let mut sorted = shares.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() - sorted.len() / ONE_IN).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Predictions with these errors, by their tolerance.
    fn tests(shares: impl Iterator<Item = f64>) -> Vec<Test> {
        let test =
            |share: f64| Test { index: [0; 3], error_n: 0.02 * share, tolerance_n: 0.02, within: true };
        shares.map(test).collect()
    }

    #[test]
    fn errors_that_fall_slowly_are_no_stall_and_large_ones_that_stay_are() {
        let falling = |n: usize| 30.0 * f64::powf(0.97, n as f64);
        assert!(!is_stalled(&tests((0..200).map(falling))));
        // One in five meets the fold; the others fall as before.
        let folded = |n: usize| if n.is_multiple_of(5) { 6.0 } else { falling(n) };
        assert!(is_stalled(&tests((0..160).map(folded))));
        assert!(!is_stalled(&tests((0..2 * WINDOW - 1).map(folded))), "too few to say");
        // Within tolerance there is nothing to fall any more; what is beyond the limit says nothing.
        assert!(!is_stalled(&tests((0..200).map(|_| 0.9))));
        let mut beyond = tests((0..200).map(folded));
        beyond.iter_mut().filter(|test| test.error_n > 0.1).for_each(|test| test.within = false);
        assert!(!is_stalled(&beyond));
    }
}
