//! The three histograms of a run, as table rows and as text bars.

use core::fmt;
use hdrhistogram::Histogram;
use serde::Serialize;

/// Upper end of the range; longer times are counted at this value.
pub const MAX_NS: u64 = 10_000_000_000;

/// Times of one tick, ns.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TickTimes {
    /// Start of the tick minus its deadline.
    pub wake_ns: u64,
    /// Exchange with the device.
    pub device_ns: u64,
    /// Requests and controller together.
    pub compute_ns: u64,
}

/// A measured quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Wake-up: start of a tick minus its deadline.
    Wake,
    /// Exchange with the device.
    Device,
    /// The controller's tick.
    Compute,
}

impl Quantity {
    /// All quantities.
    pub const ALL: [Self; 3] = [Self::Wake, Self::Device, Self::Compute];

    /// Name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Wake => "wake",
            Self::Device => "device",
            Self::Compute => "compute",
        }
    }

    const fn title(self) -> &'static str {
        match self {
            Self::Wake => "wake-up lateness",
            Self::Device => "device exchange",
            Self::Compute => "controller",
        }
    }
}

/// One bin of a histogram.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HistogramRow {
    /// `wake`, `device` or `compute`.
    pub quantity: &'static str,
    /// Upper end of the bin (three significant digits), ns.
    pub ns: u64,
    /// Ticks in the bin.
    pub count: u64,
    /// Cumulative share of the ticks up to and including this bin.
    pub share: f64,
}

/// Histograms of the times of every tick: three significant digits from 1 ns to 10 s. Recording does not
/// allocate.
#[derive(Debug, Clone, PartialEq)]
pub struct Histograms {
    wake: Histogram<u64>,
    device: Histogram<u64>,
    compute: Histogram<u64>,
}

impl Default for Histograms {
    fn default() -> Self {
        Self::new()
    }
}

impl Histograms {
    /// Empty histograms.
    #[must_use]
    pub fn new() -> Self {
        let empty = Histogram::new_with_bounds(1, MAX_NS, 3).expect("the bounds are constants and valid");
        Self { wake: empty.clone(), device: empty.clone(), compute: empty }
    }

    /// Counts one tick.
    pub fn record(&mut self, times: TickTimes) {
        self.wake.saturating_record(times.wake_ns);
        self.device.saturating_record(times.device_ns);
        self.compute.saturating_record(times.compute_ns);
    }

    /// The histogram of a quantity.
    #[must_use]
    pub const fn of(&self, quantity: Quantity) -> &Histogram<u64> {
        match quantity {
            Quantity::Wake => &self.wake,
            Quantity::Device => &self.device,
            Quantity::Compute => &self.compute,
        }
    }

    /// All bins that are not empty, by quantity and ascending value.
    #[must_use]
    pub fn rows(&self) -> Vec<HistogramRow> {
        let mut rows = Vec::new();
        for quantity in Quantity::ALL {
            let histogram = self.of(quantity);
            let mut up_to = 0;
            rows.extend(histogram.iter_recorded().map(|bin| {
                let count = bin.count_since_last_iteration();
                up_to += count;
                let share = up_to as f64 / histogram.len() as f64;
                HistogramRow { quantity: quantity.name(), ns: bin.value_iterated_to(), count, share }
            }));
        }
        rows
    }

    /// Bars of all three, in bins of 1, 2 and 5 times a power of ten.
    #[must_use]
    pub const fn bars(&self) -> Bars<'_> {
        Bars(self)
    }
}

/// Width of the longest bar, characters.
const BAR_WIDTH: f64 = 44.0;

/// Histograms as text. The length of a bar is logarithmic in the count, so that one tick in a million is
/// visible.
#[derive(Debug, Clone, Copy)]
pub struct Bars<'h>(&'h Histograms);

impl fmt::Display for Bars<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, quantity) in Quantity::ALL.into_iter().enumerate() {
            if index > 0 {
                writeln!(f)?;
            }
            write!(f, "{} (ticks by time; bar length is logarithmic)", quantity.title())?;
            let bins = coarse(self.0.of(quantity));
            let largest = bins.iter().map(|(_, count)| *count).max().unwrap_or(0);
            for (below_ns, count) in bins {
                let length = BAR_WIDTH * (1.0 + count as f64).log2() / (1.0 + largest as f64).log2();
                // A count above zero is always visible.
                let length = if count > 0 { length.round().max(1.0) as usize } else { 0 };
                write!(f, "\n  < {:>7} {count:>9} {}", Duration(below_ns), "\u{2588}".repeat(length))?;
            }
        }
        Ok(())
    }
}

/// Upper ends and counts of the coarse bins, from the first to the last that is not empty.
fn coarse(histogram: &Histogram<u64>) -> Vec<(u64, u64)> {
    let mut bins: Vec<(u64, u64)> = Vec::new();
    let ends = (0..=10).flat_map(|decade| [1, 2, 5].map(|digit| digit * 10_u64.pow(decade)));
    let mut recorded = histogram.iter_recorded().peekable();
    for below_ns in ends {
        let mut count = 0;
        while let Some(bin) = recorded.next_if(|bin| bin.value_iterated_to() < below_ns) {
            count += bin.count_since_last_iteration();
        }
        if count > 0 || !bins.is_empty() {
            bins.push((below_ns, count));
        }
    }
    while bins.last().is_some_and(|(_, count)| *count == 0) {
        bins.pop();
    }
    bins
}

/// A time formatted with a suitable unit.
struct Duration(u64);

impl fmt::Display for Duration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self.0 {
            ns if ns < 1_000 => format!("{ns} ns"),
            ns if ns < 1_000_000 => format!("{} us", ns / 1_000),
            ns if ns < 1_000_000_000 => format!("{} ms", ns / 1_000_000),
            ns => format!("{} s", ns / 1_000_000_000),
        };
        f.pad(&text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled() -> Histograms {
        let mut histograms = Histograms::new();
        for i in 0..1_000_u64 {
            let wake_ns = if i == 999 { 3_000_000 } else { 700 };
            histograms.record(TickTimes { wake_ns, device_ns: 40_000, compute_ns: i });
        }
        histograms
    }

    #[test]
    fn the_rows_count_every_tick_once_and_their_shares_end_at_one() {
        let rows = filled().rows();
        for quantity in Quantity::ALL {
            let of: Vec<&HistogramRow> = rows.iter().filter(|row| row.quantity == quantity.name()).collect();
            assert_eq!(of.iter().map(|row| row.count).sum::<u64>(), 1_000);
            assert!(of.windows(2).all(|pair| pair[0].ns < pair[1].ns && pair[0].share < pair[1].share));
            assert!((of.last().expect("ticks").share - 1.0).abs() < 1e-12);
        }
        let wake: Vec<(u64, u64)> =
            rows.iter().filter(|row| row.quantity == "wake").map(|row| (row.ns, row.count)).collect();
        assert_eq!((wake.len(), wake[0]), (2, (700, 999)));
        // Three significant digits.
        assert!((wake[1].0 as f64 / 3e6 - 1.0).abs() < 1e-3 && wake[1].1 == 1);
    }

    #[test]
    fn a_single_late_tick_among_a_thousand_is_visible() {
        let text = filled().bars().to_string();
        let line =
            |start: &str| text.lines().find(|line| line.trim_start().starts_with(start)).map(str::to_string);
        let common = line("<    1 us       999").expect("the common bin");
        let rare = line("<    5 ms         1").expect("the rare bin");
        let bar = |line: &str| line.chars().filter(|c| *c == '\u{2588}').count();
        assert_eq!((bar(&common), bar(&rare)), (44, 4), "{text}");
        let empty = line("<  500 us         0").expect("a gap is shown");
        assert_eq!(bar(&empty), 0);
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    }

    #[test]
    fn empty_histograms_have_no_rows_and_no_bars() {
        let none = Histograms::new();
        assert!(none.rows().is_empty());
        assert_eq!(none.bars().to_string().lines().count(), 3);
    }
}
