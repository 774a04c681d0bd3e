//! The surfaces of a comparison, and the view of them.

use super::{Comparison, Layout, SOLID_COLOUR, colours};
use crate::camera::{OrbitCamera, Projection};
use crate::palette::linear;
use crate::raster::Vertex;
use crate::scene::{FIXED_COLOUR, edges};
use crate::smooth::Smooth;
use crate::still::{camera, fit, in_range, vertices};
use crate::viewpoint::{box_of, longest_axis, up_axis};
use glam::Vec3;

pub(super) const REST_COLOUR: u32 = 0xc3_ccd6;
/// The refined surfaces: the rest shape and every shape (empty for one that cannot be drawn).
pub(super) struct Surface {
    pub(super) smooth: Smooth,
    /// Mesh edges, subdivided on the refined surface.
    pub(super) mesh: Vec<[u32; 2]>,
    pub(super) rest: Vec<Vertex>,
    pub(super) shapes: Vec<Vec<Vertex>>,
    solid: usize,
}

impl Surface {
    pub(super) fn new(comparison: &Comparison) -> Self {
        let count = comparison.rest_m.len();
        let triangles = in_range(&comparison.triangles, count);
        let smooth = Smooth::new(&triangles, count);
        let rest_m: Vec<Vec3> = comparison.rest_m.iter().map(|p| Vec3::from_array(*p)).collect();
        let ends: Vec<[u32; 2]> = edges(&triangles, &rest_m).iter().map(|edge| edge.ends).collect();
        let refined = |position_m: &[[f32; 3]], colour: u32| {
            if position_m.len() != count {
                return Vec::new();
            }
            let is_held = |at: usize| colour == SOLID_COLOUR && comparison.fixed.get(at) == Some(&true);
            let albedo = |at| linear(if is_held(at) { FIXED_COLOUR } else { colour });
            let mut vertices = vertices(position_m, &triangles, albedo);
            smooth.refine(&mut vertices);
            vertices
        };
        let shapes = comparison.shapes.iter().zip(colours(comparison));
        Self {
            mesh: smooth.pieces(&ends, count),
            rest: refined(&comparison.rest_m, REST_COLOUR),
            shapes: shapes.map(|(shape, colour)| refined(&shape.position_m, colour)).collect(),
            solid: comparison.solid,
            smooth,
        }
    }

    /// Vertices of the solid; empty if there is none.
    pub(super) fn solid(&self) -> &[Vertex] {
        self.shapes.get(self.solid).map_or(&[], Vec::as_slice)
    }

    pub(super) fn all(&self) -> impl Iterator<Item = Vec3> {
        self.shapes.iter().flatten().chain(&self.rest).map(|vertex| vertex.position_m)
    }
}

/// A side view: the pull in profile, the differences across the line of sight, and the prescribed vertex not
/// facing away.
pub(super) fn viewpoint(comparison: &Comparison, surface: &Surface, layout: &Layout) -> Projection {
    let rest: Vec<Vec3> = comparison.rest_m.iter().map(|p| Vec3::from_array(*p)).collect();
    let (centre_m, radius_m) = box_of(&rest);
    let outward = Vec3::from_array(comparison.outward).normalize_or_zero();
    let [from, to] = comparison.pull_m.map(Vec3::from_array);
    let pull = (to - from).normalize_or(outward);
    let up = up_axis(&[outward], longest_axis(&rest, centre_m));
    let differences: Vec<Vec3> = surface
        .shapes
        .iter()
        .filter(|shape| !shape.is_empty() && !surface.solid().is_empty())
        .flat_map(|shape| {
            let pairs = shape.iter().zip(surface.solid()).take(rest.len());
            pairs.map(|(one, other)| one.position_m - other.position_m)
        })
        .collect();
    let fixed: Vec<Vec3> = surface
        .rest
        .iter()
        .zip(&comparison.fixed)
        .filter(|(_, fixed)| **fixed)
        .map(|(vertex, _)| vertex.normal)
        .collect();
    let all = differences.iter().map(|d| d.length_squared()).sum::<f32>().max(f32::MIN_POSITIVE);
    let merit = |camera: &OrbitCamera| {
        let projection = camera.projection(1, 1);
        let view = projection.to_eye.row(2);
        let right = projection.to_eye.row(0);
        let across: f32 = differences.iter().map(|d| d.length_squared() - d.dot(view).powi(2)).sum();
        let (low, high) = rest
            .iter()
            .map(|point| right.dot(*point - centre_m))
            .fold((0.0_f32, 0.0_f32), |(low, high), x| (low.min(x), high.max(x)));
        let facing = outward.dot(view);
        let held = fixed.iter().filter(|normal| normal.dot(view) > 0.1).count() as f32;
        let profile = 1.0 - pull.dot(view).powi(2);
        2.0 * profile
            + across / all
            + 0.7 * (high - low) / (2.0 * radius_m)
            + facing.clamp(-0.6, 0.25)
            + 0.35 * held / fixed.len().max(1) as f32
    };
    let best = (0..72)
        .flat_map(|azimuth| [0.08, 0.22, 0.36].map(|elevation| (azimuth, elevation)))
        .map(|(azimuth, elevation_rad)| OrbitCamera {
            azimuth_rad: core::f32::consts::TAU * azimuth as f32 / 72.0,
            elevation_rad,
            ..camera(centre_m, radius_m, outward, up)
        })
        .max_by(|a, b| merit(a).total_cmp(&merit(b)))
        .unwrap_or_else(|| camera(centre_m, radius_m, outward, up));
    let points_m: Vec<Vec3> = surface.all().chain([from, to]).collect();
    fit(best, layout.size.to_array().map(|pixels| pixels as usize), layout.free, &points_m)
}
