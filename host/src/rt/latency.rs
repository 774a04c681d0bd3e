//! How late the loop wakes and how long a tick computes: preallocated histograms, and the deadlines it missed.

use core::fmt;
use hdrhistogram::Histogram;

/// Longest value kept apart; anything longer counts as this (a stall of more than ten seconds is its own story).
const LONGEST_NS: u64 = 10_000_000_000;
/// How many tick numbers of missed deadlines are kept.
pub const KEPT_MISSES: usize = 16;

/// Recorder used inside the loop. Every method is allocation-free after `new`.
#[derive(Debug, Clone)]
pub struct LatencyRecorder {
    wake: Histogram<u64>,
    compute: Histogram<u64>,
    overruns: u64,
    skipped_periods: u64,
    first_overruns: [u64; KEPT_MISSES],
}

impl Default for LatencyRecorder {
    fn default() -> Self {
        Self::new()
    }
}

impl LatencyRecorder {
    /// Allocates both histograms, three significant digits from 1 ns to 10 s.
    #[must_use]
    pub fn new() -> Self {
        let empty = Histogram::new_with_bounds(1, LONGEST_NS, 3).expect("the bounds are constants and valid");
        Self {
            wake: empty.clone(),
            compute: empty,
            overruns: 0,
            skipped_periods: 0,
            first_overruns: [0; KEPT_MISSES],
        }
    }

    /// Records one tick.
    pub fn record(&mut self, lateness_ns: u64, compute_ns: u64) {
        self.wake.saturating_record(lateness_ns);
        self.compute.saturating_record(compute_ns);
    }

    /// Records that after `tick` this many deadlines had already passed and were skipped.
    pub fn record_overrun(&mut self, tick: u64, skipped: u64) {
        if let Some(slot) = self.first_overruns.get_mut(self.overruns as usize) {
            *slot = tick;
        }
        self.overruns += 1;
        self.skipped_periods += skipped;
    }

    /// The figures so far.
    #[must_use]
    pub fn report(&self) -> LatencyReport {
        let kept = self.first_overruns.len().min(self.overruns as usize);
        LatencyReport {
            wake: Percentiles::of(&self.wake),
            compute: Percentiles::of(&self.compute),
            overruns: self.overruns,
            skipped_periods: self.skipped_periods,
            first_overruns: self.first_overruns[..kept].to_vec(),
        }
    }

    /// Wake-up lateness, for whoever wants more than percentiles.
    #[must_use]
    pub fn wake_histogram(&self) -> &Histogram<u64> {
        &self.wake
    }

    /// Compute time of a tick (device exchange and controller).
    #[must_use]
    pub fn compute_histogram(&self) -> &Histogram<u64> {
        &self.compute
    }
}

/// The usual percentiles of one histogram, in nanoseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Percentiles {
    /// Number of values.
    pub count: u64,
    /// Mean.
    pub mean_ns: f64,
    /// Median.
    pub p50_ns: u64,
    /// 99 %.
    pub p99_ns: u64,
    /// 99.9 %.
    pub p999_ns: u64,
    /// Largest.
    pub max_ns: u64,
}

impl Percentiles {
    fn of(histogram: &Histogram<u64>) -> Self {
        Self {
            count: histogram.len(),
            mean_ns: histogram.mean(),
            p50_ns: histogram.value_at_quantile(0.5),
            p99_ns: histogram.value_at_quantile(0.99),
            p999_ns: histogram.value_at_quantile(0.999),
            max_ns: histogram.max(),
        }
    }
}

impl fmt::Display for Percentiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |ns: u64| ns as f64 * 1e-3;
        write!(
            f,
            "p50 {:.1}  p99 {:.1}  p99.9 {:.1}  max {:.1} us",
            us(self.p50_ns),
            us(self.p99_ns),
            us(self.p999_ns),
            us(self.max_ns)
        )
    }
}

/// What a run's timing came to.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LatencyReport {
    /// Wake-up lateness against the deadline.
    pub wake: Percentiles,
    /// Compute time of a tick.
    pub compute: Percentiles,
    /// Ticks that ended after the next deadline had passed.
    pub overruns: u64,
    /// Deadlines at which therefore no tick ran.
    pub skipped_periods: u64,
    /// Tick numbers of the first overruns.
    pub first_overruns: Vec<u64>,
}

impl fmt::Display for LatencyReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "ticks        {}", self.wake.count)?;
        writeln!(f, "wake-up late {}", self.wake)?;
        writeln!(f, "compute      {}", self.compute)?;
        write!(f, "missed       {} deadlines in {} overruns", self.skipped_periods, self.overruns)?;
        if let Some((first, rest)) = self.first_overruns.split_first() {
            write!(f, ", first after tick {first}")?;
            for tick in rest.iter().take(4) {
                write!(f, ", {tick}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_a_known_distribution() {
        let mut recorder = LatencyRecorder::new();
        for i in 1..=1000_u64 {
            recorder.record(i * 1_000, 500);
        }
        let report = recorder.report();
        assert_eq!(report.wake.count, 1000);
        for (found, expected) in [
            (report.wake.p50_ns, 500_000.0),
            (report.wake.p99_ns, 990_000.0),
            (report.wake.p999_ns, 999_000.0),
            (report.wake.max_ns, 1_000_000.0),
        ] {
            // Three significant digits are kept.
            assert!((found as f64 - expected).abs() <= 1.5e-3 * expected, "{found} against {expected}");
        }
        assert!((report.compute.mean_ns - 500.0).abs() < 1.0);
        assert_eq!(report.overruns, 0);
    }

    #[test]
    fn overruns_keep_the_first_tick_numbers_and_count_the_rest() {
        let mut recorder = LatencyRecorder::new();
        for i in 0..40 {
            recorder.record_overrun(100 + i, 2);
        }
        let report = recorder.report();
        assert_eq!((report.overruns, report.skipped_periods), (40, 80));
        assert_eq!(report.first_overruns, (100..116).collect::<Vec<u64>>());
        assert!(report.to_string().contains("first after tick 100, 101"));
    }

    #[test]
    fn a_value_beyond_the_range_is_kept_at_the_top() {
        let mut recorder = LatencyRecorder::new();
        recorder.record(u64::MAX, 0);
        assert!(recorder.report().wake.max_ns >= LONGEST_NS);
    }
}
