//! Picking: intersection of the ray through a pixel with the current surface.

use glam::Vec3;

/// Intersection of a ray with a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The point, m.
    pub point_m: Vec3,
    /// Outward unit normal of the triangle.
    pub normal: Vec3,
    /// Distance from the origin of the ray, m.
    pub distance_m: f32,
}

/// First triangle that a ray hits from outside.
///
/// All triangles are tested (Moeller and Trumbore 1997): at 30 Hz this costs less than updating a search tree
/// of a moving surface.
#[must_use]
pub fn hit(position_m: &[Vec3], triangles: &[[u32; 3]], (origin_m, direction): (Vec3, Vec3)) -> Option<Hit> {
    let mut best: Option<(f32, Vec3)> = None;
    for triangle in triangles {
        let corner = |i: usize| position_m.get(triangle[i] as usize).copied();
        let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else { continue };
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        let towards = -direction.dot(normal);
        // Back faces and triangles without area. NaN is handled below.
        if towards <= 0.0 {
            continue;
        }
        let from_a = origin_m - a;
        let distance = from_a.dot(normal);
        let across = from_a.cross(direction);
        let (u, v) = (ac.dot(across), -ab.dot(across));
        // All terms have the same positive factor, so only a hit needs a division. NaN fails every
        // comparison.
        let inside = u >= 0.0 && v >= 0.0 && u + v <= towards && distance >= 0.0;
        let distance_m = distance / towards;
        if inside && best.is_none_or(|(nearest_m, _)| distance_m < nearest_m) {
            best = Some((distance_m, normal));
        }
    }
    best.map(|(distance_m, normal)| Hit {
        point_m: origin_m + direction * distance_m,
        normal: normal.normalize_or_zero(),
        distance_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;
    use crate::deformation::Deformation;
    use crate::material::Material;
    use crate::raster::{Raster, Vertex};
    use crate::synthetic::{self, Shape};
    use glam::Vec2;
    use palpate_core::{NodeWeight, Organ};

    /// The rasteriser gives the depth at a pixel: the ray through that pixel must end there.
    #[test]
    fn a_ray_through_a_pixel_hits_the_drawn_surface() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let mut surface = Deformation::at_rest(&organ);
        let whole = [NodeWeight { space: 0, weight: 1.0 }, NodeWeight::default(), NodeWeight::default()];
        surface.update(&organ, &whole, [0.0, -0.02, 0.01]);
        let camera = OrbitCamera::framing(Vec3::ZERO, 0.12, Vec3::new(0.3, -0.9, 0.5), Vec3::Z);
        let projection = camera.projection(320, 240);
        let mut raster = Raster::new(320, 240, 1, &projection);
        let vertex = |(position_m, normal): (&Vec3, &Vec3)| Vertex {
            position_m: *position_m,
            normal: *normal,
            albedo: Vec3::ONE,
        };
        let vertices: Vec<Vertex> = surface.position_m().iter().zip(surface.normal()).map(vertex).collect();
        raster.draw(&vertices, organ.surface.triangles, Material::Plain);
        let (mut hits, mut misses) = (0, 0);
        for (x, y) in (0..240).step_by(7).flat_map(|y| (0..320).step_by(7).map(move |x| (x, y))) {
            let ray = projection.ray(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            let drawn = raster.inverse_depth_at(x, y);
            match hit(surface.position_m(), organ.surface.triangles, ray) {
                Some(hit) => {
                    hits += 1;
                    let depth_m = -projection.eye_point(hit.point_m).z;
                    // Vertices snap to a sixteenth of a pixel, which is some depth at a grazing angle.
                    let slack_m = 0.4e-3 / -hit.normal.dot(ray.1);
                    assert!(drawn > 0.0 && (depth_m - drawn.recip()).abs() < slack_m, "{x} {y}: {depth_m}");
                    assert!(hit.normal.dot(ray.1) < 0.0);
                }
                None => {
                    misses += 1;
                    assert!(drawn == 0.0, "{x} {y} is drawn but not hit");
                }
            }
        }
        assert!(hits > 200 && misses > 200, "{hits} {misses}");
    }

    #[test]
    fn a_surface_behind_the_eye_or_seen_from_inside_is_not_hit() {
        let corners = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];
        let faces = [[0, 1, 2]];
        assert!(hit(&corners, &faces, (Vec3::Z, -Vec3::Z)).is_some());
        assert!(hit(&corners, &faces, (Vec3::Z, Vec3::Z)).is_none());
        assert!(hit(&corners, &faces, (-Vec3::Z, Vec3::Z)).is_none(), "from inside");
        assert!(hit(&corners, &faces, (Vec3::new(3.0, 0.0, 1.0), -Vec3::Z)).is_none());
        assert!(hit(&corners, &faces, (Vec3::NAN, -Vec3::Z)).is_none());
        assert!(hit(&corners, &[[0, 1, 9]], (Vec3::Z, -Vec3::Z)).is_none());
    }
}
