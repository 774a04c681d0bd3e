//! Limits of the force for the hand: magnitude, slew rate, ramp after arming, policy for stale samples.
//!
//! Each is a function or a state machine of its own; the controller applies them in order.

use crate::num::vec3::{self, Vec3};

/// Limits of one session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitConfig {
    /// Largest magnitude of the force for the hand, newtons.
    pub max_force_n: f32,
    /// Largest rate of change of the force for the hand, newtons per second.
    pub max_slew_n_per_s: f32,
    /// Time from arming to the full force, seconds; 0 for none.
    pub ramp_s: f32,
    /// Duration of the transition over a jump of the force, seconds; 0 for none.
    pub fade_s: f32,
    /// Number of ticks without a fresh sample in which the last command is held; then the force is zero.
    pub stale_hold_ticks: u32,
    /// Age of the newest sample at which a fault is latched, microseconds.
    pub stale_fault_us: u64,
    /// Largest absolute coordinate of the HIP in the model frame, metres; a larger one is a fault.
    pub max_position_m: f32,
    /// Largest speed of the HIP, metres per second; a larger one is a fault.
    pub max_speed_m_s: f32,
    /// Largest stiffness of the model that may be rendered, newtons per metre: that of the device divided by
    /// the metres of the model per metre of the device. Infinite for no limit.
    pub max_stiffness_n_m: f32,
}

impl Default for LimitConfig {
    fn default() -> Self {
        Self {
            max_force_n: 8.0,
            max_slew_n_per_s: 1000.0,
            ramp_s: 0.5,
            fade_s: 0.03,
            stale_hold_ticks: 3,
            stale_fault_us: 10_000,
            max_position_m: 0.5,
            max_speed_m_s: 2.0,
            max_stiffness_n_m: 3000.0,
        }
    }
}

/// Margin for rounding: a result computed in f32 never exceeds the exact limit.
const MARGIN: f32 = 1.0 - 4.0 * f32::EPSILON;

/// Limits the magnitude of a force to `max_n`, newtons, and keeps its direction. The second value is true if
/// the force was changed. A force that is not finite becomes zero.
pub fn clamp_force(force_n: Vec3, max_n: f32) -> (Vec3, bool) {
    if !vec3::is_finite(force_n) {
        return (vec3::ZERO, true);
    }
    if vec3::norm(force_n) <= max_n * MARGIN {
        return (force_n, false);
    }
    (vec3::scale(vec3::normalize_or_zero(force_n), max_n * MARGIN), true)
}

/// Moves a force from `previous_n` towards `target_n` by at most `max_step_n`, on a straight line.
///
/// Between two forces inside the ball of [`clamp_force`] a straight line stays inside; a limit per component
/// would not.
pub(crate) fn slew(previous_n: Vec3, target_n: Vec3, max_step_n: f32) -> Vec3 {
    let step = vec3::sub(target_n, previous_n);
    let length = vec3::norm(step);
    if length <= max_step_n {
        return target_n;
    }
    let fraction = (max_step_n / length * MARGIN).max(0.0);
    vec3::add(previous_n, vec3::scale(step, fraction))
}

/// Factor of the force after arming: linear from 0 to 1.
pub(crate) fn ramp(since_arming_us: u64, ramp_s: f32) -> f32 {
    let elapsed_s = since_arming_us as f32 * 1e-6;
    if elapsed_s >= ramp_s { 1.0 } else { (elapsed_s / ramp_s).max(0.0) }
}

/// The decision of the stale-sample policy on one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Freshness {
    /// The sample is new and is used.
    Fresh,
    /// No new sample for a few ticks: the last command is repeated.
    RepeatLast,
    /// No new sample for longer: the force is zero, but the contact is kept.
    SendZero,
    /// No new sample for the time of the fault limit: a fault.
    Fault,
}

/// The stale-sample policy.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct StaleWatch {
    newest_us: Option<u64>,
    /// Start of the wait for a sample: time of the newest, or of arming.
    since_us: u64,
    missed: u32,
}

impl StaleWatch {
    /// Starts the wait for a sample at `now_us`.
    pub(crate) fn new(now_us: u64) -> Self {
        Self { since_us: now_us, ..Self::default() }
    }

    /// Decides on one tick. `sample_us` is the time of the latest sample on the same clock as `now_us`.
    ///
    /// A sample is fresh if it is newer than the last one and younger than the fault limit. A repeated or an
    /// older sample counts as no sample.
    pub(crate) fn judge(&mut self, config: &LimitConfig, now_us: u64, sample_us: Option<u64>) -> Freshness {
        let newer = |sample_us: &u64| self.newest_us.is_none_or(|newest_us| *sample_us > newest_us);
        let young = |sample_us: &u64| now_us.saturating_sub(*sample_us) < config.stale_fault_us;
        if let Some(sample_us) = sample_us.filter(newer).filter(young) {
            // A sample from the future must not postpone the fault.
            *self = Self { newest_us: Some(sample_us), since_us: sample_us.min(now_us), missed: 0 };
            return Freshness::Fresh;
        }
        self.missed = self.missed.saturating_add(1);
        if now_us.saturating_sub(self.since_us) >= config.stale_fault_us {
            Freshness::Fault
        } else if self.missed <= config.stale_hold_ticks {
            Freshness::RepeatLast
        } else {
            Freshness::SendZero
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exact_norm(v: Vec3) -> f64 {
        v.map(f64::from).iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    #[test]
    fn clamp_never_exceeds_the_limit_and_keeps_the_direction() {
        let mut bits = 1_u32;
        for _ in 0..200_000 {
            let mut next = || {
                bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f32::from_bits(bits)
            };
            let (force_n, limit_n) = ([next(), next(), next()], next().abs());
            if !(limit_n.is_normal() && limit_n > 1e-30) {
                continue;
            }
            let (clamped_n, was) = clamp_force(force_n, limit_n);
            assert!(exact_norm(clamped_n) <= f64::from(limit_n), "{force_n:?} {limit_n}");
            if !was {
                assert_eq!(clamped_n, force_n);
            } else if vec3::is_finite(force_n) {
                let apart = vec3::sub(vec3::normalize_or_zero(force_n), vec3::normalize_or_zero(clamped_n));
                assert!(vec3::norm(apart) < 1e-6, "{force_n:?} -> {clamped_n:?}");
            }
        }
        assert_eq!(clamp_force([f32::NAN, 0.0, 0.0], 8.0), (vec3::ZERO, true));
        assert_eq!(clamp_force([f32::INFINITY, 0.0, 0.0], 8.0), (vec3::ZERO, true));
        assert!(
            exact_norm(clamp_force([3e38; 3], 8.0).0) > 7.999,
            "|force| overflows, its direction does not"
        );
    }

    #[test]
    fn slew_is_straight_and_reaches_the_target() {
        let (from, to) = ([1.0, 0.0, 0.0], [1.0, 3.0, 4.0]);
        let mut force = from;
        for step in 1..=5 {
            let next = slew(force, to, 1.0);
            assert!((vec3::distance(force, next) - 1.0).abs() < 1e-5, "step {step}");
            assert!((next[1] * 4.0 - next[2] * 3.0).abs() < 1e-5, "on the line");
            force = next;
        }
        assert_eq!(slew(force, to, 1.0), to);
        assert_eq!(slew(from, to, 0.0), from);
    }

    #[test]
    fn ramp_is_linear_from_zero_to_one() {
        assert_eq!(
            (ramp(0, 0.5), ramp(250_000, 0.5), ramp(500_000, 0.5), ramp(u64::MAX, 0.5)),
            (0.0, 0.5, 1.0, 1.0)
        );
        assert_eq!(ramp(0, 0.0), 1.0, "no ramp");
    }

    #[test]
    fn stale_samples_hold_then_zero_then_fault() {
        let config = LimitConfig::default();
        let mut watch = StaleWatch::new(0);
        assert_eq!(watch.judge(&config, 1000, Some(900)), Freshness::Fresh);
        for tick in 2..=4 {
            assert_eq!(watch.judge(&config, tick * 1000, None), Freshness::RepeatLast);
        }
        assert_eq!(watch.judge(&config, 5000, Some(900)), Freshness::SendZero, "repeated");
        assert_eq!(watch.judge(&config, 6000, Some(800)), Freshness::SendZero, "older");
        assert_eq!(watch.judge(&config, 10_899, None), Freshness::SendZero);
        assert_eq!(watch.judge(&config, 10_900, None), Freshness::Fault, "10 ms after the sample was taken");
        assert_eq!(watch.judge(&config, 11_000, Some(11_000)), Freshness::Fresh);
        // A sample as old as the fault limit is a fault, although newer than the last one. As the first
        // sample it counts as no sample.
        assert_eq!(watch.judge(&config, 40_000, Some(30_000)), Freshness::Fault);
        assert_eq!(StaleWatch::new(40_000).judge(&config, 40_000, Some(30_000)), Freshness::RepeatLast);
        let mut watch = StaleWatch::new(11_000);
        // A clock that is ahead must not postpone the fault.
        assert_eq!(watch.judge(&config, 12_000, Some(1_000_000)), Freshness::Fresh);
        assert_eq!(watch.judge(&config, 22_000, None), Freshness::Fault);
    }
}
