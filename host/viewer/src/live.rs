//! Statistics for the overlay from the drained records: history of force and lateness, recent timing.

use palpate_core::vec3;
use palpate_host::rt::TickRecord;
use std::collections::VecDeque;

/// Time interval of one point of the strip chart, us.
const BIN_US: u64 = 20_000;
/// Time span of the strip chart, us.
pub const SPAN_US: u64 = 8_000_000;
/// Number of ticks in the timing statistics.
const RECENT_TICKS: usize = 1_000;

/// Worst values of one point of the strip charts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moment {
    /// Largest |h|, N.
    pub reaction_n: f32,
    /// Largest force for the hand, N.
    pub hand_force_n: f32,
    /// Largest start of a tick minus its deadline, ns.
    pub lateness_ns: u64,
}

impl Moment {
    fn of(record: &TickRecord) -> Self {
        Self {
            reaction_n: vec3::norm(record.reaction_n),
            hand_force_n: vec3::norm(record.hand_force_n),
            lateness_ns: record.lateness_ns,
        }
    }

    fn or_worse(self, other: Self) -> Self {
        Self {
            reaction_n: self.reaction_n.max(other.reaction_n),
            hand_force_n: self.hand_force_n.max(other.hand_force_n),
            lateness_ns: self.lateness_ns.max(other.lateness_ns),
        }
    }
}

/// State of the overlay besides the newest record.
#[derive(Debug, Clone)]
pub struct Live {
    /// (bin number, worst values in it).
    bins: VecDeque<(u64, Moment)>,
    compute_ns: VecDeque<u64>,
    lateness_ns: VecDeque<u64>,
    scratch: Vec<u64>,
    peak_n: f32,
}

impl Default for Live {
    fn default() -> Self {
        Self::new()
    }
}

impl Live {
    /// Without records.
    #[must_use]
    pub fn new() -> Self {
        Self {
            bins: VecDeque::with_capacity((SPAN_US / BIN_US) as usize + 2),
            compute_ns: VecDeque::with_capacity(RECENT_TICKS + 1),
            lateness_ns: VecDeque::with_capacity(RECENT_TICKS + 1),
            scratch: Vec::with_capacity(RECENT_TICKS),
            peak_n: 0.0,
        }
    }

    /// Adds one record. Records come in order.
    pub fn push(&mut self, record: &TickRecord) {
        let moment = Moment::of(record);
        let bin = record.t_us / BIN_US;
        match self.bins.back_mut() {
            Some((last, worst)) if *last == bin => *worst = worst.or_worse(moment),
            _ => self.bins.push_back((bin, moment)),
        }
        while self.bins.front().is_some_and(|(first, _)| (bin - first) * BIN_US > SPAN_US) {
            self.bins.pop_front();
        }
        self.peak_n = self.peak_n.max(moment.reaction_n);
        for (recent, value) in
            [(&mut self.compute_ns, record.compute_ns), (&mut self.lateness_ns, record.lateness_ns)]
        {
            if recent.len() == RECENT_TICKS {
                recent.pop_front();
            }
            recent.push_back(value);
        }
    }

    /// Points of the strip charts with their age in seconds, oldest first.
    pub fn history(&self) -> impl Iterator<Item = (f32, &Moment)> {
        let newest = self.bins.back().map_or(0, |(bin, _)| *bin);
        self.bins.iter().map(move |(bin, moment)| ((newest - bin) as f32 * BIN_US as f32 * 1e-6, moment))
    }

    /// Largest |h| of the whole run, N.
    #[must_use]
    pub const fn peak_n(&self) -> f32 {
        self.peak_n
    }

    /// 99th percentile of the compute time of the recent ticks, us.
    pub fn compute_p99_us(&mut self) -> f32 {
        p99_us(&self.compute_ns, &mut self.scratch)
    }

    /// 99th percentile of the lateness of the recent ticks, us.
    pub fn lateness_p99_us(&mut self) -> f32 {
        p99_us(&self.lateness_ns, &mut self.scratch)
    }
}

fn p99_us(recent: &VecDeque<u64>, scratch: &mut Vec<u64>) -> f32 {
    if recent.is_empty() {
        return 0.0;
    }
    scratch.clear();
    scratch.extend(recent);
    let rank = (scratch.len() * 99).div_ceil(100) - 1;
    *scratch.select_nth_unstable(rank).1 as f32 * 1e-3
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(tick: u64, force_n: f32) -> TickRecord {
        TickRecord {
            tick,
            t_us: tick * 1_000,
            reaction_n: [0.0, 0.0, -force_n],
            compute_ns: 1_000 * (tick % 100 + 1),
            ..TickRecord::EMPTY
        }
    }

    #[test]
    fn the_history_is_bounded_and_keeps_peaks() {
        let mut live = Live::new();
        for tick in 0..30_000 {
            live.push(&record(tick, if tick == 29_990 { 7.0 } else { 1.0 }));
        }
        let points: Vec<(f32, f32)> =
            live.history().map(|(age_s, moment)| (age_s, moment.reaction_n)).collect();
        assert!(points.len() <= (SPAN_US / BIN_US) as usize + 1);
        assert!(points[0].0 <= 8.0 && points[0].0 > 7.9);
        assert_eq!(points.last(), Some(&(0.0, 7.0)));
        assert_eq!(live.peak_n(), 7.0);
    }

    #[test]
    fn the_percentile_is_the_99th() {
        let mut live = Live::new();
        assert_eq!(live.compute_p99_us(), 0.0);
        for tick in 0..5_000 {
            live.push(&record(tick, 0.0));
        }
        assert!((live.compute_p99_us() - 99.0).abs() < 1e-3);
        assert_eq!(live.lateness_p99_us(), 0.0);
    }
}
