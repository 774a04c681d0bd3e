//! Solids for markers and tools: sphere, capsule and arrow.

use super::material::Material;
use super::raster::{Raster, Vertex};
use glam::Vec3;

/// Rings of a sphere from pole to pole.
const SPHERE_RINGS: usize = 14;
/// Vertices per ring.
const SIDES: usize = 24;

/// Vertices and triangles of a solid; the buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Shapes {
    vertices: Vec<Vertex>,
    triangles: Vec<[u32; 3]>,
}

impl Shapes {
    /// Draws a sphere.
    pub fn sphere(
        &mut self,
        raster: &mut Raster,
        centre_m: Vec3,
        radius_m: f32,
        albedo: Vec3,
        material: Material,
    ) {
        self.capsule(raster, (centre_m, Vec3::ZERO), radius_m, albedo, material);
    }

    /// Draws a capsule with this centre and half axis.
    pub fn capsule(
        &mut self,
        raster: &mut Raster,
        (centre_m, half_m): (Vec3, Vec3),
        radius_m: f32,
        albedo: Vec3,
        material: Material,
    ) {
        self.clear();
        let axis = half_m.try_normalize().unwrap_or(Vec3::Z);
        let half_ring = SPHERE_RINGS / 2;
        // The ring in the middle once for each end.
        for (ring, end) in
            (0..=half_ring).map(|ring| (ring, 1.0)).chain((half_ring..=SPHERE_RINGS).map(|ring| (ring, -1.0)))
        {
            let (sin, cos) = (core::f32::consts::PI * ring as f32 / SPHERE_RINGS as f32).sin_cos();
            self.ring(
                axis,
                |around| {
                    let normal = around * sin + axis * cos;
                    (centre_m + end * half_m + normal * radius_m, normal)
                },
                albedo,
            );
        }
        raster.draw(&self.vertices, &self.triangles, material);
    }

    /// Draws an arrow from its tail to its tip; the head has the length `head_m`.
    pub fn arrow(
        &mut self,
        raster: &mut Raster,
        (tail_m, tip_m): (Vec3, Vec3),
        radius_m: f32,
        albedo: Vec3,
        material: Material,
    ) {
        let Some(axis) = (tip_m - tail_m).try_normalize() else { return };
        let head_m = (6.5 * radius_m).min(tail_m.distance(tip_m));
        let neck_m = tip_m - axis * head_m;
        let wide_m = head_m * 0.40;
        self.clear();
        let slope = (axis * wide_m, head_m);
        // Each pair of rings shares its normals, so every part is smooth and the edges between parts are
        // sharp.
        let parts: [[(Vec3, f32, f32, f32); 2]; 4] = [
            [(tail_m, 0.0, -1.0, 0.0), (tail_m, radius_m, -1.0, 0.0)],
            [(tail_m, radius_m, 0.0, 1.0), (neck_m, radius_m, 0.0, 1.0)],
            [(neck_m, radius_m, -1.0, 0.0), (neck_m, wide_m, -1.0, 0.0)],
            [(neck_m, wide_m, slope.0.length(), slope.1), (tip_m, 0.0, slope.0.length(), slope.1)],
        ];
        for part in parts {
            self.separate_strip();
            for (centre_m, ring_m, along, outward) in part {
                self.ring(
                    axis,
                    |around| (centre_m + around * ring_m, axis * along + around * outward),
                    albedo,
                );
            }
        }
        raster.draw(&self.vertices, &self.triangles, material);
    }

    fn clear(&mut self) {
        self.vertices.clear();
        self.triangles.clear();
        self.separate_strip();
    }

    /// Separates the next ring from the previous one.
    fn separate_strip(&mut self) {
        self.vertices.extend(core::iter::repeat_n(
            Vertex { position_m: Vec3::NAN, normal: Vec3::ZERO, albedo: Vec3::ZERO },
            SIDES,
        ));
    }

    /// Adds a ring round an axis and connects it to the previous ring; a separating ring (NaN) is not drawn.
    fn ring(&mut self, axis: Vec3, corner: impl Fn(Vec3) -> (Vec3, Vec3), albedo: Vec3) {
        let side = axis.any_orthonormal_vector();
        let other = axis.cross(side);
        let start = self.vertices.len();
        for i in 0..SIDES {
            let (sin, cos) = (core::f32::consts::TAU * i as f32 / SIDES as f32).sin_cos();
            let (position_m, normal) = corner(side * cos + other * sin);
            self.vertices.push(Vertex { position_m, normal, albedo });
        }
        let before = start - SIDES;
        if self.vertices[before].position_m.is_nan() {
            return;
        }
        for i in 0..SIDES {
            let next = (i + 1) % SIDES;
            let [a, b, c, d] = [before + i, before + next, start + next, start + i].map(|index| index as u32);
            // The orientation depends on the order of the rings. Both orientations are added; one is culled.
            let (u, v) = (self.vertices[b as usize], self.vertices[d as usize]);
            let origin = self.vertices[a as usize];
            let outward = (u.position_m - origin.position_m)
                .cross(v.position_m - origin.position_m)
                .dot(origin.normal + u.normal + v.normal);
            let far = self.vertices[c as usize];
            let outward_far = (v.position_m - far.position_m)
                .cross(u.position_m - far.position_m)
                .dot(far.normal + u.normal + v.normal);
            if outward + outward_far >= 0.0 {
                self.triangles.extend([[a, b, d], [c, d, b]]);
            } else {
                self.triangles.extend([[a, d, b], [c, b, d]]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;

    fn raster() -> Raster {
        let camera = OrbitCamera::framing(Vec3::ZERO, 1.0, Vec3::new(1.0, 0.3, 0.4), Vec3::Z);
        Raster::new(200, 200, 1, &camera.projection(200, 200))
    }

    fn covered(raster: &Raster) -> usize {
        (0..200 * 200).filter(|i| raster.inverse_depth_at(i % 200, i / 200) > 0.0).count()
    }

    #[test]
    fn a_sphere_covers_its_disc_without_holes() {
        let mut raster = raster();
        Shapes::default().sphere(&mut raster, Vec3::ZERO, 0.8, Vec3::ONE, Material::Plain);
        let disc = core::f32::consts::PI * 80.0 * 80.0;
        let found = covered(&raster) as f32;
        assert!((found / disc - 1.0).abs() < 0.05, "{found} of {disc}");
        for i in -70..=70 {
            assert!(
                raster.inverse_depth_at(100 + i, 100) > 0.0 && raster.inverse_depth_at(100, 100 + i) > 0.0
            );
        }
    }

    #[test]
    fn an_arrow_is_closed_from_both_ends() {
        for (tail, tip) in [(-0.8, 0.8), (0.8, -0.8)] {
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                let mut raster = raster();
                let ends = (axis * tail, axis * tip);
                Shapes::default().arrow(&mut raster, ends, 0.1, Vec3::ONE, Material::Polished);
                assert!(raster.inverse_depth_at(100, 100) > 0.0, "{axis} {tail}");
                assert!(covered(&raster) > 400, "{axis} {tail}: {}", covered(&raster));
            }
        }
    }

    #[test]
    fn an_arrow_without_length_draws_nothing() {
        let mut raster = raster();
        Shapes::default().arrow(&mut raster, (Vec3::ONE, Vec3::ONE), 0.1, Vec3::ONE, Material::Plain);
        assert_eq!(covered(&raster), 0);
    }
}
