//! Slew limit for a force that returns after the device has released it.
//!
//! The loop limits the slew of the force that it requests, and does not know when the device holds zero: a
//! torque ends with its validity, and a command that arrives late is rejected. Only replies show it. Without
//! a timely reply the device is assumed to hold zero, and the force slews from zero at the loop's slew rate.
//! This is not a fault, so nothing is latched.

use palpate_core::{Vec3, clamp_force};

/// The loop's slew limit, N/us.
const SLEW_N_PER_US: f32 = 1e-3;
/// Longest interval credited at once, us: a late command must not permit a large step.
const MAX_INTERVAL_US: u64 = 1_000;

/// State of the limiter.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct SlewLimiter {
    /// Send time of the newest acknowledged command, us.
    acknowledged_us: Option<u64>,
    limited_us: u64,
    /// Largest force permitted next.
    allowed_n: f32,
}

impl SlewLimiter {
    /// Records that the command sent at this time was executed.
    pub(super) fn acknowledged(&mut self, sent_us: u64) {
        self.acknowledged_us = self.acknowledged_us.max(Some(sent_us));
    }

    /// Limits a force whose command is valid for `valid_for_us`.
    pub(super) fn limit(&mut self, now_us: u64, force_n: Vec3, valid_for_us: u16) -> Vec3 {
        let is_over = |us: u64| now_us.saturating_sub(us) >= u64::from(valid_for_us);
        if self.acknowledged_us.is_none_or(is_over) {
            (self.allowed_n, self.limited_us) = (0.0, now_us.saturating_sub(MAX_INTERVAL_US));
        }
        let since_us = now_us.saturating_sub(self.limited_us).min(MAX_INTERVAL_US);
        (self.allowed_n, self.limited_us) = (self.allowed_n + SLEW_N_PER_US * since_us as f32, now_us);
        clamp_force(force_n, self.allowed_n).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::vec3;

    const FORCE_N: Vec3 = [0.0, 2.0, 1.5];

    #[test]
    fn a_released_force_returns_at_one_newton_per_millisecond() {
        let mut slew = SlewLimiter::default();
        let at = |slew: &mut SlewLimiter, ms: u64| {
            let force_n = vec3::norm(slew.limit(1_000 * ms, FORCE_N, 7_000));
            (10.0 * force_n).round() / 10.0
        };
        // No command is acknowledged yet, so it is unknown whether the first one was executed.
        assert_eq!([at(&mut slew, 10), at(&mut slew, 11)], [1.0, 1.0]);
        slew.acknowledged(11_000);
        assert_eq!([at(&mut slew, 12), at(&mut slew, 13), at(&mut slew, 14)], [2.0, 2.5, 2.5]);
        // Without a reply for less than the validity the device holds the force. After the validity it does
        // not.
        assert_eq!([at(&mut slew, 17), at(&mut slew, 18)], [2.5, 1.0]);
        slew.acknowledged(18_000);
        // Time without a command does not raise the limit.
        assert_eq!(at(&mut slew, 24), 2.0);
    }
}
