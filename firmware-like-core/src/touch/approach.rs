//! How a sphere or capsule of a live field comes to the skin at rest, and through the fixed part.

use super::surface::{MAX_TESTS, TouchSurface, nearest_on_triangle};
use crate::num::vec3::{self, Vec3};

/// Largest number of pieces into which the axis of a capsule is divided.
const MAX_PIECES: u16 = 8;
/// Places of two triangles are the same if their distances differ by less than this share: an edge or a vertex.
const SAME: f32 = 1e-4;

/// The axis of a sphere or capsule, and how near to the skin it is engaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Approach {
    /// The middle of the axis, model frame, metres.
    pub(crate) centre_m: Vec3,
    /// The way from there to one end; zero of a sphere.
    pub(crate) half_m: Vec3,
    /// Distance of the axis from the skin within which it is engaged.
    pub(crate) within_m: f32,
}

impl Approach {
    /// The ends of the axis.
    pub(super) fn ends_m(&self) -> [Vec3; 2] {
        [vec3::sub(self.centre_m, self.half_m), vec3::add(self.centre_m, self.half_m)]
    }

    /// Points of the axis, so close that one of them is within the second value of all that is within reach of the axis.
    fn points(&self) -> (impl Iterator<Item = Vec3> + use<>, f32) {
        let Self { centre_m, half_m, within_m } = *self;
        let length_m = 2.0 * vec3::norm(half_m);
        // The cast saturates and converts NaN to 0. No longer than half of the distance: a tenth too early at most.
        let pieces = if length_m > 0.0 { (length_m / within_m) as u16 + 1 } else { 0 }.min(MAX_PIECES);
        let at = move |k: u16| f32::from(2 * k) / f32::from(pieces.max(1)) - 1.0;
        let point = move |k: u16| vec3::add(centre_m, vec3::scale(half_m, at(k)));
        let spacing_m = length_m / f32::from(pieces.max(1));
        ((0..=pieces).map(point), vec3::norm([within_m, 0.5 * spacing_m, 0.0]))
    }
}

impl TouchSurface<'_> {
    /// Whether the skin is within reach.
    pub(crate) fn is_near(&self, approach: &Approach) -> bool {
        let (mut points, within_m) = approach.points();
        points.any(|point_m| self.is_within(point_m, within_m))
    }

    /// Whether no part of the axis is inside the body; `None` if the skin is not within reach.
    pub(crate) fn is_met_outside(&self, approach: &Approach) -> Option<bool> {
        let (points, within_m) = approach.points();
        let sides = points.filter_map(|point_m| self.is_outside(point_m, within_m));
        sides.reduce(|one, other| one && other)
    }

    /// Whether an end of the axis goes through the fixed part from outside. That does not give way: a hand that overcomes
    /// the device has pushed the tool into it.
    pub(super) fn is_pierced(&self, from_m: [Vec3; 2], to_m: [Vec3; 2]) -> bool {
        let ways = from_m.into_iter().zip(to_m);
        ways.filter_map(|(from_m, to_m)| self.crossing(from_m, to_m))
            .any(|crossing| self.is_fixed(&crossing.foot))
    }

    /// Whether a point is outside of the skin; `None` if that is not within a distance. At an edge or a vertex the triangle
    /// decides that looks most towards the point. Tests at most 2,048 triangles.
    fn is_outside(&self, point_m: Vec3, distance_m: f32) -> Option<bool> {
        let corner = |sign: f32| point_m.map(|x| x + sign * distance_m);
        let mut best: Option<(f32, f32)> = None;
        for &triangle in self.near(&[corner(-1.0), corner(1.0)]).take(MAX_TESTS) {
            let Some(corners) = self.corners(triangle) else { continue };
            let towards = vec3::sub(point_m, nearest_on_triangle(corners, point_m));
            let away_m = vec3::norm(towards);
            if away_m > distance_m {
                continue;
            }
            let cosine = vec3::dot(self.face_normal(triangle), vec3::normalize_or_zero(towards));
            let is_better = best.is_none_or(|(least_m, most)| {
                let same_m = SAME * least_m;
                away_m < least_m - same_m || away_m <= least_m + same_m && cosine.abs() > most.abs()
            });
            if is_better {
                best = Some((away_m, cosine));
            }
        }
        best.map(|(_, cosine)| cosine > 0.0)
    }
}
