//! The outcome of a run, and the limits that it must keep.

use super::ended::Ended;
use crate::fault::FaultKind;
use crate::tick::TICK_US;
use palpate_core::Fault;
use std::time::Duration;

/// One run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// Name of the rig.
    pub rig: &'static str,
    /// The injected fault.
    pub fault: FaultKind,
    /// Seed; with the rig and the fault it repeats the run.
    pub seed: u64,
    /// How it ended.
    pub ended: Ended,
    /// Time from the fault to the first tick without a sample, us.
    pub degraded_us: Option<u64>,
    /// Time from the fault to the tick that latched or reported the loss of the device, us.
    pub detected_us: Option<u64>,
    /// Time from the detection to zero force, us.
    pub zero_us: Option<u64>,
    /// Time from the end of the fault to zero force, us; 0 if the force was zero before.
    pub zero_after_fault_us: Option<u64>,
    /// Largest force at the motors since the fault, N.
    pub largest_n: f32,
    /// Largest change of the force by one non-zero command, N.
    pub step_n: f32,
    /// Largest rate of change of the force, N/s.
    pub steepest_n_per_s: f32,
    /// Longest interval with a force above the profile's limit, us; the resolution is one tick.
    pub over_limit_us: u64,
    /// The profile's limit plus one motor step, N.
    pub limit_n: f32,
    /// The force returned, or the latch ended, without a reset and arming.
    pub resumed: bool,
    /// Largest error of the force at the motors before the fault, N.
    pub error_before_n: Option<f32>,
    /// Largest error of the force after recovery, or after reset, arming and another press, N.
    pub error_after_n: Option<f32>,
    /// Faulty frames to the device and to the host, for a fault that acts on frames.
    pub injected: Option<[u64; 2]>,
    /// The first violation observed during the run.
    pub(super) observed_violation: Option<&'static str>,
    /// All requests reached the motors.
    pub(super) request_path_ok: bool,
    pub(super) checked_requests: bool,
    /// The process that holds its library latches a gap of 10 ms by itself, which may be before the loop does.
    pub(super) behind_library: bool,
    /// Largest allowed rate of change of the force, where requests reach the motors without delay, N/s.
    pub(super) slew_n_per_s: Option<f32>,
}

/// Longest time from the loss of a host to zero force, of a single run on a busy machine and also with a
/// longer silence limit. The target for the median is [`hosts::TARGET`](crate::hosts::TARGET).
pub const MAX_TIME_TO_ZERO: Duration = Duration::from_millis(500);
/// Age from which a sample is stale, us.
pub(super) const STALE_US: u64 = 10_000;
/// Longest time from the detection to zero force, us: two ticks.
const MAX_REACTION_US: u64 = 2 * TICK_US;
/// Longest time from the end of a fault on the request path to the first zero that is understood, us: a pause
/// of 3 ms, a request abandoned after 2 ms, one that only ends a corrupted line, and the ticks between.
const MAX_ZERO_AFTER_FAULT_US: u64 = 12_000;

impl Run {
    /// A run without results; limit in N.
    pub(crate) const fn empty(rig: &'static str, fault: FaultKind, seed: u64, limit_n: f32) -> Self {
        Self {
            rig,
            fault,
            seed,
            ended: Ended::Recovered,
            degraded_us: None,
            detected_us: None,
            zero_us: None,
            zero_after_fault_us: None,
            largest_n: 0.0,
            step_n: 0.0,
            steepest_n_per_s: 0.0,
            over_limit_us: 0,
            limit_n,
            resumed: false,
            error_before_n: None,
            error_after_n: None,
            injected: None,
            observed_violation: None,
            request_path_ok: true,
            checked_requests: true,
            behind_library: false,
            slew_n_per_s: None,
        }
    }

    /// The first violated limit.
    #[must_use]
    pub fn violation(&self) -> Option<&'static str> {
        let latched = matches!(self.ended, Ended::Latched(_) | Ended::Lost);
        if let Ended::TimedOut(what) = self.ended {
            return Some(what);
        }
        if self.observed_violation.is_some() {
            return self.observed_violation;
        }
        let by_proxy = self.ended == Ended::Latched(Fault::Watchdog);
        let is_gap =
            matches!(self.fault, FaultKind::Drop | FaultKind::Silence | FaultKind::Delay | FaultKind::Stall);
        // Without a screen of the encoders it is the loop's speed limit that finds a jump.
        let by_speed = self.ended == Ended::Latched(Fault::Overspeed) && self.fault == FaultKind::EncoderJump;
        let is_theirs = self.behind_library && (by_proxy && is_gap || by_speed);
        if !(self.fault.allows(self.ended) || is_theirs) {
            return Some("this outcome is not allowed for the fault");
        }
        if self.slew_n_per_s.is_some_and(|slew_n_per_s| self.steepest_n_per_s > slew_n_per_s) {
            return Some("the force has exceeded its slew limit");
        }
        // No zero can reach an unplugged device, and a device without a watchdog keeps its force.
        if latched && self.request_path_ok && self.zero_us.is_none_or(|us| us > MAX_REACTION_US) {
            return Some("no zero two ticks after detection");
        }
        if matches!(self.ended, Ended::Latched(_))
            && !self.request_path_ok
            && self.zero_after_fault_us.is_none_or(|us| us > MAX_ZERO_AFTER_FAULT_US)
        {
            return Some("no zero after the end of the link fault");
        }
        let is_late = |us: Option<u64>| us.is_none_or(|us| us > MAX_TIME_TO_ZERO.as_micros() as u64);
        if FaultKind::PROCESSES.contains(&self.fault) && is_late(self.zero_us) {
            return Some("no zero after the loss of host or guard");
        }
        if self.ended == Ended::Watchdog && is_late(self.detected_us) {
            return Some("no latch by the device's watchdog");
        }
        let damaged = self.fault == FaultKind::CorruptRequest && !self.checked_requests;
        if self.largest_n > self.limit_n && !damaged {
            return Some("a force beyond the limit");
        }
        if self.over_limit_us > MAX_ZERO_AFTER_FAULT_US {
            return Some("a force beyond the limit for more than 12 ms");
        }
        self.resumed.then_some("a force without a reset and arming")
    }
}
