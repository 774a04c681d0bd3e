//! Z-width: the largest stiffness at which the loop of hand, device and renderer stays passive.
//!
//! [`ideal`] is the textbook case, a mass with damping at a wall, which has a known bound. [`emulated`] has the
//! mechanism, encoder, delays and motors of a device profile, and the controller of a session.

mod emulated;
mod ideal;
mod section;

pub(super) use section::{
    COLUMNS, DAMPING, DEVICES, KEY, RATES_HZ, SPRINGS, WALL, damping_rows, device_rows, section,
};

/// Largest value in `low` .. `high` up to which `is_passive` holds: a scan upwards by steps of `factor`, then
/// bisection to a relative error of `close`. `None` if it does not hold at `low`.
fn largest(
    low: f64,
    high: f64,
    factor: f64,
    close: f64,
    mut is_passive: impl FnMut(f64) -> bool,
) -> Option<f64> {
    if !is_passive(low) {
        return None;
    }
    let (mut good, mut bad) = (low, low * factor);
    while is_passive(bad) {
        if bad >= high {
            return Some(high);
        }
        (good, bad) = (bad, (bad * factor).min(high));
    }
    while bad / good > 1.0 + close {
        let middle = (good * bad).sqrt();
        if is_passive(middle) { good = middle } else { bad = middle }
    }
    Some((good * bad).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_found_and_its_absence_too() {
        let found = |limit: f64| largest(10.0, 1e5, 1.5, 1e-3, |k| k < limit);
        for limit in [11.0, 1234.5, 9.9e4] {
            let k = found(limit).expect("passive at the low end");
            assert!((k / limit - 1.0).abs() < 1e-3, "{k} for {limit}");
        }
        assert_eq!((found(5.0), found(1e9)), (None, Some(1e5)));
    }
}
