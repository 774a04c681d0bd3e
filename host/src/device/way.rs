//! Motion of the simulated hand through given places.

use super::script::MAX_TARGET_SPEED_M_S;
use palpate_core::{Vec3, vec3};

/// A place on a way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Waypoint {
    /// When the hand is there, s.
    pub t_s: f32,
    /// The place, m.
    pub place_m: Vec3,
    /// How the grip is turned there: the axis times the angle, rad.
    pub turn_rad: Vec3,
}

/// A motion through given places at given times; the hand stays at the last one.
#[derive(Debug, Clone, PartialEq)]
pub struct Way {
    /// In the order of time.
    places: Box<[Waypoint]>,
    /// The place that comes next.
    next: usize,
    elapsed_s: f32,
}

impl Way {
    /// `None` without places, or if a time is not later than the one before, a number is not finite, or the speed exceeds
    /// [`MAX_TARGET_SPEED_M_S`].
    #[must_use]
    pub fn new(places: impl Into<Box<[Waypoint]>>) -> Option<Self> {
        let places = places.into();
        let is_sound = |pair: &[Waypoint]| {
            let [from, to] = [pair[0], pair[1]];
            let (way_m, time_s) = (vec3::distance(from.place_m, to.place_m), to.t_s - from.t_s);
            to.t_s > from.t_s && way_m <= MAX_TARGET_SPEED_M_S * time_s
        };
        let is_finite =
            |at: &Waypoint| at.t_s.is_finite() && vec3::is_finite(at.place_m) && vec3::is_finite(at.turn_rad);
        let all = !places.is_empty() && places.iter().all(is_finite) && places.windows(2).all(is_sound);
        all.then_some(Self { places, next: 0, elapsed_s: 0.0 })
    }

    /// A quantity of the places, in between linear in time.
    pub(super) fn between(&self, of: impl Fn(&Waypoint) -> Vec3) -> Vec3 {
        let last = self.places.len() - 1;
        let to = &self.places[self.next.min(last)];
        let from = &self.places[self.next.saturating_sub(1).min(last)];
        let share = (self.elapsed_s - from.t_s) / (to.t_s - from.t_s).max(f32::MIN_POSITIVE);
        vec3::add(of(from), vec3::scale(vec3::sub(of(to), of(from)), share.clamp(0.0, 1.0)))
    }

    pub(super) fn target_m(&self) -> Vec3 {
        self.between(|at| at.place_m)
    }

    pub(super) fn advance(&mut self, by_s: f32) {
        self.elapsed_s += by_s;
        while self.places.get(self.next).is_some_and(|at| at.t_s <= self.elapsed_s) {
            self.next += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::palpation::Palpation;

    #[test]
    fn a_way_is_followed_and_ends_at_its_last_place() {
        let at = |t_s: f32, x: f32| Waypoint { t_s, place_m: [x, 0.0, 0.0], turn_rad: [0.0, 10.0 * x, 0.0] };
        let mut hand = Palpation::Way(Way::new([at(0.5, 0.0), at(1.0, 0.1), at(1.5, 0.0)]).expect("sound"));
        for tick in 0..2_000 {
            let t_s = tick as f32 * 1e-3;
            let exact_m = (0.1 - 0.2 * (t_s - 1.0).abs()).max(0.0);
            assert!((hand.target_m()[0] - exact_m).abs() < 1e-4, "{t_s}: {:?}", hand.target_m());
            let [x, _, z] = hand.orientation().expect("a way has one").turn([0.0, 0.0, 1.0]);
            assert!((x.atan2(z) - 10.0 * exact_m).abs() < 1e-3, "{t_s}: {x} {z}");
            hand.advance(1e-3);
        }
        for places in [
            &[][..],
            &[at(0.0, f32::NAN)],
            &[at(f32::INFINITY, 0.0)],
            &[at(1.0, 0.0), at(1.0, 0.0)],
            &[at(0.0, 0.0), at(0.1, 0.1)],
        ] {
            assert!(Way::new(places).is_none(), "{places:?}");
        }
    }
}
