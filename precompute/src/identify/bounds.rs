//! Bounds of a constant by a change of variable, so that the least-squares problem has none.
//!
//! none          theta = theta0 + s t,   s = max(|theta0|, 1)
//! above zero    theta = theta0 exp(t)
//! low only      theta = low - s + s sqrt(t^2 + 1)
//! high only     theta = high + s - s sqrt(t^2 + 1)
//! both          theta = low + (high - low) (1 + sin t) / 2
//!
//! Source: the transformations of MINUIT (James and Roos 1975).

/// Lowest and highest value of a constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Infinite if there is none. Zero is exclusive: no constant that has it as its lower bound reaches it.
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

/// A constant with its change of variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Variable {
    initial: f64,
    bounds: Bounds,
}

impl Variable {
    /// Begins at `initial`, which is within the bounds.
    pub(super) fn new(initial: f64, bounds: Bounds) -> Self {
        Self { initial, bounds }
    }

    fn scale(&self) -> f64 {
        self.initial.abs().max(1.0)
    }

    /// The variable at the initial value.
    pub(super) fn start(&self) -> f64 {
        let Bounds { low, high } = self.bounds;
        // The slope is zero at a bound: begin a little inside.
        let from = |distance: f64| {
            let root = 1.0 + (distance / self.scale()).max(1e-3);
            (root * root - 1.0).sqrt()
        };
        match (low.is_finite() && low != 0.0, high.is_finite()) {
            (_, true) if low.is_finite() => {
                let share = ((self.initial - low) / (high - low)).clamp(1e-3, 1.0 - 1e-3);
                libm::asin(2.0 * share - 1.0)
            }
            (_, true) => from(high - self.initial),
            (true, false) => from(self.initial - low),
            (false, false) => 0.0,
        }
    }

    /// The constant and its slope at a value of the variable.
    pub(super) fn at(&self, t: f64) -> (f64, f64) {
        let (Bounds { low, high }, s) = (self.bounds, self.scale());
        let root = (t * t + 1.0).sqrt();
        match (low.is_finite(), high.is_finite()) {
            (true, true) => {
                let half = 0.5 * (high - low);
                (low + half * (1.0 + libm::sin(t)), half * libm::cos(t))
            }
            (true, false) if low == 0.0 => {
                let value = self.initial * libm::exp(t);
                (value, value)
            }
            (true, false) => (low + s * (root - 1.0), s * t / root),
            (false, true) => (high - s * (root - 1.0), -s * t / root),
            (false, false) => (self.initial + s * t, s),
        }
    }

    /// Whether a value is at one of the bounds.
    pub(super) fn is_at_bound(&self, value: f64) -> bool {
        let near = |bound: f64| {
            bound.is_finite() && (value - bound).abs() <= REACHED * self.scale().max(bound.abs())
        };
        near(self.bounds.low) || near(self.bounds.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_change_of_variable_begins_at_the_value_and_has_its_slope() {
        let inf = f64::INFINITY;
        for (low, high) in
            [(-inf, inf), (0.0, inf), (100.0, inf), (-inf, 9000.0), (0.0, 9000.0), (100.0, 9000.0)]
        {
            let variable = Variable::new(1300.0, Bounds { low, high });
            let t = variable.start();
            assert!((variable.at(t).0 - 1300.0).abs() < 1e-9, "{low} {high}: {}", variable.at(t).0);
            for t in [t, t + 0.3, t - 0.4, t + 8.0] {
                let (value, slope) = variable.at(t);
                let difference = (variable.at(t + 1e-6).0 - variable.at(t - 1e-6).0) / 2e-6;
                assert!((slope - difference).abs() < 1e-6 * (1.0 + value.abs()), "{low} {high} at {t}");
                assert!((low..=high).contains(&value), "{low} {high}: {value}");
            }
        }
        assert!(Variable::new(5.0, Bounds { low: 5.0, high: 9.0 }).is_at_bound(5.0));
        assert!(!Variable::new(5.0, Bounds::default()).is_at_bound(5.0));
    }
}
