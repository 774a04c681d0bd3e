//! What stands between the model's force and the hand: magnitude, slew, ramp after arming, and stale samples.
//!
//! Each is a small function or state machine of its own; the controller puts them in order.

use crate::vec3::{self, Vec3};

/// Limits of one session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitConfig {
    /// Largest |force| for the hand, newtons.
    pub max_force_n: f32,
    /// Largest change of the force for the hand, newtons a second.
    pub max_slew_n_per_s: f32,
    /// Time from arming to the full force, seconds.
    pub ramp_s: f32,
    /// Ticks without a fresh sample that hold the last command; after them the force is zero.
    pub stale_hold_ticks: u32,
    /// Age of the newest sample that latches a fault, microseconds.
    pub stale_fault_us: u64,
    /// Half-width of the workspace box round the model's origin; beyond it a fault, metres.
    pub max_position_m: f32,
    /// Speed of the HIP that is a fault, metres a second.
    pub max_speed_m_s: f32,
}

impl Default for LimitConfig {
    fn default() -> Self {
        Self {
            max_force_n: 8.0,
            max_slew_n_per_s: 1000.0,
            ramp_s: 0.5,
            stale_hold_ticks: 3,
            stale_fault_us: 10_000,
            max_position_m: 0.5,
            max_speed_m_s: 2.0,
        }
    }
}

/// Room for rounding below a limit: the result, computed in f32, is never above the limit, computed exactly.
const MARGIN: f32 = 1.0 - 4.0 * f32::EPSILON;

/// Shortens a force to `max_n`, direction kept; true if it had to. A force that is not finite becomes zero.
pub fn clamp_force(force_n: Vec3, max_n: f32) -> (Vec3, bool) {
    if !vec3::is_finite(force_n) {
        return (vec3::ZERO, true);
    }
    if vec3::norm(force_n) <= max_n * MARGIN {
        return (force_n, false);
    }
    (vec3::scale(vec3::normalize_or_zero(force_n), max_n * MARGIN), true)
}

/// Goes from `previous` towards `target` by no more than `max_step_n`, in a straight line.
///
/// Straight, not per component: between two forces inside the ball of [`clamp_force`] it never leaves that ball.
pub fn slew(previous_n: Vec3, target_n: Vec3, max_step_n: f32) -> Vec3 {
    let step = vec3::sub(target_n, previous_n);
    let length = vec3::norm(step);
    if length <= max_step_n {
        return target_n;
    }
    let share = (max_step_n / length * MARGIN).max(0.0);
    vec3::add(previous_n, vec3::scale(step, share))
}

/// Share of the force at some time after arming: 0 to 1, linear.
pub fn ramp(since_arming_us: u64, ramp_s: f32) -> f32 {
    let elapsed_s = since_arming_us as f32 * 1e-6;
    if elapsed_s >= ramp_s { 1.0 } else { (elapsed_s / ramp_s).max(0.0) }
}

/// What the stale-sample policy asks for in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freshness {
    /// The sample is new: use it.
    Fresh,
    /// No new sample, but only for a few ticks: repeat the last command.
    Hold,
    /// For longer: zero force, contact kept.
    Zero,
    /// For so long that something is broken.
    Fault,
}

/// The one stale-sample policy.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StaleWatch {
    newest_us: Option<u64>,
    /// Since when a sample has been awaited: time of the newest, or of arming.
    since_us: u64,
    missed: u32,
}

impl StaleWatch {
    /// Starts waiting for a sample at `now_us`.
    pub const fn new(now_us: u64) -> Self {
        Self { newest_us: None, since_us: now_us, missed: 0 }
    }

    /// Judges one tick. `sample_us` is the time of the sample at hand, on the same clock as `now_us`.
    ///
    /// A sample is fresh if it is newer than the last one and not itself as old as the fault limit. The same sample
    /// once more, or an older one, counts as none.
    pub fn judge(&mut self, config: &LimitConfig, now_us: u64, sample_us: Option<u64>) -> Freshness {
        let newer = |sample_us: &u64| self.newest_us.is_none_or(|newest_us| *sample_us > newest_us);
        let young = |sample_us: &u64| now_us.saturating_sub(*sample_us) < config.stale_fault_us;
        if let Some(sample_us) = sample_us.filter(newer).filter(young) {
            // A sample from the future must not buy time.
            *self = Self { newest_us: Some(sample_us), since_us: sample_us.min(now_us), missed: 0 };
            return Freshness::Fresh;
        }
        self.missed = self.missed.saturating_add(1);
        if now_us.saturating_sub(self.since_us) >= config.stale_fault_us {
            Freshness::Fault
        } else if self.missed <= config.stale_hold_ticks {
            Freshness::Hold
        } else {
            Freshness::Zero
        }
    }
}
