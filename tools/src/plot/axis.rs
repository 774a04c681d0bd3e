//! An axis: its range, scale and ticks.

use crate::words::{multiple, plain};

/// An axis of a plot.
#[derive(Debug, Clone)]
pub(crate) struct Axis {
    /// Name of the quantity, with its unit.
    pub label: String,
    low: f64,
    high: f64,
    log: bool,
}

/// A tick; minor ones have no text.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub value: f64,
    pub text: Option<String>,
}

impl Axis {
    /// A linear axis that includes zero and all of `values`.
    pub(crate) fn linear(label: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let (low, high) = range(values, |x| x.is_finite()).unwrap_or((0.0, 1.0));
        let (low, high) = (low.min(0.0), high.max(0.0));
        let high = if high > low { high } else { low + 1.0 };
        let room = 0.04 * (high - low);
        let low = if low < 0.0 { low - room } else { low };
        Self { label: label.into(), low, high: high + room, log: false }
    }

    /// A linear axis from `low` to `high`, without a margin.
    pub(crate) fn span(label: &str, low: f64, high: f64) -> Self {
        Self { label: label.into(), low, high, log: false }
    }

    /// A logarithmic axis that includes all positive `values`.
    pub(crate) fn log(label: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let (low, high) = range(values, |x| x.is_finite() && x > 0.0).unwrap_or((1.0, 10.0));
        // A margin for the markers, and a range of at least a decade: small differences must not appear
        // large.
        let widen = (10.0 / (high / low)).max(1.0).sqrt().max(1.35);
        Self { label: label.into(), low: low / widen, high: high * widen, log: true }
    }

    /// 0 at the low end, 1 at the high end. Values outside are clamped to the edge.
    pub(super) fn place(&self, value: f64) -> f64 {
        let place = if self.log {
            (value.max(f64::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        place.clamp(0.0, 1.0)
    }

    /// Whether a value lies within the range.
    pub(super) fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    pub(super) fn ticks(&self) -> Vec<Tick> {
        if self.log { self.decades() } else { self.steps() }
    }

    fn steps(&self) -> Vec<Tick> {
        // About six intervals at most, with a tolerance, so that the margin does not halve the number of
        // ticks.
        let rough = (self.high - self.low) / 5.5;
        let power = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].map(|n| n * power).into_iter().find(|s| *s >= rough).unwrap_or(rough);
        // With a tolerance for the rounding of an end that is a tick.
        let first = (self.low / step - 1e-6).ceil() as i64;
        (first..)
            .map(|n| n as f64 * step)
            .take_while(|value| *value <= self.high + 1e-6 * step)
            .map(|value| Tick { value, text: Some(multiple(value, step)) })
            .collect()
    }

    fn decades(&self) -> Vec<Tick> {
        let (from, to) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let whole = (from..=to).filter(|n| self.holds(10f64.powi(*n))).count();
        let named: &[u32] = match whole {
            0 | 1 => &[1, 2, 3, 5],
            2 => &[1, 3],
            _ => &[1],
        };
        let ticks = (from..=to).flat_map(|n| (1..=9u32).map(move |m| (m, f64::from(m) * 10f64.powi(n))));
        ticks
            .filter(|(_, value)| self.holds(*value))
            .map(|(m, value)| Tick { value, text: named.contains(&m).then(|| plain(value)) })
            .collect()
    }
}

fn range(values: impl IntoIterator<Item = f64>, counts: impl Fn(f64) -> bool) -> Option<(f64, f64)> {
    values.into_iter().filter(|x| counts(*x)).fold(None, |range, x| match range {
        None => Some((x, x)),
        Some((low, high)) => Some((low.min(x), high.max(x))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: &Axis) -> Vec<String> {
        axis.ticks().into_iter().filter_map(|tick| tick.text).collect()
    }

    #[test]
    fn ticks_are_round_numbers_within_the_range() {
        assert_eq!(texts(&Axis::linear("", [3.0, 41.0])), ["0", "10", "20", "30", "40"]);
        assert_eq!(texts(&Axis::log("", [0.5, 900.0])), ["1", "10", "100", "1,000"]);
        assert_eq!(texts(&Axis::log("", [20.0, 30.0])), ["10", "20", "30", "50"]);
        assert_eq!(texts(&Axis::span("", 3600.15, 3600.45)), ["3,600.2", "3,600.3", "3,600.4"]);
        assert_eq!(texts(&Axis::span("", 1.3, 1.7)), ["1.3", "1.4", "1.5", "1.6", "1.7"]);
        assert_eq!(texts(&Axis::linear("", [])), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
    }

    #[test]
    fn places_run_from_end_to_end_and_stay_inside() {
        let axis = Axis::log("", [1.0, 100.0]);
        assert!((axis.place(10.0) - 0.5).abs() < 1e-12);
        assert_eq!((axis.place(0.0), axis.place(1e9)), (0.0, 1.0));
        assert!(Axis::linear("", [-1.0, 1.0]).place(0.0) > 0.4);
    }
}
