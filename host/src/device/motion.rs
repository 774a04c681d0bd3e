//! Whether a position can be where the hand is: near where it was, or near where its speed would have taken it.
//!
//! What is further off is a damaged reply that looks whole, or a device that has lost count of its place: an encoder that has miscounted, counters that
//! began anew. The first comes and goes and is ridden out. The second goes on saying the same, and then nothing it says is a position any more.

use palpate_core::{Vec3, vec3};

/// Fastest that a hand moves a grip, m/s.
const FASTEST_M_S: f32 = 3.0;
/// Most that a hand, or what it hits, changes its speed by, m/s^2: half a metre a second within a tick.
const HARDEST_M_S2: f32 = 500.0;
/// What it may jump in no time, m: requests are stamped within a tick.
const JUMP_M: f32 = 2e-3;
/// Positions refused in a row, each where a hand could have taken it from the one before, after which it is no reply that was damaged: fewer than make a
/// sample stale, also where there is a reply every other tick.
pub(super) const REFUSALS: u32 = 3;

/// What a position is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Where the hand can be.
    Moved,
    /// Where it cannot be: no sample.
    Refused,
    /// The same once too often: the device has lost its place.
    Lost,
}

/// Where the handle was said to be.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// When its request was sent.
    t_us: u64,
    /// When it came.
    came_us: u64,
    device_m: Vec3,
}

impl Place {
    /// The longest that may lie between the two, us: it was sampled some time between request and arrival, and a driver that is in doubt takes the older
    /// request for its own.
    fn since_us(&self, before: &Self) -> u64 {
        self.t_us.saturating_sub(before.t_us).max(self.came_us.saturating_sub(before.came_us))
    }
}

/// Positions that were refused, without a good one since.
#[derive(Debug, Clone, Copy)]
struct Refused {
    count: u32,
    /// What was allowed when the first one came. Not more since, or what was refused would be taken a little later.
    allowed_m: f32,
    /// The last of them, if it was anywhere.
    last: Option<Place>,
}

/// The way of the hand in the device's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// Of the last sample.
    last: Option<Place>,
    /// Between the last two, m/s.
    velocity_m_s: Vec3,
    refused: Option<Refused>,
    /// Furthest from where it was that it is believed after a silence, m.
    reach_m: f32,
}

impl Motion {
    /// Nothing known yet; the first position is believed. `reach_m` is the furthest that a position is believed after a silence of any length.
    pub(super) const fn within(reach_m: f32) -> Self {
        Self { last: None, velocity_m_s: [0.0; 3], refused: None, reach_m }
    }

    /// What was is no more: the coordinates are set anew.
    pub(super) const fn forget(&mut self) {
        *self = Self::within(self.reach_m);
    }

    /// When and where the last sample was.
    pub(super) fn last(&self) -> Option<(u64, Vec3)> {
        self.last.map(|last| (last.t_us, last.device_m))
    }

    /// Between the last two samples, m/s.
    pub(super) const fn velocity_m_s(&self) -> Vec3 {
        self.velocity_m_s
    }

    fn may_move_m(&self, us: u64) -> f32 {
        let seconds = us as f32 * 1e-6;
        let moved_m = (0.5 * HARDEST_M_S2 * seconds * seconds).min(FASTEST_M_S * seconds);
        JUMP_M + moved_m.min(self.reach_m)
    }

    /// How far a position is from where the hand may be, and how far it may be, m.
    ///
    /// It is near the last one or near where its speed has taken it: with stamps that are a tick wrong its speed is, too.
    fn leap(&self, last: &Place, at: &Place) -> (f32, f32) {
        let seconds = at.t_us.saturating_sub(last.t_us) as f32 * 1e-6;
        let carried_m = vec3::scale(self.velocity_m_s, seconds);
        // How fast it was says less the longer it is ago.
        let carried_m = vec3::scale(carried_m, (self.reach_m / vec3::norm(carried_m)).min(1.0));
        let carried_m = vec3::add(last.device_m, carried_m);
        let off_m = vec3::distance(at.device_m, last.device_m).min(vec3::distance(at.device_m, carried_m));
        let allowed_m = self.refused.map(|refused| refused.allowed_m);
        (off_m, allowed_m.unwrap_or_else(|| self.may_move_m(at.since_us(last))))
    }

    /// Judges the position of a reply to a request of `t_us` that came at `came_us`; one that is no place of the mechanism has none.
    pub(super) fn judge(&mut self, t_us: u64, came_us: u64, device_m: Option<Vec3>) -> Verdict {
        let at = device_m.map(|device_m| Place { t_us, came_us, device_m });
        let leap = at.and_then(|at| Some(self.leap(&self.last?, &at)));
        if at.is_none() || leap.is_some_and(|(off_m, allowed_m)| off_m > allowed_m) {
            return self.refuse(at, leap.map_or(JUMP_M, |(_, allowed_m)| allowed_m));
        }
        self.refused = None;
        self.velocity_m_s = self.last.zip(at).map_or([0.0; 3], |(last, at)| {
            let per_second = 1e6 / at.t_us.saturating_sub(last.t_us).max(1) as f32;
            vec3::scale(vec3::sub(at.device_m, last.device_m), per_second)
        });
        self.last = at;
        Verdict::Moved
    }

    fn refuse(&mut self, at: Option<Place>, allowed_m: f32) -> Verdict {
        let before = self.refused.map_or(0, |refused| refused.count);
        let count = if self.is_scattered(at) { 1 } else { before + 1 };
        if count >= REFUSALS {
            return Verdict::Lost;
        }
        self.refused = Some(Refused { count, allowed_m, last: at });
        Verdict::Refused
    }

    /// Where no hand could have taken it from the one that was refused before: damage, once more.
    fn is_scattered(&self, at: Option<Place>) -> bool {
        let before = self.refused.and_then(|refused| refused.last);
        at.zip(before).is_some_and(|(at, before)| {
            vec3::distance(at.device_m, before.device_m) > self.may_move_m(at.since_us(&before))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH_M: f32 = 0.03;

    /// As on a sound link.
    fn judged(motion: &mut Motion, t_us: u64, device_m: Option<Vec3>) -> Verdict {
        motion.judge(t_us, t_us + 1_000, device_m)
    }

    /// A hand that rests at the origin until 1 s.
    fn at_rest() -> Motion {
        let mut motion = Motion::within(REACH_M);
        for tick in 0..=1_000 {
            assert_eq!(judged(&mut motion, 1_000 * tick, Some([0.0; 3])), Verdict::Moved);
        }
        motion
    }

    #[test]
    fn a_hand_may_be_anywhere_at_first_and_moves_as_hands_do() {
        let mut motion = Motion::within(REACH_M);
        assert_eq!(judged(&mut motion, 0, Some([0.1, 0.0, 0.0])), Verdict::Moved);
        let mut x_m = 0.1;
        for tick in 1..100 {
            // Up to 2 m/s and back within a tenth of a second.
            x_m += 2e-3 * (tick as f32 * core::f32::consts::PI / 50.0).sin();
            assert_eq!(judged(&mut motion, 1_000 * tick, Some([x_m, 0.0, 0.0])), Verdict::Moved, "{tick}");
        }
    }

    #[test]
    fn a_place_that_no_hand_reaches_is_refused_and_the_third_time_it_is_lost() {
        let mut motion = at_rest();
        assert_eq!(judged(&mut motion, 1_001_000, Some([2.2e-3, 0.0, 0.0])), Verdict::Moved);
        let mut motion = at_rest();
        let jumped_m = Some([2.4e-3, 0.0, 0.0]);
        assert_eq!(judged(&mut motion, 1_001_000, jumped_m), Verdict::Refused);
        assert_eq!(judged(&mut motion, 1_002_000, jumped_m), Verdict::Refused, "not taken a little later");
        assert_eq!(judged(&mut motion, 1_003_000, jumped_m), Verdict::Lost);
    }

    #[test]
    fn damage_is_scattered_and_is_ridden_out() {
        let mut motion = at_rest();
        for tick in 1_001..1_020 {
            let x_m = 0.05 * (tick % 3) as f32 + 0.02;
            assert_eq!(judged(&mut motion, 1_000 * tick, Some([x_m, 0.0, 0.0])), Verdict::Refused, "{tick}");
        }
        assert_eq!(judged(&mut motion, 1_020_000, Some([0.0; 3])), Verdict::Moved);
        // No place at all is damage, too, until it is the only thing that comes.
        let mut motion = at_rest();
        let verdicts = [1_001_000, 1_002_000, 1_003_000].map(|t_us| judged(&mut motion, t_us, None));
        assert_eq!(verdicts, [Verdict::Refused, Verdict::Refused, Verdict::Lost]);
    }

    #[test]
    fn after_a_silence_of_any_length_it_is_still_about_where_it_was() {
        for silent_us in [20_000, 300_000, 60_000_000] {
            let t_us = 1_000_000 + silent_us;
            assert_eq!(judged(&mut at_rest(), t_us, Some([0.031, 0.0, 0.0])), Verdict::Moved, "{silent_us}");
            assert_eq!(
                judged(&mut at_rest(), t_us, Some([0.033, 0.0, 0.0])),
                Verdict::Refused,
                "{silent_us}"
            );
        }
    }

    /// A loop that stood still for 60 ms: the newest reply is of now, and counts for the request from before.
    #[test]
    fn a_reply_may_be_younger_than_its_stamp() {
        let mut motion = at_rest();
        assert_eq!(motion.judge(1_001_000, 1_061_000, Some([0.01, 0.0, 0.0])), Verdict::Moved);
    }
}
