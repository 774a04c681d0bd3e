//! Timing of the loop: wake-up lateness, device and controller times in preallocated histograms, and missed
//! deadlines.

use super::histogram::{Histograms, Quantity, TickTimes};
use core::fmt;
use hdrhistogram::Histogram;

/// Number of missed deadlines to keep, of the first ones and of the worst ones.
pub const KEPT_MISSES: usize = 16;

/// A tick that ended after the next deadline, and its times.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Miss {
    /// Number of the tick.
    pub tick: u64,
    /// Number of deadlines skipped because of it.
    pub skipped: u64,
    /// From the first deadline that passed to the end of the tick.
    pub late_ns: u64,
    /// Times of the tick; the largest shows the cause.
    pub times: TickTimes,
}

/// Recorder used inside the loop. Every method is allocation-free after `new`.
#[derive(Debug, Clone)]
pub struct LatencyRecorder {
    histograms: Histograms,
    overruns: u64,
    skipped_periods: u64,
    last: TickTimes,
    first: [Miss; KEPT_MISSES],
    /// The first [`KEPT_MISSES`] fill the list. Then each worse miss replaces the smallest.
    worst: [Miss; KEPT_MISSES],
}

impl Default for LatencyRecorder {
    fn default() -> Self {
        Self::new()
    }
}

impl LatencyRecorder {
    /// Allocates the histograms.
    #[must_use]
    pub fn new() -> Self {
        Self {
            histograms: Histograms::new(),
            overruns: 0,
            skipped_periods: 0,
            last: TickTimes::default(),
            first: [Miss::default(); KEPT_MISSES],
            worst: [Miss::default(); KEPT_MISSES],
        }
    }

    /// Records one tick.
    pub fn record(&mut self, times: TickTimes) {
        self.last = times;
        self.histograms.record(times);
    }

    /// Records that `skipped` deadlines had passed at the end of `tick`, the last recorded one; the first of
    /// them passed `late_ns` before.
    pub fn record_overrun(&mut self, tick: u64, skipped: u64, late_ns: u64) {
        let miss = Miss { tick, skipped, late_ns, times: self.last };
        match (self.first.get_mut(self.overruns as usize), self.worst.get_mut(self.overruns as usize)) {
            (Some(first), Some(worst)) => (*first, *worst) = (miss, miss),
            _ => {
                // The smallest, and the latest of equal ones: of equal misses the earlier stays.
                let smallest = self.worst.iter_mut().rev().min_by_key(|kept| kept.late_ns);
                if let Some(smallest) = smallest.filter(|smallest| smallest.late_ns < late_ns) {
                    *smallest = miss;
                }
            }
        }
        self.overruns += 1;
        self.skipped_periods += skipped;
    }

    /// The statistics so far.
    #[must_use]
    pub fn report(&self) -> LatencyReport {
        let kept = self.first.len().min(self.overruns as usize);
        let mut worst = self.worst[..kept].to_vec();
        worst.sort_by_key(|miss| (core::cmp::Reverse(miss.late_ns), miss.tick));
        let of = |quantity| Percentiles::of(self.histograms.of(quantity));
        LatencyReport {
            wake: of(Quantity::Wake),
            device: of(Quantity::Device),
            compute: of(Quantity::Compute),
            overruns: self.overruns,
            skipped_periods: self.skipped_periods,
            first_overruns: self.first[..kept].iter().map(|miss| miss.tick).collect(),
            worst,
            histograms: self.histograms.clone(),
        }
    }
}

/// Percentiles of one histogram, ns.
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

/// Timing statistics of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct LatencyReport {
    /// Wake-up lateness against the deadline.
    pub wake: Percentiles,
    /// Exchange with the device.
    pub device: Percentiles,
    /// The controller's tick, without the device.
    pub compute: Percentiles,
    /// Ticks that ended after the next deadline.
    pub overruns: u64,
    /// Number of deadlines skipped because of them.
    pub skipped_periods: u64,
    /// Tick numbers of the first overruns.
    pub first_overruns: Vec<u64>,
    /// The worst overruns, the worst first.
    pub worst: Vec<Miss>,
    /// The complete histograms.
    pub histograms: Histograms,
}

impl fmt::Display for LatencyReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "ticks        {}", self.wake.count)?;
        writeln!(f, "wake-up late {}", self.wake)?;
        writeln!(f, "device       {}", self.device)?;
        writeln!(f, "compute      {}", self.compute)?;
        write!(f, "missed       {} deadlines in {} overruns", self.skipped_periods, self.overruns)?;
        if let Some((first, rest)) = self.first_overruns.split_first() {
            write!(f, ", first after tick {first}")?;
            for tick in rest.iter().take(4) {
                write!(f, ", {tick}")?;
            }
        }
        if let Some(Miss { tick, late_ns, times, .. }) = self.worst.first() {
            let ms = |ns: &u64| *ns as f64 * 1e-6;
            write!(
                f,
                "\nworst miss   tick {tick}: {:.2} ms past the next deadline (woken {:.2} ms late, device {:.2} ms, compute {:.2} ms)",
                ms(late_ns),
                ms(&times.wake_ns),
                ms(&times.device_ns),
                ms(&times.compute_ns)
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::histogram::MAX_NS;
    use super::*;

    fn times(wake_ns: u64, device_ns: u64, compute_ns: u64) -> TickTimes {
        TickTimes { wake_ns, device_ns, compute_ns }
    }

    #[test]
    fn percentiles_of_a_known_distribution() {
        let mut recorder = LatencyRecorder::new();
        for i in 1..=1000_u64 {
            recorder.record(times(i * 1_000, 7_000, 500));
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
        assert!(
            (report.device.mean_ns - 7_000.0).abs() < 10.0,
            "the device time is not part of the compute time"
        );
        assert_eq!(report.overruns, 0);
    }

    #[test]
    fn overruns_keep_the_first_tick_numbers_and_count_the_rest() {
        let mut recorder = LatencyRecorder::new();
        for i in 0..40 {
            recorder.record_overrun(100 + i, 2, 1);
        }
        let report = recorder.report();
        assert_eq!((report.overruns, report.skipped_periods), (40, 80));
        assert_eq!(report.first_overruns, (100..116).collect::<Vec<u64>>());
        assert!(report.to_string().contains("first after tick 100, 101"));
    }

    /// In any order of lateness: the sixteen worst, the worst first, each with the times of its own tick.
    #[test]
    fn the_worst_overruns_are_kept_with_the_times_of_their_tick() {
        let mut recorder = LatencyRecorder::new();
        let late_ns = |i: u64| 1 + (i * 37) % 100;
        for i in 0..100 {
            recorder.record(times(i, 2 * i, 3 * i));
            recorder.record_overrun(i, 1, late_ns(i));
        }
        let report = recorder.report();
        let kept: Vec<u64> = report.worst.iter().map(|miss| miss.late_ns).collect();
        assert_eq!(kept, (85..=100).rev().collect::<Vec<u64>>());
        for miss in &report.worst {
            assert_eq!(miss.late_ns, late_ns(miss.tick));
            assert_eq!(miss.times, times(miss.tick, 2 * miss.tick, 3 * miss.tick));
        }
        // Of equal misses the earliest stay.
        let mut same = LatencyRecorder::new();
        (0..30).for_each(|i| same.record_overrun(i, 1, 5));
        let ticks: Vec<u64> = same.report().worst.iter().map(|miss| miss.tick).collect();
        assert_eq!(ticks, (0..16).collect::<Vec<u64>>());
    }

    #[test]
    fn a_value_beyond_the_range_is_kept_at_the_top() {
        let mut recorder = LatencyRecorder::new();
        recorder.record(times(u64::MAX, 0, 0));
        assert!(recorder.report().wake.max_ns >= MAX_NS);
    }
}
