//! What came of a run, and the limits that it is held to.

use super::Wrong;
use crate::hosts::GENEROUS;
use crate::session::TICK_US;
use palpate_core::Fault;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// The loop rode it out and renders on.
    RodeOn,
    /// A latched fault.
    Latched(Fault),
    /// The device is gone; the loop ended.
    Lost,
    /// The driver was not opened.
    Refused,
    /// It was opened all the same, without a force.
    Opened,
    /// The supervisor took the force away.
    Supervisor,
    /// The device did, and its own watchdog keeps it away.
    Watchdog,
    /// It did not come so far, or no further: what was waited for in vain.
    Missed(&'static str),
}

/// One run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// Name of the rig.
    pub rig: &'static str,
    /// What went wrong.
    pub wrong: Wrong,
    /// Its seed: with the rig's name and the fault it repeats the run.
    pub seed: u64,
    /// How it ended.
    pub ended: Ended,
    /// From the fault to the first tick without a sample, us.
    pub degraded_us: Option<u64>,
    /// From the fault to the tick that latched, or in which the device was said to be gone, us.
    pub detected_us: Option<u64>,
    /// From there to motors without a force, us.
    pub zero_us: Option<u64>,
    /// From the end of the fault to motors without a force, us; 0 if they had none before.
    pub mended_us: Option<u64>,
    /// Largest force at the motors from the fault on, N.
    pub largest_n: f32,
    /// Largest change of it by one command that was not zero, N.
    pub step_n: f32,
    /// Fastest change of it from one command to the next, N/s.
    pub steepest_n_per_s: f32,
    /// Longest time for which it was beyond the profile's limit, us, to a tick.
    pub beyond_us: u64,
    /// The profile's limit and a step of the motors, N.
    pub limit_n: f32,
    /// The motors had a force again, or the loop left the fault it had latched, although nobody had reset and armed.
    pub resumed: bool,
    /// Furthest that the force at the motors was from the organ's before the fault, N.
    pub off_n: Option<f32>,
    /// Furthest that it was from the organ's after a fault that was ridden out, or after reset, arming and another press, N.
    pub after_n: Option<f32>,
    /// Frames that were struck on the way to the device and on the way back, where the fault is one of frames.
    pub struck: Option<[u64; 2]>,
    /// What was not as it must be, as it was seen on the way.
    pub(super) flaw: Option<&'static str>,
    /// Requests got through to the motors all the time.
    pub(super) way_is_sound: bool,
    pub(super) checked_requests: bool,
    /// Fastest that the controller lets the force change, where requests came to the motors as they were sent, N/s.
    pub(super) slew_n_per_s: Option<f32>,
}

/// Age at which a sample is a fault, us.
pub(super) const STALE_US: u64 = 10_000;
/// Two ticks.
const REACTION_US: u64 = 2 * TICK_US;
/// From the end of a fault on the way to the device to the first zero that is understood, us: a pause of 3 ms, a request given up after 2 ms, one
/// that only ends a damaged line, and the ticks between.
const MENDED_US: u64 = 12_000;

impl Run {
    /// A run of which nothing is known yet; limit in N.
    pub(crate) const fn with_nothing(rig: &'static str, wrong: Wrong, seed: u64, limit_n: f32) -> Self {
        Self {
            rig,
            wrong,
            seed,
            ended: Ended::RodeOn,
            degraded_us: None,
            detected_us: None,
            zero_us: None,
            mended_us: None,
            largest_n: 0.0,
            step_n: 0.0,
            steepest_n_per_s: 0.0,
            beyond_us: 0,
            limit_n,
            resumed: false,
            off_n: None,
            after_n: None,
            struck: None,
            flaw: None,
            way_is_sound: true,
            checked_requests: true,
            slew_n_per_s: None,
        }
    }

    /// What of the limits it breaks.
    #[must_use]
    pub fn broken(&self) -> Option<&'static str> {
        let latched = matches!(self.ended, Ended::Latched(_) | Ended::Lost);
        if let Ended::Missed(what) = self.ended {
            return Some(what);
        }
        if self.flaw.is_some() {
            return self.flaw;
        }
        if !self.wrong.may_end(self.ended) {
            return Some("it has ended otherwise than this fault ends");
        }
        if self.slew_n_per_s.is_some_and(|slew_n_per_s| self.steepest_n_per_s > slew_n_per_s) {
            return Some("the force has risen faster than it may");
        }
        // A cable that is out carries no zero, and a device without a watchdog keeps its force.
        if latched && self.way_is_sound && self.zero_us.is_none_or(|us| us > REACTION_US) {
            return Some("no zero two ticks after detection");
        }
        if matches!(self.ended, Ended::Latched(_))
            && !self.way_is_sound
            && self.mended_us.is_none_or(|us| us > MENDED_US)
        {
            return Some("no zero after the link was mended");
        }
        let is_late = |us: Option<u64>| us.is_none_or(|us| us > GENEROUS.as_micros() as u64);
        if matches!(self.wrong, Wrong::HostKilled | Wrong::HostPaused) && is_late(self.zero_us) {
            return Some("no zero for a host that is gone");
        }
        if self.ended == Ended::Watchdog && is_late(self.detected_us) {
            return Some("no latch by the device's watchdog");
        }
        let damaged = self.wrong == Wrong::CorruptRequest && !self.checked_requests;
        if self.largest_n > self.limit_n && !damaged {
            return Some("a force beyond the limit");
        }
        if self.beyond_us > MENDED_US {
            return Some("a force beyond the limit for more than 12 ms");
        }
        self.resumed.then_some("force without re-arming")
    }
}
