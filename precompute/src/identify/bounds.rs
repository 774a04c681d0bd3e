//! Bounds of a constant by a change of variable, so that the least-squares problem has none.
//!
//! none          theta = theta0 + s t, with a scale s
//! above zero    theta = theta0 exp(t), for constants that cannot be zero
//! low only      theta = low - s + s sqrt(t^2 + 1)
//! high only     theta = high + s - s sqrt(t^2 + 1)
//! both          theta = low + (high - low) (1 + sin t) / 2
//!
//! Source: the transformations of MINUIT (James and Roos 1975).

/// Lowest and highest value of a constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Infinite if there is none.
    pub low: f64,
    /// Infinite if there is none.
    pub high: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { low: f64::NEG_INFINITY, high: f64::INFINITY }
    }
}

/// A bound counts as reached within this share of the value.
const REACHED: f64 = 1e-6;

/// A fit begins at least this far inside a bound, in scales: at the bound the slope is zero.
const INSIDE: f64 = 1e-2;

/// A constant with its change of variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Variable {
    initial: f64,
    bounds: Bounds,
    scale: f64,
    is_positive: bool,
}

impl Variable {
    /// Begins at `initial`, which is within the bounds; `scale` is a typical change. A positive constant is above zero
    /// by its nature.
    pub(super) fn new(initial: f64, bounds: Bounds, scale: f64, is_positive: bool) -> Self {
        let is_positive = is_positive && bounds.low == 0.0 && bounds.high.is_infinite();
        Self { initial, bounds, scale, is_positive }
    }

    /// The variable at the initial value.
    pub(super) fn start(&self) -> f64 {
        let Bounds { low, high } = self.bounds;
        let from = |distance: f64| {
            let root = 1.0 + (distance / self.scale).max(INSIDE);
            (root * root - 1.0).sqrt()
        };
        match (low.is_finite(), high.is_finite()) {
            _ if self.is_positive => 0.0,
            (true, true) => {
                let share = ((self.initial - low) / (high - low)).clamp(INSIDE, 1.0 - INSIDE);
                libm::asin(2.0 * share - 1.0)
            }
            (false, true) => from(high - self.initial),
            (true, false) => from(self.initial - low),
            (false, false) => 0.0,
        }
    }

    /// The constant and its slope at a value of the variable.
    pub(super) fn at(&self, t: f64) -> (f64, f64) {
        let (Bounds { low, high }, s) = (self.bounds, self.scale);
        let root = (t * t + 1.0).sqrt();
        if self.is_positive {
            let value = self.initial * libm::exp(t);
            return (value, value);
        }
        match (low.is_finite(), high.is_finite()) {
            (true, true) => {
                let half = 0.5 * (high - low);
                (low + half * (1.0 + libm::sin(t)), half * libm::cos(t))
            }
            (true, false) => (low + s * (root - 1.0), s * t / root),
            (false, true) => (high - s * (root - 1.0), -s * t / root),
            (false, false) => (self.initial + s * t, s),
        }
    }

    /// Whether a value is at one of the bounds.
    pub(super) fn is_at_bound(&self, value: f64) -> bool {
        let near =
            |bound: f64| bound.is_finite() && (value - bound).abs() <= REACHED * self.scale.max(bound.abs());
        near(self.bounds.low) || near(self.bounds.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_change_of_variable_begins_at_the_value_and_has_its_slope() {
        let inf = f64::INFINITY;
        for (low, high, is_positive) in [
            (-inf, inf, false),
            (0.0, inf, true),
            (0.0, inf, false),
            (100.0, inf, true),
            (-inf, 9000.0, false),
            (0.0, 9000.0, true),
            (100.0, 9000.0, false),
        ] {
            let variable = Variable::new(1300.0, Bounds { low, high }, 1300.0, is_positive);
            let t = variable.start();
            assert!((variable.at(t).0 - 1300.0).abs() < 1e-9, "{low} {high}: {}", variable.at(t).0);
            for t in [t, t + 0.3, t - 0.4, t + 8.0] {
                let (value, slope) = variable.at(t);
                let difference = (variable.at(t + 1e-6).0 - variable.at(t - 1e-6).0) / 2e-6;
                assert!((slope - difference).abs() < 1e-6 * (1.0 + value.abs()), "{low} {high} at {t}");
                assert!((low..=high).contains(&value), "{low} {high}: {value}");
            }
        }
    }

    #[test]
    fn a_fit_begins_inside_a_bound_and_a_value_at_it_is_known() {
        let low = |low, high| Variable::new(low, Bounds { low, high }, 100.0, false);
        assert!((low(5.0, 9.0).at(low(5.0, 9.0).start()).0 - 5.04).abs() < 1e-9);
        let above = low(0.0, f64::INFINITY);
        assert!((above.at(above.start()).0 - 1.0).abs() < 1e-9 && above.at(above.start()).1 > 10.0);
        assert!(low(5.0, 9.0).is_at_bound(5.0) && !low(5.0, 9.0).is_at_bound(5.1));
        assert!(!Variable::new(5.0, Bounds::default(), 5.0, false).is_at_bound(5.0));
    }
}
