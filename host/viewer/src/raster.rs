//! Software rasteriser: draws triangles into a geometry buffer; each visible sample is shaded once
//! afterwards.
//!
//! It needs no GPU, so a server without display gives the same picture as a desktop. Deferred shading is used
//! because shading costs more than rasterising: a hidden triangle costs only a depth test.

use super::camera::Projection;
use super::material::Material;
use glam::Vec3;

/// Sub-pixel positions per pixel and axis to which vertices snap.
const SUBPIXELS: f32 = 16.0;
/// Triangles with a vertex further than this outside the picture are dropped to save time, pixels.
const GUARD_PX: f32 = 16_384.0;

/// Corner of a triangle in the model frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Position, m.
    pub position_m: Vec3,
    /// Outward normal; need not be of unit length.
    pub normal: Vec3,
    /// Diffuse colour, linear light.
    pub albedo: Vec3,
}

/// One sample of the geometry buffer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surfel {
    /// 1/m; 0 for an empty sample.
    pub(super) inverse_depth: f32,
    /// Normal in the eye frame, not normalised.
    pub(super) normal: Vec3,
    pub(super) albedo: Vec3,
    pub(super) material: Material,
}

const EMPTY: Surfel =
    Surfel { inverse_depth: 0.0, normal: Vec3::Z, albedo: Vec3::ZERO, material: Material::Plain };

/// Half-open rectangle of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bounds {
    pub(super) left: usize,
    pub(super) top: usize,
    pub(super) right: usize,
    pub(super) bottom: usize,
}

impl Bounds {
    const EMPTY: Self = Self { left: usize::MAX, top: usize::MAX, right: 0, bottom: 0 };

    fn include(&mut self, other: Self) {
        self.left = self.left.min(other.left);
        self.top = self.top.min(other.top);
        self.right = self.right.max(other.right);
        self.bottom = self.bottom.max(other.bottom);
    }
}

/// A vertex after projection.
#[derive(Debug, Clone, Copy)]
struct Projected {
    /// Sub-pixel position.
    x: i64,
    y: i64,
    inverse_depth: f32,
    normal: Vec3,
    albedo: Vec3,
}

/// Depth-tested geometry buffer of `width * factor` by `height * factor` samples.
#[derive(Debug, Clone)]
pub struct Raster {
    width: usize,
    height: usize,
    factor: usize,
    surfels: Vec<Surfel>,
    drawn: Bounds,
    projection: Projection,
    /// Scratch.
    corners: Vec<Option<Projected>>,
}

impl Raster {
    /// A buffer for a picture of `width` by `height` pixels with `factor` by `factor` samples per pixel.
    #[must_use]
    pub fn new(width: usize, height: usize, factor: usize, projection: &Projection) -> Self {
        let factor = factor.clamp(1, 4);
        Self {
            width,
            height,
            factor,
            surfels: vec![EMPTY; width * height * factor * factor],
            drawn: Bounds::EMPTY,
            projection: projection.refined(factor),
            corners: Vec::new(),
        }
    }

    /// Clears the buffer and sets the camera.
    pub fn begin(&mut self, projection: &Projection) {
        self.projection = projection.refined(self.factor);
        let stride = self.sample_width();
        // Only the area drawn in the last frame is cleared: the buffer is much larger than the caches.
        for row in self.drawn.top..self.drawn.bottom {
            self.surfels[row * stride + self.drawn.left..row * stride + self.drawn.right].fill(EMPTY);
        }
        self.drawn = Bounds::EMPTY;
    }

    /// Samples per row.
    pub(super) const fn sample_width(&self) -> usize {
        self.width * self.factor
    }

    /// Samples per column.
    pub(super) const fn sample_height(&self) -> usize {
        self.height * self.factor
    }

    /// Samples per pixel along each axis.
    #[must_use]
    pub const fn factor(&self) -> usize {
        self.factor
    }

    pub(super) const fn drawn(&self) -> Bounds {
        self.drawn
    }

    pub(super) fn surfels(&self) -> &[Surfel] {
        &self.surfels
    }

    /// The camera scaled to samples.
    #[must_use]
    pub const fn sample_projection(&self) -> &Projection {
        &self.projection
    }

    /// Inverse depth (1/m) at the middle of a pixel; 0 for the background and outside the picture.
    #[must_use]
    pub fn inverse_depth_at(&self, x: i32, y: i32) -> f32 {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return 0.0 };
        self.middle(x, y).map_or(0.0, |surfel| surfel.inverse_depth)
    }

    /// Whether tissue is visible at the middle of a pixel.
    pub(super) fn is_tissue_at(&self, x: i32, y: i32) -> bool {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return false };
        self.middle(x, y).is_some_and(|surfel| surfel.material == Material::Tissue)
    }

    fn middle(&self, x: usize, y: usize) -> Option<&Surfel> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let middle = self.factor / 2;
        self.surfels.get((y * self.factor + middle) * self.sample_width() + x * self.factor + middle)
    }

    /// Draws a closed surface; back faces are skipped.
    ///
    /// Triangles that cross the near plane are dropped, not clipped: the orbit camera stays outside the
    /// scene.
    pub fn draw(&mut self, vertices: &[Vertex], triangles: &[[u32; 3]], material: Material) {
        let mut corners = core::mem::take(&mut self.corners);
        corners.clear();
        corners.extend(vertices.iter().map(|vertex| self.project(vertex)));
        for triangle in triangles {
            let corner = |i: usize| corners.get(triangle[i] as usize).and_then(Option::as_ref);
            if let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) {
                self.fill(a, b, c, material);
            }
        }
        self.corners = corners;
    }

    fn project(&self, vertex: &Vertex) -> Option<Projected> {
        let (pixel, inverse_depth) = self.projection.project(vertex.position_m)?;
        if !pixel.is_finite() || pixel.abs().max_element() > GUARD_PX {
            return None;
        }
        Some(Projected {
            x: (pixel.x * SUBPIXELS).round() as i64,
            y: (pixel.y * SUBPIXELS).round() as i64,
            inverse_depth,
            normal: self.projection.to_eye * vertex.normal,
            albedo: vertex.albedo,
        })
    }

    /// Fills one triangle with edge functions in integer sub-pixels, so neighbours share an edge without gap
    /// or overlap.
    fn fill(&mut self, a: &Projected, b: &Projected, c: &Projected, material: Material) {
        // y points down, so a triangle that is counter-clockwise to the eye has a negative area here. Use the
        // order a, c, b.
        let (b, c) = (c, b);
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if area <= 0 {
            return;
        }
        let sub = SUBPIXELS as i64;
        // Sample i is at (i + 1/2) pixels: the first one at or after v is ceil(v - 1/2).
        let first = |v: i64| (v - sub / 2 + sub - 1).div_euclid(sub);
        let left = first(a.x.min(b.x).min(c.x)).max(0);
        let top = first(a.y.min(b.y).min(c.y)).max(0);
        let right = ((a.x.max(b.x).max(c.x) - sub / 2).div_euclid(sub) + 1).min(self.sample_width() as i64);
        let bottom = ((a.y.max(b.y).max(c.y) - sub / 2).div_euclid(sub) + 1).min(self.sample_height() as i64);
        if left >= right || top >= bottom {
            return;
        }
        let start = (left * sub + sub / 2, top * sub + sub / 2);
        let edges = [Edge::new(b, c, start), Edge::new(c, a, start), Edge::new(a, b, start)];
        let bounds =
            Bounds { left: left as usize, top: top as usize, right: right as usize, bottom: bottom as usize };
        let scale = (area as f32).recip();
        self.fill_rows(&edges, scale, [a, b, c], &bounds, material);
        self.drawn.include(bounds);
    }

    fn fill_rows(
        &mut self,
        edges: &[Edge; 3],
        scale: f32,
        [a, b, c]: [&Projected; 3],
        bounds: &Bounds,
        material: Material,
    ) {
        let stride = self.sample_width();
        for (row, y) in (bounds.top..bounds.bottom).enumerate() {
            let mut value = edges.map(|edge| edge.start + edge.step_y * row as i64);
            let cells = &mut self.surfels[y * stride + bounds.left..y * stride + bounds.right];
            let mut entered = false;
            for cell in cells {
                // Inside all three edges: no value has its sign bit set.
                if (value[0] | value[1] | value[2]) >= 0 {
                    entered = true;
                    let weight = [
                        (value[0] + edges[0].bias) as f32 * (scale * a.inverse_depth),
                        (value[1] + edges[1].bias) as f32 * (scale * b.inverse_depth),
                        (value[2] + edges[2].bias) as f32 * (scale * c.inverse_depth),
                    ];
                    let inverse_depth = weight[0] + weight[1] + weight[2];
                    if inverse_depth > cell.inverse_depth {
                        let [wa, wb, wc] = weight;
                        let depth = inverse_depth.recip();
                        *cell = Surfel {
                            inverse_depth,
                            normal: a.normal * wa + b.normal * wb + c.normal * wc,
                            albedo: (a.albedo * wa + b.albedo * wb + c.albedo * wc) * depth,
                            material,
                        };
                    }
                } else if entered {
                    break;
                }
                for (value, edge) in value.iter_mut().zip(edges) {
                    *value += edge.step_x;
                }
            }
        }
    }
}

/// Edge function of one side: not negative inside, evaluated at whole pixels.
#[derive(Clone, Copy)]
struct Edge {
    start: i64,
    step_x: i64,
    step_y: i64,
    /// Offset of `start`: 1 on all edges except top and left ones, so that a sample exactly on a shared edge
    /// belongs to one triangle only.
    bias: i64,
}

impl Edge {
    fn new(from: &Projected, to: &Projected, start: (i64, i64)) -> Self {
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let value = dx * (start.1 - from.y) - dy * (start.0 - from.x);
        let sub = SUBPIXELS as i64;
        let top_or_left = dy < 0 || (dy == 0 && dx > 0);
        let bias = i64::from(!top_or_left);
        Self { start: value - bias, step_x: -dy * sub, step_y: dx * sub, bias }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat3, Vec2};

    /// Camera at a distance of one metre with one pixel per unit: model coordinates are pixels with y up.
    fn flat(width: usize, height: usize) -> Projection {
        Projection {
            eye_m: Vec3::new(0.0, 0.0, 1.0),
            to_eye: Mat3::IDENTITY,
            up: Vec3::Y,
            focal_px: 1.0,
            centre_px: Vec2::new(0.5 * width as f32, 0.5 * height as f32),
            near_m: 0.01,
        }
    }

    fn vertex(x: f32, y: f32, z: f32, albedo: Vec3) -> Vertex {
        // Compensate the perspective, so that x and y are pixels at any depth.
        let depth = 1.0 - z;
        Vertex { position_m: Vec3::new(x * depth, y * depth, z), normal: Vec3::Z, albedo }
    }

    fn covered(raster: &Raster) -> Vec<(i32, i32)> {
        let mut found = Vec::new();
        for y in 0..raster.height as i32 {
            for x in 0..raster.width as i32 {
                if raster.inverse_depth_at(x, y) > 0.0 {
                    found.push((x, y));
                }
            }
        }
        found
    }

    #[test]
    fn a_known_triangle_covers_exactly_its_pixels() {
        let mut raster = Raster::new(8, 8, 1, &flat(8, 8));
        // Right angle at the lower left of the middle square: pixels whose centre has x + y <= 4 from that
        // corner.
        let corners = [(-4.0, -4.0), (0.0, -4.0), (-4.0, 0.0)].map(|(x, y)| vertex(x, y, 0.0, Vec3::ONE));
        raster.draw(&corners, &[[0, 1, 2]], Material::Plain);
        let mut expected = Vec::new();
        for y in 0..8 {
            for x in 0..8 {
                let (right, up) = (x as f32 + 0.5, 8.0 - (y as f32 + 0.5));
                if right + up < 4.0 {
                    expected.push((x, y));
                }
            }
        }
        let found = covered(&raster);
        // Centres exactly on the hypotenuse belong to one of the two triangles (see the next test).
        assert!(expected.iter().all(|pixel| found.contains(pixel)));
        assert!(found.iter().all(|&(x, y)| x as f32 + 0.5 + 8.0 - (y as f32 + 0.5) <= 4.0));
    }

    #[test]
    fn two_halves_of_a_square_cover_every_sample_once() {
        let square =
            [(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)].map(|(x, y)| vertex(x, y, 0.0, Vec3::ONE));
        let halves = [[0_u32, 1, 2], [0, 2, 3]];
        let mut count = 0;
        for half in halves {
            let mut raster = Raster::new(8, 8, 1, &flat(8, 8));
            raster.draw(&square, &[half], Material::Plain);
            count += covered(&raster).len();
        }
        assert_eq!(count, 36);
    }

    #[test]
    fn the_nearer_triangle_wins_in_either_order() {
        let (red, blue) = (Vec3::X, Vec3::Z);
        let near = [(-4.0, -4.0), (4.0, -4.0), (0.0, 4.0)].map(|(x, y)| vertex(x, y, 0.5, red));
        let far = [(-4.0, -4.0), (4.0, -4.0), (0.0, 4.0)].map(|(x, y)| vertex(x, y, -0.5, blue));
        for near_first in [true, false] {
            let mut raster = Raster::new(8, 8, 1, &flat(8, 8));
            let order = if near_first { [&near, &far] } else { [&far, &near] };
            for corners in order {
                raster.draw(corners, &[[0, 1, 2]], Material::Plain);
            }
            let middle = raster.surfels[4 * 8 + 4];
            assert!((middle.albedo - red).length() < 1e-5, "{middle:?}");
            assert!((middle.inverse_depth - 2.0).abs() < 1e-5);
        }
    }

    #[test]
    fn colours_are_interpolated_in_perspective() {
        // A floor-like edge from depth 1 to depth 3: its midpoint in the picture is a quarter of the way
        // along the edge.
        let mut raster = Raster::new(64, 8, 1, &flat(64, 8));
        let corners = [
            vertex(-32.0, -4.0, 0.0, Vec3::ZERO),
            vertex(32.0, -4.0, -2.0, Vec3::ONE),
            vertex(32.0, 4.0, -2.0, Vec3::ONE),
            vertex(-32.0, 4.0, 0.0, Vec3::ZERO),
        ];
        raster.draw(&corners, &[[0, 1, 2], [0, 2, 3]], Material::Plain);
        let middle = raster.surfels[4 * 64 + 32];
        assert!((middle.albedo.x - 0.25).abs() < 0.02, "{}", middle.albedo.x);
    }

    #[test]
    fn back_faces_and_invalid_vertices_are_not_drawn() {
        let mut raster = Raster::new(8, 8, 1, &flat(8, 8));
        let corners = [(-4.0, -4.0), (4.0, -4.0), (0.0, 4.0)].map(|(x, y)| vertex(x, y, 0.0, Vec3::ONE));
        raster.draw(&corners, &[[0, 2, 1], [0, 1, 7]], Material::Plain);
        let mut broken = corners;
        broken[1].position_m.x = f32::NAN;
        raster.draw(&broken, &[[0, 1, 2]], Material::Plain);
        assert!(covered(&raster).is_empty());
    }

    #[test]
    fn a_new_frame_starts_empty() {
        let mut raster = Raster::new(8, 8, 2, &flat(8, 8));
        let corners = [(-4.0, -4.0), (4.0, -4.0), (0.0, 4.0)].map(|(x, y)| vertex(x, y, 0.0, Vec3::ONE));
        raster.draw(&corners, &[[0, 1, 2]], Material::Plain);
        assert!(!covered(&raster).is_empty());
        raster.begin(&flat(8, 8));
        assert!(raster.surfels.iter().all(|surfel| *surfel == EMPTY));
    }
}
