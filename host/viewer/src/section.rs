//! A section of the skin by a plane through the tool: the side view of a touch.

use super::camera::Projection;
use super::touched::Touched;
use glam::{Vec2, Vec3};

/// Largest cosine between the normal and the axis of the picture in the plane: beyond it the other axis is
/// taken, because the plane would turn with every small change of the normal.
const MAX_COSINE: f32 = 0.87;

/// The plane of a section with its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    /// The point of the skin's tangent plane below or above the tool, m: the origin of the section.
    origin_m: Vec3,
    /// To the right in the section.
    across: Vec3,
    /// Up in the section: the outward normal of the skin.
    normal: Vec3,
}

impl Plane {
    /// The plane through the tool that contains the normal, and the right of the picture: what is on the left
    /// of the picture is on the left of the section. Where the normal itself points there, it contains the up
    /// of the picture instead.
    pub(super) fn of(touched: &Touched, projection: &Projection) -> Self {
        let normal = touched.normal;
        let [right, up] = [0, 1].map(|row| projection.to_eye.row(row));
        let along = if right.dot(normal).abs() < MAX_COSINE { right } else { up };
        let across = (along - normal * along.dot(normal)).normalize_or(normal.any_orthonormal_vector());
        Self { origin_m: touched.tool_m + normal * touched.below_m(), across, normal }
    }

    /// A point in the section: right and outwards, m.
    pub(super) fn point(&self, point_m: Vec3) -> Vec2 {
        self.direction(point_m - self.origin_m)
    }

    /// A direction in the section.
    pub(super) fn direction(&self, way_m: Vec3) -> Vec2 {
        Vec2::new(self.across.dot(way_m), self.normal.dot(way_m))
    }

    /// The line in which a surface cuts the plane, a segment a triangle; `height_m` is scratch memory.
    ///
    /// A closed surface gives closed lines to the last bit: neighbours compute the same point on their edge.
    pub(super) fn contour(
        &self,
        position_m: &[Vec3],
        triangles: &[[u32; 3]],
        height_m: &mut Vec<f32>,
        segments: &mut Vec<[Vec2; 2]>,
    ) {
        let through = self.across.cross(self.normal);
        height_m.clear();
        height_m.extend(position_m.iter().map(|point_m| through.dot(*point_m - self.origin_m)));
        segments.clear();
        let crossing = |i: u32, j: u32| {
            let [low, high] = [i.min(j) as usize, i.max(j) as usize];
            let share = height_m[low] / (height_m[low] - height_m[high]);
            self.point(position_m[low] + (position_m[high] - position_m[low]) * share)
        };
        for &[a, b, c] in triangles {
            let [above_a, above_b, above_c] = [a, b, c].map(|corner| height_m[corner as usize] >= 0.0);
            // The corner that is alone on its side.
            let [alone, one, other] = match (above_a == above_b, above_b == above_c) {
                (true, true) => continue,
                (true, false) => [c, a, b],
                (false, true) => [a, b, c],
                (false, false) => [b, c, a],
            };
            segments.push([crossing(alone, one), crossing(alone, other)]);
        }
    }
}

/// Intervals inside a closed line, column by column: `spans(column)` are pairs of heights, from the top.
#[derive(Debug, Clone, Default)]
pub(super) struct Inside {
    columns: Vec<Vec<f32>>,
}

impl Inside {
    /// Finds where the middles of `count` columns of width 1 from x = 0 cross the line.
    pub(super) fn find(&mut self, segments: impl Iterator<Item = [Vec2; 2]>, count: usize) {
        self.columns.resize(count, Vec::new());
        self.columns.iter_mut().for_each(Vec::clear);
        for [from, to] in segments {
            let [left, right] = if from.x < to.x { [from, to] } else { [to, from] };
            // Column i has its middle at i + 1/2; a middle on an end belongs to the segment on its right.
            let first = (left.x - 0.5).ceil().max(0.0) as usize;
            let last = ((right.x - 0.5).ceil().max(0.0) as usize).min(count);
            for column in first..last {
                let share = (column as f32 + 0.5 - left.x) / (right.x - left.x);
                self.columns[column].push(left.y + (right.y - left.y) * share);
            }
        }
        self.columns.iter_mut().for_each(|crossings| crossings.sort_by(f32::total_cmp));
    }

    /// The intervals in a column.
    pub(super) fn spans(&self, column: usize) -> impl Iterator<Item = [f32; 2]> {
        self.columns
            .get(column)
            .into_iter()
            .flat_map(|crossings| crossings.chunks_exact(2).map(|pair| [pair[0], pair[1]]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;
    use crate::deformation::Deformation;
    use crate::synthetic::{self, Shape};
    use palpate_core::Organ;

    /// A touch of the ellipsoid where its shortest axis leaves it, and a camera in front of it.
    fn touched(shape: &Shape, depth_m: f32) -> (Touched, Projection) {
        let contact_m = Vec3::Z * shape.half_axes_m[2];
        let touched = Touched {
            tool_m: contact_m - Vec3::Z * depth_m,
            reach_m: 0.0,
            contact_m,
            normal: Vec3::Z,
            is_engaged: true,
        };
        let camera = OrbitCamera::framing(Vec3::ZERO, 0.1, Vec3::new(0.0, -1.0, 0.2), Vec3::Z);
        (touched, camera.projection(640, 360))
    }

    /// The section of an ellipsoid is an ellipse: x^2 / a^2 + z^2 / c^2 = 1.
    #[test]
    fn a_section_of_an_ellipsoid_is_an_ellipse() {
        let shape = Shape { subdivisions: 5, ..Shape::default() };
        let blob = synthetic::organ(&shape);
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let rest = Deformation::at_rest(&organ);
        let (touched, projection) = touched(&shape, 0.004);
        let plane = Plane::of(&touched, &projection);
        let (mut heights, mut segments) = (Vec::new(), Vec::new());
        plane.contour(rest.rest_m(), organ.surface.triangles, &mut heights, &mut segments);
        assert!(segments.len() > 200, "{}", segments.len());
        let [a, _, c] = shape.half_axes_m;
        for point in segments.as_flattened() {
            let ring = (point.x / a).powi(2) + ((point.y + c) / c).powi(2);
            assert!((ring - 1.0).abs() < 2e-3, "{point}: {ring}");
        }
        // What is right in the picture is right in the section.
        let right_m = Vec3::new(0.03, 0.0, 0.0);
        let [here, there] = [Vec3::ZERO, right_m].map(|point| projection.project(point).expect("seen").0);
        assert!(((there - here).x > 0.0) == (plane.point(right_m).x > 0.0));
        // Every end is the end of exactly one other segment: the line is closed.
        let mut ends: Vec<[u32; 2]> =
            segments.as_flattened().iter().map(|end| end.to_array().map(f32::to_bits)).collect();
        ends.sort_unstable();
        assert!(ends.chunks(2).all(|pair| pair[0] == pair[1]));
        assert!(plane.point(touched.tool_m).distance(Vec2::new(0.0, -0.004)) < 1e-8);
    }

    /// A triangle with one corner 1 mm in front of the plane and two 3 mm behind it: the line is a quarter of
    /// the way from that corner, whatever the order of its corners.
    #[test]
    fn a_triangle_is_cut_where_it_crosses_the_plane() {
        let (touched, projection) = touched(&Shape::default(), 0.0);
        let plane = Plane::of(&touched, &projection);
        let through = plane.across.cross(plane.normal);
        let place =
            |x: f32, y: f32, z: f32| plane.origin_m + plane.across * x + plane.normal * y + through * z;
        let corners = [place(0.0, 0.0, 0.001), place(0.008, 0.0, -0.003), place(0.0, 0.004, -0.003)];
        for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
            let position_m = order.map(|corner| corners[corner]);
            let (mut heights, mut segments) = (Vec::new(), Vec::new());
            plane.contour(&position_m, &[[0, 1, 2]], &mut heights, &mut segments);
            let mut ends = segments[0];
            ends.sort_by(|one, other| one.x.total_cmp(&other.x));
            let expected = [Vec2::new(0.0, 0.001), Vec2::new(0.002, 0.0)];
            let error_m = ends[0].distance(expected[0]).max(ends[1].distance(expected[1]));
            assert!(segments.len() == 1 && error_m < 1e-7, "{order:?}: {ends:?}");
        }
        let mut segments = vec![[Vec2::ZERO; 2]];
        plane.contour(
            &corners.map(|corner| corner - through * 0.002),
            &[[0, 1, 2]],
            &mut Vec::new(),
            &mut segments,
        );
        assert!(segments.is_empty(), "wholly behind");
    }

    #[test]
    fn the_plane_does_not_collapse_where_the_normal_points_to_the_right() {
        let (touched, projection) = touched(&Shape::default(), 0.0);
        for normal in [projection.to_eye.row(0), projection.to_eye.row(1), projection.to_eye.row(2)] {
            let plane = Plane::of(&Touched { normal, ..touched }, &projection);
            assert!((plane.across.length() - 1.0).abs() < 1e-5 && plane.across.dot(normal).abs() < 1e-5);
        }
    }

    #[test]
    fn the_inside_of_a_ring_has_two_intervals_in_its_middle() {
        let square = |half: f32| {
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| Vec2::new(8.0 + half * x, half * y));
            [0, 1, 2, 3].map(|i| [corners[i], corners[(i + 1) % 4]])
        };
        let mut inside = Inside::default();
        inside.find(square(6.0).into_iter().chain(square(2.0)), 16);
        let spans = |column| inside.spans(column).collect::<Vec<_>>();
        assert_eq!(spans(8), [[-6.0, -2.0], [2.0, 6.0]]);
        assert_eq!(spans(3), [[-6.0, 6.0]]);
        assert_eq!(spans(0), [[0.0; 2]; 0]);
        assert_eq!(spans(99), [[0.0; 2]; 0]);
    }
}
