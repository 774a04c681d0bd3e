//! What the still pictures of one surface share: its triangles and vertices, and a view that fills an area.

use super::camera::{OrbitCamera, Projection};
use super::raster::Vertex;
use glam::{Vec2, Vec3};

/// Nearly parallel rays, so that nearer parts do not look larger.
const FIELD_OF_VIEW_RAD: f32 = 0.22;
/// Largest number of samples, limited by memory: a larger picture gets one sample per pixel.
const MAX_SAMPLES: usize = 12_000_000;

/// Samples per pixel along each axis.
pub(super) const fn samples(width: usize, height: usize) -> usize {
    if width * height * 4 <= MAX_SAMPLES { 2 } else { 1 }
}

/// The triangles whose corners are all in range.
pub(super) fn in_range(triangles: &[[u32; 3]], vertices: usize) -> Vec<[u32; 3]> {
    let is_in_range = |triangle: &&[u32; 3]| triangle.iter().all(|&corner| (corner as usize) < vertices);
    triangles.iter().filter(is_in_range).copied().collect()
}

/// Vertices with area-weighted normals; `albedo` gives the colour of each.
pub(super) fn vertices(
    position_m: &[[f32; 3]],
    triangles: &[[u32; 3]],
    albedo: impl Fn(usize) -> Vec3,
) -> Vec<Vertex> {
    let vertex = |(at, p): (usize, &[f32; 3])| Vertex {
        position_m: Vec3::from_array(*p),
        normal: Vec3::ZERO,
        albedo: albedo(at),
    };
    let mut vertices: Vec<Vertex> = position_m.iter().enumerate().map(vertex).collect();
    for triangle in triangles {
        let [a, b, c] = triangle.map(|corner| vertices[corner as usize].position_m);
        for corner in triangle {
            vertices[*corner as usize].normal += (b - a).cross(c - a);
        }
    }
    for vertex in &mut vertices {
        vertex.normal = vertex.normal.normalize_or_zero();
    }
    vertices
}

/// A camera with nearly parallel rays, seen from direction `towards`.
pub(super) fn camera(centre_m: Vec3, radius_m: f32, towards: Vec3, up: Vec3) -> OrbitCamera {
    OrbitCamera {
        field_of_view_rad: FIELD_OF_VIEW_RAD,
        distance_m: radius_m / (0.5 * FIELD_OF_VIEW_RAD).sin(),
        ..OrbitCamera::framing(centre_m, radius_m, towards, up)
    }
}

/// Distance and principal point at which all points just fit into the area from `low` to `high`, pixels.
pub(super) fn fit(
    mut camera: OrbitCamera,
    [width, height]: [usize; 2],
    [low, high]: [Vec2; 2],
    points_m: &[Vec3],
) -> Projection {
    let extent = |projection: &Projection| {
        let pixels = points_m.iter().filter_map(|point| projection.project(*point));
        pixels.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(min, max), (pixel, _)| {
            (min.min(pixel), max.max(pixel))
        })
    };
    let room = (high - low).max(Vec2::splat(1.0));
    for _ in 0..6 {
        let (min, max) = extent(&camera.projection(width, height));
        let ratio = ((max - min).max(Vec2::splat(1e-3)) / room).max_element();
        if ratio.is_finite() && ratio > 0.0 {
            camera.zoom(ratio);
        }
    }
    let mut projection = camera.projection(width, height);
    let (min, max) = extent(&projection);
    if min.is_finite() && max.is_finite() {
        projection.centre_px += 0.5 * (low + high) - 0.5 * (min + max);
    }
    projection
}
