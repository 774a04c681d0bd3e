//! Draws the shapes: the solid, the transparent ones with mesh and outline, and the outline at rest.

use super::surface::{REST_COLOUR, Surface};
use super::{Comparison, GLASS, Painter};
use crate::image::Image;
use crate::material::Material;
use crate::palette::{BRIGHT, linear};
use crate::raster::Vertex;
use crate::scene::edges;
use crate::shapes::Shapes;
use glam::Vec3;

impl Painter {
    pub(super) fn solid(&mut self, comparison: &Comparison, surface: &Surface, image: &mut Image) {
        self.raster.draw(surface.solid(), surface.smooth.triangles(), Material::Tissue);
        let [_, to] = comparison.pull_m.map(Vec3::from_array);
        if let Some((_, inverse_depth)) = self.projection.project(to) {
            let radius_m = 5.5 * self.layout.scale / (self.projection.focal_px * inverse_depth);
            Shapes::default().sphere(&mut self.raster, to, radius_m, linear(BRIGHT), Material::Polished);
        }
        self.shader.resolve(&self.raster, image);
    }

    /// Draws a transparent shape over the picture: tint, mesh, outline.
    pub(super) fn glass(&mut self, surface: &Surface, index: usize, colour: u32, image: &mut Image) {
        let vertices = &surface.shapes[index];
        self.glass.begin(&self.projection);
        self.glass.draw(vertices, surface.smooth.triangles(), Material::Plain);
        let mut lit = Image::new(image.width(), image.height());
        self.shader.resolve(&self.glass, &mut lit);
        // A gap below this is not visible. Without the fade, surfaces that nearly agree would show patches.
        let visible_m = 1.5 / (self.projection.focal_px * self.depth_scale(vertices));
        let factor = self.glass.factor();
        let stride = self.glass.sample_width();
        let share = ((factor * factor) as f32).recip();
        for y in 0..image.height() {
            for x in 0..image.width() {
                let mut weight = 0.0;
                for sample_y in y * factor..(y + 1) * factor {
                    for sample_x in x * factor..(x + 1) * factor {
                        let at = sample_y * stride + sample_x;
                        let front = self.glass.surfels()[at].inverse_depth;
                        let behind = self.raster.surfels()[at].inverse_depth;
                        weight += match (front > 0.0, behind > 0.0) {
                            (false, _) => 0.0,
                            (true, false) => GLASS[0],
                            (true, true) => {
                                GLASS[1] * smooth_step((behind.recip() - front.recip()) / (6.0 * visible_m))
                            }
                        };
                    }
                }
                if weight > 0.0 {
                    let tint = lit.pixel(x, y).unwrap_or(0);
                    image.blend(x as i32, y as i32, tint, weight * share);
                }
            }
        }
        self.mesh(surface, vertices, colour, image);
        self.outline(surface, vertices, (colour, 1.0), image);
    }

    /// Inverse depth at the middle of a shape, 1/m, for the conversion of pixels to metres.
    fn depth_scale(&self, vertices: &[Vertex]) -> f32 {
        let middle =
            vertices.iter().map(|vertex| vertex.position_m).sum::<Vec3>() / vertices.len().max(1) as f32;
        self.projection.project(middle).map_or(1.0, |(_, inverse_depth)| inverse_depth)
    }

    /// Visible mesh lines of a transparent shape; the opacity increases with the distance from the solid.
    fn mesh(&mut self, surface: &Surface, vertices: &[Vertex], colour: u32, image: &mut Image) {
        let solid = surface.solid();
        let clear_m = 26.0 * self.layout.scale / (self.projection.focal_px * self.depth_scale(vertices));
        let weight_of = |vertex: u32| {
            let vertex = vertex as usize;
            let separation = solid
                .get(vertex)
                .map_or(f32::MAX, |other| vertices[vertex].position_m.distance(other.position_m));
            smooth_step((separation / clear_m - 0.08) / 0.9)
        };
        self.mask.reset(0, 0, image.width(), image.height());
        for ends in &surface.mesh {
            let weights = ends.map(weight_of);
            if weights == [0.0; 2] {
                continue;
            }
            let Some(line) = self.line(vertices, *ends) else { continue };
            self.mask.segment_where(line.from, line.to, 0.35 * self.layout.scale.max(0.7), |x, y, t| {
                let inverse_depth = line.inverse_depth(t) * 1.003;
                let hidden = self.glass.inverse_depth_at(x, y) > inverse_depth
                    || self.raster.inverse_depth_at(x, y) > inverse_depth;
                if hidden { 0.0 } else { weights[0] + (weights[1] - weights[0]) * t }
            });
        }
        self.mask.paint(image, colour, 0.50);
    }

    /// Outline of the shape in the second raster.
    fn outline(
        &mut self,
        surface: &Surface,
        vertices: &[Vertex],
        (colour, alpha): (u32, f32),
        image: &mut Image,
    ) {
        let position_m: Vec<Vec3> = vertices.iter().map(|vertex| vertex.position_m).collect();
        self.mask.reset(0, 0, image.width(), image.height());
        for edge in edges(surface.smooth.triangles(), &position_m) {
            let start = position_m[edge.ends[0] as usize];
            let [one, other] = edge.normals.map(|normal| normal.dot(self.projection.eye_m - start) > 0.0);
            if one == other {
                continue;
            }
            let Some(line) = self.line(vertices, edge.ends) else { continue };
            self.mask.segment_where(line.from, line.to, 0.8 * self.layout.scale.max(0.6), |x, y, t| {
                let inverse_depth = line.inverse_depth(t);
                if self.glass.inverse_depth_at(x, y) > inverse_depth * 1.006 {
                    0.0
                } else if self.raster.inverse_depth_at(x, y) > inverse_depth * 1.003 {
                    0.35
                } else {
                    1.0
                }
            });
        }
        self.mask.paint(image, colour, alpha);
    }

    fn line(&self, vertices: &[Vertex], ends: [u32; 2]) -> Option<Line> {
        let [a, b] = ends.map(|end| vertices.get(end as usize).map(|vertex| vertex.position_m));
        let ((from, near_from), (to, near_to)) = (self.projection.project(a?)?, self.projection.project(b?)?);
        Some(Line { from: from.to_array(), to: to.to_array(), ends: [near_from, near_to] })
    }

    pub(super) fn rest(&mut self, surface: &Surface, image: &mut Image) {
        self.glass.begin(&self.projection);
        self.glass.draw(&surface.rest, surface.smooth.triangles(), Material::Plain);
        self.outline(surface, &surface.rest, (REST_COLOUR, 0.6), image);
    }
}

/// A projected segment.
struct Line {
    from: [f32; 2],
    to: [f32; 2],
    /// Inverse depth at both ends, 1/m.
    ends: [f32; 2],
}

impl Line {
    fn inverse_depth(&self, t: f32) -> f32 {
        self.ends[0] + (self.ends[1] - self.ends[0]) * t
    }
}

fn smooth_step(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
