//! How long solves take.

/// Weight of the last solve in the mean.
const NEWEST_SHARE: f64 = 0.2;
/// Mean before the first solve, s.
const FIRST_S: f64 = 5e-3;
/// Where a factor takes longer than this, nobody waits for one, s.
const WAITED_S: f64 = 0.2;
/// Operations a second of a factor, before one is timed.
const FLOPS: f64 = 4e10;

/// Mean times of a solve with the factor at hand, and with a new one.
#[derive(Debug, Default)]
pub(super) struct SolveTimes {
    /// s; `None` before the first one.
    means_s: [Option<f64>; 2],
    /// To which of them the present step belongs.
    timed: Option<usize>,
    /// Mean time of a step of a descent, s, and the number of those in the present step.
    descent_s: Option<f64>,
    descents: u32,
}

impl SolveTimes {
    /// The present step makes this number of factors; `None` if it belongs to neither mean.
    pub(super) fn begin(&mut self, factors: Option<u64>) {
        self.timed = factors.filter(|factors| *factors < 2).map(|factors| factors as usize);
    }

    /// The present step has taken this time, s.
    pub(super) fn took(&mut self, seconds: f64) {
        let descents = std::mem::take(&mut self.descents);
        if descents > 0 {
            let step_s = seconds / f64::from(descents);
            let mean_s = self.descent_s.get_or_insert(step_s);
            *mean_s += NEWEST_SHARE * (step_s - *mean_s);
        }
        let Some(timed) = self.timed.take() else { return };
        let mean_s = self.means_s[timed].get_or_insert(seconds);
        *mean_s += NEWEST_SHARE * (seconds - *mean_s);
    }

    /// With the factor at hand, s.
    pub(super) fn frozen_s(&self) -> f64 {
        self.means_s[0].unwrap_or(FIRST_S)
    }

    /// With a new factor, s.
    pub(super) fn renewed_s(&self) -> f64 {
        self.means_s[1].unwrap_or(FIRST_S)
    }

    /// The present step makes this number of steps of a descent.
    pub(super) fn descends(&mut self, steps: u32) {
        self.descents += steps;
    }

    /// A step of a descent, each with a factor of this number of operations, in a body that is solved without one, s.
    pub(super) fn descent_s(&self, factor_flops: f64) -> f64 {
        self.descent_s.unwrap_or(factor_flops / FLOPS)
    }

    /// Whether a new factor takes too long to wait for it.
    pub(super) fn factor_is_long(&self) -> bool {
        self.renewed_s() > WAITED_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_of_a_descent_are_timed_apart() {
        let mut times = SolveTimes::default();
        assert_eq!(times.descent_s(4e10), 1.0);
        times.begin(None);
        times.descends(10);
        times.took(3.0);
        assert!((times.descent_s(4e10) - 0.3).abs() < 1e-12 && times.renewed_s() == FIRST_S);
        times.begin(Some(1));
        times.took(0.5);
        assert!((times.descent_s(4e10) - 0.3).abs() < 1e-12 && times.renewed_s() == 0.5);
    }
}
