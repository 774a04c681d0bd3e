//! Points of the skin: the nearest one to a point of space.

use serde::{Deserialize, Serialize};

use super::{Surface, TetMesh};
use crate::num::vector::{cross, difference, distance, dot};

/// A point of a surface: a triangle and the barycentric weights of its corners, none negative, of sum 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SkinPoint {
    /// Corners of the triangle, mesh nodes.
    pub triangle: [u32; 3],
    /// Weight of each corner.
    pub weights: [f64; 3],
}

impl SkinPoint {
    /// The value there of a field given at the mesh nodes.
    pub fn interpolate(&self, field: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
        let values = self.triangle.map(field);
        std::array::from_fn(|axis| (0..3).map(|k| self.weights[k] * values[k][axis]).sum())
    }

    /// The corner with the largest weight; the first one if several are equal.
    pub fn nearest_node(&self) -> u32 {
        let first = (self.triangle[0], self.weights[0]);
        let others = self.triangle.into_iter().zip(self.weights).skip(1);
        others.fold(first, |most, next| if next.1 > most.1 { next } else { most }).0
    }
}

impl Surface {
    /// The point of the surface nearest to a point of space; of equally near ones, that of the first triangle.
    pub fn nearest(&self, mesh: &TetMesh, point_m: [f64; 3]) -> Option<SkinPoint> {
        let on = |triangle: &[u32; 3]| {
            let (at_m, weights) = nearest_on_triangle(triangle.map(|n| mesh.nodes_m[n as usize]), point_m);
            (distance(at_m, point_m), SkinPoint { triangle: *triangle, weights })
        };
        self.triangles.iter().map(on).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, point)| point)
    }
}

/// The point of a triangle nearest to a point of space, and its barycentric weights (Ericson 2005, section
/// 5.1.5).
pub(crate) fn nearest_on_triangle([a, b, c]: [[f64; 3]; 3], p: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let (ab, ac) = (difference(b, a), difference(c, a));
    let at = |weights: [f64; 3]| -> ([f64; 3], [f64; 3]) {
        let point = |axis: usize| weights[0] * a[axis] + weights[1] * b[axis] + weights[2] * c[axis];
        ([0, 1, 2].map(point), weights)
    };
    let from = |corner| (dot(ab, difference(p, corner)), dot(ac, difference(p, corner)));
    let ((d1, d2), (d3, d4), (d5, d6)) = (from(a), from(b), from(c));
    if d1 <= 0.0 && d2 <= 0.0 {
        return at([1.0, 0.0, 0.0]);
    }
    if d3 >= 0.0 && d4 <= d3 {
        return at([0.0, 1.0, 0.0]);
    }
    if d6 >= 0.0 && d5 <= d6 {
        return at([0.0, 0.0, 1.0]);
    }
    let (vc, vb, va) = (d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4);
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return at([1.0 - t, t, 0.0]);
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return at([1.0 - t, 0.0, t]);
    }
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return at([0.0, 1.0 - t, t]);
    }
    // Of the point inside, the areas are computed directly: their rounding is relative to the point.
    let normal = cross(ab, ac);
    let share = |one: [f64; 3], other: [f64; 3]| {
        dot(normal, cross(difference(one, p), difference(other, p))) / dot(normal, normal)
    };
    let [wa, wb] = [share(b, c), share(c, a)];
    at([wa, wb, 1.0 - wa - wb])
}

/// The points of a triangle and of a segment that are nearest to each other; the same point if they meet.
pub(crate) fn nearest_of_segment(triangle: [[f64; 3]; 3], ends: [[f64; 3]; 2]) -> ([f64; 3], [f64; 3]) {
    if ends[0] == ends[1] {
        return (nearest_on_triangle(triangle, ends[0]).0, ends[0]);
    }
    if let Some(at) = crossing(triangle, ends) {
        return (at, at);
    }
    let of_ends = ends.map(|end| (nearest_on_triangle(triangle, end).0, end));
    let [a, b, c] = triangle;
    let of_edges = [[a, b], [b, c], [c, a]].map(|edge| nearest_of_segments(edge, ends));
    let away = |(one, other): &([f64; 3], [f64; 3])| distance(*one, *other);
    let all = of_ends.into_iter().chain(of_edges);
    all.min_by(|one, other| away(one).total_cmp(&away(other))).expect("there are five")
}

/// Where a segment goes through a triangle.
fn crossing([a, b, c]: [[f64; 3]; 3], [p, q]: [[f64; 3]; 2]) -> Option<[f64; 3]> {
    let normal = cross(difference(b, a), difference(c, a));
    let (from, to) = (dot(normal, difference(p, a)), dot(normal, difference(q, a)));
    if from * to >= 0.0 {
        return None;
    }
    let share = from / (from - to);
    let at: [f64; 3] = std::array::from_fn(|k| p[k] + share * (q[k] - p[k]));
    let is_left =
        |from: [f64; 3], to: [f64; 3]| dot(normal, cross(difference(to, from), difference(at, from))) >= 0.0;
    (is_left(a, b) && is_left(b, c) && is_left(c, a)).then_some(at)
}

/// The points of two segments that are nearest to each other (Ericson 2005, section 5.1.9).
fn nearest_of_segments([a, b]: [[f64; 3]; 2], [p, q]: [[f64; 3]; 2]) -> ([f64; 3], [f64; 3]) {
    let (one, other, gap) = (difference(b, a), difference(q, p), difference(a, p));
    let (along, across, lengths) = (dot(one, gap), dot(one, other), (dot(one, one), dot(other, other)));
    let beside = dot(other, gap);
    let spread = lengths.0 * lengths.1 - across * across;
    let first =
        if spread > 0.0 { ((across * beside - along * lengths.1) / spread).clamp(0.0, 1.0) } else { 0.0 };
    let second = ((across * first + beside) / lengths.1).clamp(0.0, 1.0);
    let first = ((across * second - along) / lengths.0).clamp(0.0, 1.0);
    let at = |from: [f64; 3], way: [f64; 3], share: f64| std::array::from_fn(|k| from[k] + share * way[k]);
    (at(a, one, first), at(p, other, second))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::vector::norm;
    use crate::num::{SPLIT_MIX_STEP, split_mix, unit_interval};

    const CORNERS: [[f64; 3]; 3] = [[0.1, 0.0, 0.2], [1.3, 0.1, 0.0], [0.2, 0.9, 0.1]];

    /// No point of a fine net of the triangle is nearer, whichever part of it the point faces.
    #[test]
    fn no_other_point_of_the_triangle_is_nearer() {
        for number in 0..500_u32 {
            let spread = |k: u32| f64::from((number * k) % 101) / 25.0 - 2.0;
            let point = [spread(37), spread(53), spread(71)];
            let (found, weights) = nearest_on_triangle(CORNERS, point);
            assert!(weights.iter().all(|w| *w >= 0.0) && (weights.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            let away = distance(found, point);
            for i in 0..=40 {
                for j in 0..=40 - i {
                    let [u, v] = [i, j].map(|n| f64::from(n) / 40.0);
                    let at = [0, 1, 2].map(|axis: usize| {
                        CORNERS[0][axis] * (1.0 - u - v) + CORNERS[1][axis] * u + CORNERS[2][axis] * v
                    });
                    assert!(distance(at, point) > away - 1e-12, "{point:?}");
                }
            }
        }
    }

    #[test]
    fn a_point_of_the_surface_is_found_with_its_weights() {
        let mesh = TetMesh::cuboid([3, 2, 2], 0.1);
        let surface = Surface::of(&mesh);
        for triangle in &surface.triangles {
            let inside = SkinPoint { triangle: *triangle, weights: [0.2, 0.5, 0.3] };
            let at = inside.interpolate(|node| mesh.nodes_m[node as usize]);
            let found = surface.nearest(&mesh, at).expect("a surface");
            assert_eq!((found.triangle, found.nearest_node()), (*triangle, triangle[1]));
            assert!(norm(difference(found.weights, inside.weights)) < 1e-12);
        }
    }

    /// Against the nearest of many points of the segment.
    #[test]
    fn a_segment_is_as_near_as_the_nearest_of_its_points() {
        let mut state = 5_u64;
        let mut random = || {
            state = state.wrapping_add(SPLIT_MIX_STEP);
            2.0 * unit_interval(split_mix(state)) - 1.0
        };
        let mut met = 0;
        for _ in 0..300 {
            let ends = [0, 1].map(|_| [0, 1, 2].map(|_| 1.5 * random()));
            let (foot, axis) = nearest_of_segment(CORNERS, ends);
            let on = |share: f64| std::array::from_fn(|k| ends[0][k] + share * (ends[1][k] - ends[0][k]));
            let many = (0..=2000).map(|step| on(f64::from(step) / 2000.0));
            let least = many.map(|at| distance(nearest_on_triangle(CORNERS, at).0, at)).fold(9.0, f64::min);
            let found = distance(foot, axis);
            assert!(found <= least + 1e-12 && found >= least - 2e-3, "{ends:?}: {found}, not {least}");
            assert!(distance(nearest_on_triangle(CORNERS, foot).0, foot) < 1e-12, "on the triangle");
            met += u32::from(found == 0.0);
        }
        assert!(met > 5, "{met} go through it");
    }
}
