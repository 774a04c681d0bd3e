//! Plausibility check of positions: a position must be reachable from the last one, or from its extrapolation
//! at the last velocity.
//!
//! A position that fails is either a damaged reply that looks valid, or the device has lost its reference: an
//! encoder has miscounted, or its counters have restarted. Damage is sporadic and is skipped. A lost
//! reference persists, and then no position of the device is valid.

use palpate_core::{Vec3, vec3};

/// Largest speed at which a hand moves a grip, m/s.
const MAX_SPEED_M_S: f32 = 3.0;
/// Largest acceleration of the grip, by the hand or in an impact, m/s^2: half a metre per second per tick.
const MAX_ACCELERATION_M_S2: f32 = 500.0;
/// Slack of a position, m: the times of requests are rounded to ticks.
const SLACK_M: f32 = 2e-3;
/// Number of consecutive rejected positions, each reachable from the previous one, after which the reference
/// counts as lost. It is smaller than the number that makes a sample stale, even with a reply every second
/// tick.
pub(super) const MAX_REJECTIONS: u32 = 3;

/// Result of the check of a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Reachable: accepted.
    Accepted,
    /// Not reachable: no sample.
    Rejected,
    /// Rejected too often in a row: the device has lost its reference.
    Lost,
}

/// A position with its times.
#[derive(Debug, Clone, Copy)]
struct TimedPosition {
    /// Time at which its request was sent.
    t_us: u64,
    /// Time at which the reply arrived.
    arrived_us: u64,
    device_m: Vec3,
}

impl TimedPosition {
    /// Largest time between two samplings, us. A position is sampled between request and arrival, and a
    /// driver in doubt assigns the older request to a reply.
    fn since_us(&self, before: &Self) -> u64 {
        self.t_us.saturating_sub(before.t_us).max(self.arrived_us.saturating_sub(before.arrived_us))
    }
}

/// Positions rejected since the last accepted one.
#[derive(Debug, Clone, Copy)]
struct RejectedPositions {
    count: u32,
    /// Deviation allowed for the first of them. It does not grow: otherwise a rejected position would be
    /// accepted a little later.
    allowed_m: f32,
    /// The last of them, if the reply had a position.
    last: Option<TimedPosition>,
}

/// State of the check, in the device frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct PositionCheck {
    /// The last accepted position.
    last: Option<TimedPosition>,
    /// Velocity between the last two accepted positions, m/s.
    velocity_m_s: Vec3,
    rejected: Option<RejectedPositions>,
    /// Largest deviation accepted after a silence, m.
    reach_m: f32,
}

impl PositionCheck {
    /// A check without history: it accepts the first position. `reach_m` is the largest deviation accepted
    /// after a silence of any length.
    pub(super) const fn with_reach(reach_m: f32) -> Self {
        Self { last: None, velocity_m_s: [0.0; 3], rejected: None, reach_m }
    }

    /// Discards the history: the coordinates have been reset.
    pub(super) const fn reset(&mut self) {
        *self = Self::with_reach(self.reach_m);
    }

    /// Time and position of the last accepted sample.
    pub(super) fn last(&self) -> Option<(u64, Vec3)> {
        self.last.map(|last| (last.t_us, last.device_m))
    }

    /// Velocity between the last two accepted samples, m/s.
    pub(super) const fn velocity_m_s(&self) -> Vec3 {
        self.velocity_m_s
    }

    fn reachable_m(&self, us: u64) -> f32 {
        let seconds = us as f32 * 1e-6;
        let moved_m = (0.5 * MAX_ACCELERATION_M_S2 * seconds * seconds).min(MAX_SPEED_M_S * seconds);
        SLACK_M + moved_m.min(self.reach_m)
    }

    /// Deviation of a position from the nearest plausible point, and the allowed deviation, m.
    ///
    /// The plausible points are the last position and its extrapolation. If time stamps are wrong by a tick,
    /// the velocity is wrong too.
    fn deviation(&self, last: &TimedPosition, at: &TimedPosition) -> (f32, f32) {
        let seconds = at.t_us.saturating_sub(last.t_us) as f32 * 1e-6;
        let predicted_m = vec3::scale(self.velocity_m_s, seconds);
        // The extrapolation is bounded: an old velocity is less reliable.
        let predicted_m = vec3::scale(predicted_m, (self.reach_m / vec3::norm(predicted_m)).min(1.0));
        let predicted_m = vec3::add(last.device_m, predicted_m);
        let deviation_m =
            vec3::distance(at.device_m, last.device_m).min(vec3::distance(at.device_m, predicted_m));
        let allowed_m = self.rejected.map(|rejected| rejected.allowed_m);
        (deviation_m, allowed_m.unwrap_or_else(|| self.reachable_m(at.since_us(last))))
    }

    /// Checks the position in a reply to a request of `t_us` that arrived at `arrived_us`. `None` is a reply
    /// whose values are no pose of the mechanism.
    pub(super) fn check(&mut self, t_us: u64, arrived_us: u64, device_m: Option<Vec3>) -> Verdict {
        let at = device_m.map(|device_m| TimedPosition { t_us, arrived_us, device_m });
        let deviation = at.and_then(|at| Some(self.deviation(&self.last?, &at)));
        if at.is_none() || deviation.is_some_and(|(deviation_m, allowed_m)| deviation_m > allowed_m) {
            return self.reject(at, deviation.map_or(SLACK_M, |(_, allowed_m)| allowed_m));
        }
        self.rejected = None;
        self.velocity_m_s = self.last.zip(at).map_or([0.0; 3], |(last, at)| {
            let per_second = 1e6 / at.t_us.saturating_sub(last.t_us).max(1) as f32;
            vec3::scale(vec3::sub(at.device_m, last.device_m), per_second)
        });
        self.last = at;
        Verdict::Accepted
    }

    fn reject(&mut self, at: Option<TimedPosition>, allowed_m: f32) -> Verdict {
        let before = self.rejected.map_or(0, |rejected| rejected.count);
        let count = if self.is_unrelated(at) { 1 } else { before + 1 };
        if count >= MAX_REJECTIONS {
            return Verdict::Lost;
        }
        self.rejected = Some(RejectedPositions { count, allowed_m, last: at });
        Verdict::Rejected
    }

    /// Whether it is unreachable from the previous rejected position: another damaged reply.
    fn is_unrelated(&self, at: Option<TimedPosition>) -> bool {
        let before = self.rejected.and_then(|rejected| rejected.last);
        at.zip(before).is_some_and(|(at, before)| {
            vec3::distance(at.device_m, before.device_m) > self.reachable_m(at.since_us(&before))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH_M: f32 = 0.03;

    /// Checks a position on an undisturbed link.
    fn check(motion: &mut PositionCheck, t_us: u64, device_m: Option<Vec3>) -> Verdict {
        motion.check(t_us, t_us + 1_000, device_m)
    }

    /// A hand at rest in the origin until 1 s.
    fn at_rest() -> PositionCheck {
        let mut motion = PositionCheck::with_reach(REACH_M);
        for tick in 0..=1_000 {
            assert_eq!(check(&mut motion, 1_000 * tick, Some([0.0; 3])), Verdict::Accepted);
        }
        motion
    }

    #[test]
    fn the_first_position_is_accepted_and_so_are_the_motions_of_a_hand() {
        let mut motion = PositionCheck::with_reach(REACH_M);
        assert_eq!(check(&mut motion, 0, Some([0.1, 0.0, 0.0])), Verdict::Accepted);
        let mut x_m = 0.1;
        for tick in 1..100 {
            // Up to 2 m/s and back within a tenth of a second.
            x_m += 2e-3 * (tick as f32 * core::f32::consts::PI / 50.0).sin();
            assert_eq!(check(&mut motion, 1_000 * tick, Some([x_m, 0.0, 0.0])), Verdict::Accepted, "{tick}");
        }
    }

    #[test]
    fn an_unreachable_position_is_rejected_and_the_third_means_a_lost_reference() {
        let mut motion = at_rest();
        assert_eq!(check(&mut motion, 1_001_000, Some([2.2e-3, 0.0, 0.0])), Verdict::Accepted);
        let mut motion = at_rest();
        let jumped_m = Some([2.4e-3, 0.0, 0.0]);
        assert_eq!(check(&mut motion, 1_001_000, jumped_m), Verdict::Rejected);
        assert_eq!(check(&mut motion, 1_002_000, jumped_m), Verdict::Rejected, "not accepted later");
        assert_eq!(check(&mut motion, 1_003_000, jumped_m), Verdict::Lost);
    }

    #[test]
    fn scattered_damage_is_skipped() {
        let mut motion = at_rest();
        for tick in 1_001..1_020 {
            let x_m = 0.05 * (tick % 3) as f32 + 0.02;
            assert_eq!(check(&mut motion, 1_000 * tick, Some([x_m, 0.0, 0.0])), Verdict::Rejected, "{tick}");
        }
        assert_eq!(check(&mut motion, 1_020_000, Some([0.0; 3])), Verdict::Accepted);
        // A reply without a position is damage too, until only such replies arrive.
        let mut motion = at_rest();
        let verdicts = [1_001_000, 1_002_000, 1_003_000].map(|t_us| check(&mut motion, t_us, None));
        assert_eq!(verdicts, [Verdict::Rejected, Verdict::Rejected, Verdict::Lost]);
    }

    #[test]
    fn after_a_silence_the_deviation_is_bounded() {
        for silent_us in [20_000, 300_000, 60_000_000] {
            let t_us = 1_000_000 + silent_us;
            assert_eq!(
                check(&mut at_rest(), t_us, Some([0.031, 0.0, 0.0])),
                Verdict::Accepted,
                "{silent_us}"
            );
            assert_eq!(
                check(&mut at_rest(), t_us, Some([0.033, 0.0, 0.0])),
                Verdict::Rejected,
                "{silent_us}"
            );
        }
    }

    /// After a loop stall of 60 ms the newest reply is current, but it is assigned to the request from before
    /// the stall.
    #[test]
    fn a_reply_may_be_newer_than_its_time_stamp() {
        let mut motion = at_rest();
        assert_eq!(motion.check(1_001_000, 1_061_000, Some([0.01, 0.0, 0.0])), Verdict::Accepted);
    }
}
