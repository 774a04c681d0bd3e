//! How long solves take.

/// Weight of the last solve in the mean.
const NEWEST_SHARE: f64 = 0.2;
/// Mean before the first solve, s.
const FIRST_S: f64 = 5e-3;
/// Where a factor takes longer than this, nobody waits for one, s.
const WAITED_S: f64 = 0.2;

/// Mean times of a solve with the factor at hand, and with a new one.
#[derive(Debug, Default)]
pub(super) struct SolveTimes {
    /// s; `None` before the first one.
    means_s: [Option<f64>; 2],
    /// To which of them the present step belongs.
    timed: Option<usize>,
}

impl SolveTimes {
    /// The present step makes this number of factors; `None` if it belongs to neither mean.
    pub(super) fn begin(&mut self, factors: Option<u64>) {
        self.timed = factors.filter(|factors| *factors < 2).map(|factors| factors as usize);
    }

    /// The present step has taken this time, s.
    pub(super) fn took(&mut self, seconds: f64) {
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

    /// Whether a new factor takes too long to wait for it.
    pub(super) fn factor_is_long(&self) -> bool {
        self.renewed_s() > WAITED_S
    }
}
