//! How far a sphere or capsule is from the body at rest, and where it comes to it.

use crate::fem::body::Body;
use crate::fem::sphere::foot::Foot;
use crate::fem::sphere::{CoatedSphere, Posture};
use crate::num::vector::{difference, norm};

/// A sphere slower than this has no way, m/s, and the steps on one.
const SLOW_M_S: f64 = 1e-3;
const STEPS_ON_WAY: u32 = 24;

/// Steps out of a body, and the length of each as a multiple of the overlap.
const STEPS_OUT: u32 = 20;
const BESIDE: f64 = 1.05;

impl CoatedSphere {
    /// As a capsule with this half axis, m; zero for a sphere.
    pub(crate) fn turned(&self, half_m: [f64; 3]) -> Self {
        let mut turned = self.clone();
        turned.half_m = half_m;
        turned
    }

    /// Distance of the layer from the body at rest, m; zero or less where they overlap.
    pub fn clearance_m(&self, body: &Body, displacement_m: [f64; 3]) -> f64 {
        self.foot(body, displacement_m).distance_m - self.outer_m()
    }

    /// Whether the axis, or a part of it, is inside the body at a state.
    pub(crate) fn is_inside(&self, body: &Body, state: &[f64], posture: &Posture) -> bool {
        self.turned(posture.half_m).foot_at(body, state, posture.displacement_m).distance_m <= 0.0
    }

    /// The displacement out of the body, if the layer overlaps the skin at rest at this one: step by step away from the
    /// nearest point of the skin. The same displacement if it does not overlap.
    pub(crate) fn beside_m(&self, body: &Body, mut displacement_m: [f64; 3]) -> [f64; 3] {
        for _ in 0..STEPS_OUT {
            let foot = self.foot(body, displacement_m);
            if foot.distance_m >= self.outer_m() {
                break;
            }
            let overlap_m = BESIDE * (self.outer_m() - foot.distance_m);
            displacement_m = std::array::from_fn(|k| displacement_m[k] + overlap_m * foot.outward[k]);
        }
        displacement_m
    }

    /// The place of the skin at rest that is nearest to the axis.
    fn foot(&self, body: &Body, displacement_m: [f64; 3]) -> Foot {
        self.foot_at(body, &body.rest_state, displacement_m)
    }

    /// The same at a state of the body.
    fn foot_at(&self, body: &Body, state: &[f64], displacement_m: [f64; 3]) -> Foot {
        let end = |sign: f64| -> [f64; 3] {
            std::array::from_fn(|k| self.start_m[k] + displacement_m[k] + sign * self.half_m[k])
        };
        Foot::of(self.corners_m(body, state), [end(-1.0), end(1.0)]).expect("a body has a skin")
    }

    /// The displacement at which the layer overlaps the skin at rest by `depth_m`, where a centre at `centre_m` comes to
    /// it on the shortest way; `None` if it is farther than `within_m`, or inside the body.
    pub(crate) fn first_touch_m(
        &self,
        body: &Body,
        centre_m: [f64; 3],
        within_m: f64,
        depth_m: f64,
    ) -> Option<[f64; 3]> {
        let displacement_m = difference(centre_m, self.start_m);
        let foot = self.foot(body, displacement_m);
        let is_near = foot.distance_m > 0.0 && foot.distance_m < self.outer_m() + within_m;
        let way_m = self.outer_m() - depth_m - foot.distance_m;
        is_near.then(|| std::array::from_fn(|k| displacement_m[k] + way_m * foot.outward[k]))
    }

    /// The displacement at which a centre that moves on from `centre_m` straight on overlaps the skin at rest by `depth_m`;
    /// `None` if that is not within `within_m`, if it does not move, or if it is inside the body.
    pub(crate) fn touched_on_way_m(
        &self,
        body: &Body,
        centre_m: [f64; 3],
        velocity_m_s: [f64; 3],
        within_m: f64,
        depth_m: f64,
    ) -> Option<[f64; 3]> {
        let speed_m_s = norm(velocity_m_s);
        let is_inside = || self.foot(body, difference(centre_m, self.start_m)).distance_m < 0.0;
        if speed_m_s < SLOW_M_S || is_inside() {
            return None;
        }
        let at = |way_m: f64| -> [f64; 3] {
            std::array::from_fn(|k| centre_m[k] - self.start_m[k] + way_m / speed_m_s * velocity_m_s[k])
        };
        let mut way_m = 0.0;
        for _ in 0..STEPS_ON_WAY {
            // The skin is no nearer than this.
            let left_m = self.clearance_m(body, at(way_m)) + depth_m;
            if left_m <= 0.1 * depth_m {
                return Some(at(way_m));
            }
            way_m += left_m;
            if way_m > within_m {
                break;
            }
        }
        None
    }
}
