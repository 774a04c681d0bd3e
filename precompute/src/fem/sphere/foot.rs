//! The place of the skin that is nearest to a point or an axis, and on which side of it that lies.

use crate::mesh::nearest_of_segment;
use crate::num::vector::{cross, difference, distance, dot, unit};

/// Places of two faces are the same if their distances differ by less, m: an edge or a vertex.
const SAME_M: f64 = 1e-9;

/// The nearest place of a face of the skin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    /// Distance of the point from it, m; negative inside the body. Zero where an axis goes through the skin.
    pub(super) distance_m: f64,
    /// Direction from the place to a point outside, and from one inside to the place.
    pub(super) outward: [f64; 3],
    /// Size of the cosine between this and the normal of the face.
    cosine: f64,
}

impl Foot {
    /// The nearest place of triangles that are counter-clockwise seen from outside to an axis between two ends; `None` without
    /// triangles.
    pub(super) fn of(triangles: impl Iterator<Item = [[f64; 3]; 3]>, ends_m: [[f64; 3]; 2]) -> Option<Self> {
        let mut best: Option<Self> = None;
        for corners in triangles {
            let (place_m, point_m) = nearest_of_segment(corners, ends_m);
            if best.is_none_or(|best| distance(place_m, point_m) < best.distance_m.abs() + SAME_M) {
                let foot = Self::at(corners, place_m, point_m);
                best = Some(best.map_or(foot, |best| best.nearer(foot)));
            }
        }
        best
    }

    /// At a place of a triangle.
    fn at([a, b, c]: [[f64; 3]; 3], place_m: [f64; 3], point_m: [f64; 3]) -> Self {
        let normal = unit(cross(difference(b, a), difference(c, a)));
        let away_m = distance(place_m, point_m);
        let towards = difference(point_m, place_m);
        let cosine = if away_m > 0.0 { dot(normal, towards) / away_m } else { 0.0 };
        let side = if cosine < 0.0 { -1.0 } else { 1.0 };
        let outward = if away_m > SAME_M { towards.map(|x| side * x / away_m) } else { normal };
        Self { distance_m: side * away_m, outward, cosine: cosine.abs() }
    }

    /// The nearer one. At an edge or a vertex the face decides that looks most towards the point.
    fn nearer(self, other: Self) -> Self {
        let (one_m, other_m) = (self.distance_m.abs(), other.distance_m.abs());
        let is_same = (one_m - other_m).abs() < SAME_M;
        let is_other = if is_same { other.cosine > self.cosine } else { other_m < one_m };
        if is_other { other } else { self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sides_of_a_sharp_edge_are_those_of_the_faces() {
        // Two faces that meet at 53 degrees along the x axis; the body lies between them.
        let at = |y: f64, z: f64| [0.3, y, z];
        let faces = [
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 1.0]],
            [[0.0, 0.0, 0.0], [0.0, 2.0, -1.0], [1.0, 0.0, 0.0]],
        ];
        let foot = |point_m| Foot::of(faces.into_iter(), [point_m; 2]).expect("two");
        for (y, z) in [(-0.1, 0.0), (-0.1, 0.05), (-0.1, -0.3), (0.0, 0.3), (0.5, -0.5)] {
            assert!(foot(at(y, z)).distance_m > 0.0, "{y} {z}: {:?}", foot(at(y, z)));
        }
        for (y, z) in [(0.1, 0.0), (0.5, 0.2), (0.5, -0.2)] {
            let foot = foot(at(y, z));
            assert!(foot.distance_m < 0.0 && foot.outward[2] * z >= 0.0, "{y} {z}: {foot:?}");
        }
    }
}
