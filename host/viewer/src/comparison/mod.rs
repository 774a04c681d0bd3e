//! A still picture of several deformed shapes of one surface on top of each other, like the paper's Fig. 5.
//!
//! One shape is a shaded solid. The others are transparent in different colours, each with its outline and,
//! outside the solid, its mesh; inside the solid only a faint outline is drawn. The rest shape is a grey
//! outline. A key on the right names the shapes and lists values supplied by the caller. This module is
//! independent of the meaning of the shapes.

use super::camera::{OrbitCamera, Projection};
use super::font::{Align, TextStyle, Typeface};
use super::image::{Image, StrokeMask};
use super::material::Material;
use super::palette::{BRIGHT, MUTED, WAITING, linear};
use super::raster::{Raster, Vertex};
use super::scene::{FIXED_COLOUR, edges};
use super::shade::Shader;
use super::shapes::Shapes;
use super::smooth::Smooth;
use super::viewpoint::{box_of, longest_axis, up_axis};
use glam::{Vec2, Vec3};

const REST_COLOUR: u32 = 0xc3_ccd6;
const SOLID_COLOUR: u32 = 0xb8_4f3c;
/// Colours of the other shapes, distinguishable from each other and from the solid with colour blindness too.
const COLOURS: [u32; 6] = [0x46_c8ff, 0xff_d84d, 0xc9_8bff, 0x6f_e39a, 0xff_9ec4, 0xf2_efe6];
/// Opacity of a transparent shape over the background, and over the solid, whose form must stay visible.
const GLASS: [f32; 2] = [0.42, 0.17];
/// Nearly parallel rays, so that nearer parts do not look larger.
const FIELD_OF_VIEW_RAD: f32 = 0.22;
/// Largest number of samples, limited by memory: a larger picture gets one sample per pixel.
const MAX_SAMPLES: usize = 12_000_000;

/// Content of the picture.
#[derive(Debug, Clone, Default)]
pub struct Comparison {
    /// Heading.
    pub title: String,
    /// Lines below the heading.
    pub subtitle: Vec<String>,
    /// The surface, counter-clockwise seen from outside; the corners index `rest_m`.
    pub triangles: Vec<[u32; 3]>,
    /// Vertices at rest, m.
    pub rest_m: Vec<[f32; 3]>,
    /// Whether each vertex is fixed.
    pub fixed: Vec<bool>,
    /// Position of the prescribed vertex at rest and displaced, m.
    pub pull_m: [[f32; 3]; 2],
    /// Outward normal at the prescribed vertex.
    pub outward: [f32; 3],
    /// The shapes.
    pub shapes: Vec<DeformedShape>,
    /// Index of the solid shape.
    pub solid: usize,
}

/// One shape.
#[derive(Debug, Clone, Default)]
pub struct DeformedShape {
    /// Its name in the key.
    pub name: String,
    /// Vertices, m, in the order of `rest_m`.
    pub position_m: Vec<[f32; 3]>,
    /// Label and value of each line in the key.
    pub values: Vec<[String; 2]>,
    /// A short warning below the values.
    pub note: Option<String>,
}

/// Draws the comparison. A shape with a different number of vertices, or a corner out of range, is not drawn.
#[must_use]
pub fn draw(comparison: &Comparison, width: usize, height: usize) -> Image {
    let mut image = Image::new(width, height);
    let surface = Surface::new(comparison);
    let layout = Layout::new(width, height);
    let projection = viewpoint(comparison, &surface, &layout);
    let factor = if width * height * 4 <= MAX_SAMPLES { 2 } else { 1 };
    let mut painter = Painter {
        raster: Raster::new(width, height, factor, &projection),
        glass: Raster::new(width, height, factor, &projection),
        shader: Shader::new(),
        mask: StrokeMask::default(),
        face: Typeface::new(),
        projection,
        layout,
    };
    painter.solid(comparison, &surface, &mut image);
    for (index, (shape, colour)) in surface.shapes.iter().zip(colours(comparison)).enumerate() {
        if index != comparison.solid && !shape.is_empty() {
            painter.glass(&surface, index, colour, &mut image);
        }
    }
    painter.rest(&surface, &mut image);
    painter.pull(comparison, &mut image);
    painter.key(comparison, &mut image);
    painter.captions(comparison, &mut image);
    image
}

/// Colour of every shape: the solid has its own, the others use the list in order.
fn colours(comparison: &Comparison) -> Vec<u32> {
    let mut others = COLOURS.into_iter().cycle();
    (0..comparison.shapes.len())
        .map(|index| if index == comparison.solid { SOLID_COLOUR } else { others.next().unwrap_or(BRIGHT) })
        .collect()
}

/// Layout, in pixels.
#[derive(Debug, Clone, Copy)]
struct Layout {
    scale: f32,
    size: Vec2,
    /// Left edge of the key.
    key_left: f32,
    /// Corners of the area for the shapes.
    free: [Vec2; 2],
}

impl Layout {
    fn new(width: usize, height: usize) -> Self {
        let size = Vec2::new(width as f32, height as f32);
        let scale = (size.y / 720.0).min(size.x / 1280.0).max(0.05);
        let key_left = size.x - 268.0 * scale;
        let free =
            [Vec2::new(56.0, 116.0) * scale, Vec2::new(key_left - 40.0 * scale, size.y - 78.0 * scale)];
        Self { scale, size, key_left, free }
    }
}

/// The refined surfaces: the rest shape and every shape (empty for one that cannot be drawn).
struct Surface {
    smooth: Smooth,
    /// Mesh edges, subdivided on the refined surface.
    mesh: Vec<[u32; 2]>,
    rest: Vec<Vertex>,
    shapes: Vec<Vec<Vertex>>,
    solid: usize,
}

impl Surface {
    fn new(comparison: &Comparison) -> Self {
        let count = comparison.rest_m.len();
        let in_range = |triangle: &&[u32; 3]| triangle.iter().all(|&corner| (corner as usize) < count);
        let triangles: Vec<[u32; 3]> = comparison.triangles.iter().filter(in_range).copied().collect();
        let smooth = Smooth::new(&triangles, count);
        let rest_m: Vec<Vec3> = comparison.rest_m.iter().map(|p| Vec3::from_array(*p)).collect();
        let ends: Vec<[u32; 2]> = edges(&triangles, &rest_m).iter().map(|edge| edge.ends).collect();
        let refined = |position_m: &[[f32; 3]], colour: u32| {
            if position_m.len() != count {
                return Vec::new();
            }
            let mut vertices = vertices(position_m, &triangles, linear(colour));
            for (vertex, fixed) in vertices.iter_mut().zip(&comparison.fixed) {
                if *fixed && colour == SOLID_COLOUR {
                    vertex.albedo = linear(FIXED_COLOUR);
                }
            }
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
    fn solid(&self) -> &[Vertex] {
        self.shapes.get(self.solid).map_or(&[], Vec::as_slice)
    }

    fn all(&self) -> impl Iterator<Item = Vec3> {
        self.shapes.iter().flatten().chain(&self.rest).map(|vertex| vertex.position_m)
    }
}

/// Vertices with area-weighted normals.
fn vertices(position_m: &[[f32; 3]], triangles: &[[u32; 3]], albedo: Vec3) -> Vec<Vertex> {
    let vertex = |p: &[f32; 3]| Vertex { position_m: Vec3::from_array(*p), normal: Vec3::ZERO, albedo };
    let mut vertices: Vec<Vertex> = position_m.iter().map(vertex).collect();
    for triangle in triangles {
        let [a, b, c] = triangle.map(|corner| vertices[corner as usize].position_m);
        let normal = (b - a).cross(c - a);
        for corner in triangle {
            vertices[*corner as usize].normal += normal;
        }
    }
    for vertex in &mut vertices {
        vertex.normal = vertex.normal.normalize_or_zero();
    }
    vertices
}

/// A side view: the pull in profile, the differences across the line of sight, and the prescribed vertex not
/// facing away.
fn viewpoint(comparison: &Comparison, surface: &Surface, layout: &Layout) -> Projection {
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
    let mut camera = (0..72)
        .flat_map(|azimuth| [0.08, 0.22, 0.36].map(|elevation| (azimuth, elevation)))
        .map(|(azimuth, elevation_rad)| OrbitCamera {
            azimuth_rad: core::f32::consts::TAU * azimuth as f32 / 72.0,
            elevation_rad,
            field_of_view_rad: FIELD_OF_VIEW_RAD,
            distance_m: radius_m / (0.5 * FIELD_OF_VIEW_RAD).sin(),
            ..OrbitCamera::framing(centre_m, radius_m, outward, up)
        })
        .max_by(|a, b| merit(a).total_cmp(&merit(b)))
        .unwrap_or_else(|| OrbitCamera::framing(centre_m, radius_m, outward, up));
    frame(surface, layout, [from, to], &mut camera)
}

/// Distance and principal point at which all points just fit into the free area.
fn frame(surface: &Surface, layout: &Layout, pull_m: [Vec3; 2], camera: &mut OrbitCamera) -> Projection {
    let [low, high] = layout.free;
    let room = (high - low).max(Vec2::splat(1.0));
    let picture = |camera: &OrbitCamera| camera.projection(layout.size.x as usize, layout.size.y as usize);
    let extent = |projection: &Projection| {
        surface
            .all()
            .chain(pull_m)
            .filter_map(|point| projection.project(point))
            .fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(min, max), (pixel, _)| {
                (min.min(pixel), max.max(pixel))
            })
    };
    for _ in 0..6 {
        let (min, max) = extent(&picture(camera));
        let ratio = ((max - min).max(Vec2::splat(1e-3)) / room).max_element();
        if ratio.is_finite() && ratio > 0.0 {
            camera.zoom(ratio);
        }
    }
    let mut projection = picture(camera);
    let (min, max) = extent(&projection);
    if min.is_finite() && max.is_finite() {
        projection.centre_px += 0.5 * (low + high) - 0.5 * (min + max);
    }
    projection
}

struct Painter {
    raster: Raster,
    glass: Raster,
    shader: Shader,
    mask: StrokeMask,
    face: Typeface,
    projection: Projection,
    layout: Layout,
}

impl Painter {
    fn solid(&mut self, comparison: &Comparison, surface: &Surface, image: &mut Image) {
        self.raster.draw(surface.solid(), surface.smooth.triangles(), Material::Tissue);
        let [_, to] = comparison.pull_m.map(Vec3::from_array);
        if let Some((_, inverse_depth)) = self.projection.project(to) {
            let radius_m = 5.5 * self.layout.scale / (self.projection.focal_px * inverse_depth);
            Shapes::default().sphere(&mut self.raster, to, radius_m, linear(BRIGHT), Material::Polished);
        }
        self.shader.resolve(&self.raster, image);
    }

    /// Draws a transparent shape over the picture: tint, mesh, outline.
    fn glass(&mut self, surface: &Surface, index: usize, colour: u32, image: &mut Image) {
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

    fn rest(&mut self, surface: &Surface, image: &mut Image) {
        self.glass.begin(&self.projection);
        self.glass.draw(&surface.rest, surface.smooth.triangles(), Material::Plain);
        self.outline(surface, &surface.rest, (REST_COLOUR, 0.6), image);
    }

    /// Arrow from the rest position of the prescribed vertex to its displaced position, with the length in
    /// mm.
    fn pull(&mut self, comparison: &Comparison, image: &mut Image) {
        let [from_m, to_m] = comparison.pull_m.map(Vec3::from_array);
        let (Some((from, _)), Some((to, _))) =
            (self.projection.project(from_m), self.projection.project(to_m))
        else {
            return;
        };
        let scale = self.layout.scale;
        let along = (to - from).normalize_or(Vec2::X);
        let side = along.perp();
        let tip = to - along * 8.0 * scale;
        let head =
            [tip - along * 9.0 * scale + side * 4.5 * scale, tip - along * 9.0 * scale - side * 4.5 * scale];
        for (colour, half_width, alpha) in [(0x10_1418, 2.2, 0.6), (BRIGHT, 0.9, 1.0)] {
            self.mask.reset(0, 0, image.width(), image.height());
            self.mask.segment(from.to_array(), from.to_array(), (half_width + 1.6) * scale, 1.0);
            if from.distance(to) > 20.0 * scale {
                self.mask.segment(from.to_array(), tip.to_array(), half_width * scale, 1.0);
                for end in head {
                    self.mask.segment(tip.to_array(), end.to_array(), half_width * scale, 1.0);
                }
            }
            self.mask.paint(image, colour, alpha);
        }
        // To the right of a steep shaft, below a horizontal one.
        let side = if side.x.abs() < 0.5 { side * side.y.signum() } else { side * side.x.signum() };
        let text = format!("{:.4}", 1e3 * from_m.distance(to_m));
        let text = format!("{} mm", text.trim_end_matches('0').trim_end_matches('.'));
        let at = 0.5 * (from + to)
            + side * 14.0 * scale
            + Vec2::new(0.0, (0.5 + 0.5 * side.y.abs()) * 10.0 * scale);
        let align = if side.x < 0.5 { Align::Centre } else { Align::Left };
        let style = TextStyle::new(10.0 * scale, BRIGHT);
        self.face.draw_with_halo(image, &text, at.into(), align, style);
    }

    /// Draws the key: names of the shapes and their values.
    fn key(&mut self, comparison: &Comparison, image: &mut Image) {
        let lines = |shape: &DeformedShape| 1.6 + shape.values.len() as f32 + f32::from(shape.note.is_some());
        let height = comparison.shapes.iter().map(|shape| 21.0 * lines(shape) + 22.0).sum::<f32>();
        let page = self.layout.size.y / self.layout.scale;
        let scale = self.layout.scale * ((page - 190.0) / height).min(1.0);
        let left = self.layout.key_left;
        let right = self.layout.size.x - 40.0 * self.layout.scale;
        let label = TextStyle::new(9.5 * scale, MUTED);
        let mut y = 54.0 * self.layout.scale;
        for (index, (shape, colour)) in comparison.shapes.iter().zip(colours(comparison)).enumerate() {
            let swatch = (left, y - 5.5 * scale);
            self.swatch(image, swatch, colour, if index == comparison.solid { 1.0 } else { GLASS[0] }, scale);
            let name = TextStyle::new(11.0 * scale, BRIGHT);
            self.face.draw(image, &shape.name, left + 32.0 * scale, y, Align::Left, name);
            y += 4.0 * scale;
            for [what, value] in &shape.values {
                y += 21.0 * scale;
                self.face.draw(image, what, left + 32.0 * scale, y, Align::Left, label);
                let style = TextStyle::new(9.5 * scale, BRIGHT);
                self.face.draw(image, value, right, y, Align::Right, style);
            }
            if let Some(note) = &shape.note {
                y += 21.0 * scale;
                let style = TextStyle::new(9.5 * scale, WAITING);
                self.face.draw(image, note, left + 32.0 * scale, y, Align::Left, style);
            }
            y += 38.0 * scale;
        }
        let scale = self.layout.scale;
        let mut y = self.layout.size.y - 40.0 * scale;
        let label = TextStyle::new(9.5 * scale, MUTED);
        if comparison.fixed.contains(&true) {
            self.swatch(image, (left, y - 4.5 * scale), FIXED_COLOUR, 1.0, scale);
            self.face.draw(image, "held fixed", left + 32.0 * scale, y, Align::Left, label);
            y -= 22.0 * scale;
        }
        self.swatch(image, (left, y - 4.5 * scale), REST_COLOUR, 0.0, scale);
        self.face.draw(image, "at rest", left + 32.0 * scale, y, Align::Left, label);
    }

    /// A swatch in the shape's colour: filled for a solid, outlined with a tint for a transparent shape.
    fn swatch(&mut self, image: &mut Image, (x, y): (f32, f32), colour: u32, fill: f32, scale: f32) {
        let (from, to) = ([x + 5.0 * scale, y], [x + 17.0 * scale, y]);
        let margin = 8.0 * scale;
        let mut pill = |half_width: f32, colour: u32, alpha: f32| {
            self.mask.reset(
                (x - margin) as i32,
                (y - margin) as i32,
                (24.0 * scale + 2.0 * margin) as usize + 2,
                (2.0 * margin) as usize + 2,
            );
            self.mask.segment(from, to, half_width, 1.0);
            self.mask.paint(image, colour, alpha);
        };
        pill(5.5 * scale, colour, 1.0);
        if fill < 1.0 {
            pill(4.0 * scale, 0x1c_2129, 1.0);
            pill(4.0 * scale, colour, fill);
        }
    }

    fn captions(&mut self, comparison: &Comparison, image: &mut Image) {
        let scale = self.layout.scale;
        let (x, mut y) = (40.0 * scale, 56.0 * scale);
        let mark = TextStyle::new(17.0 * scale, BRIGHT);
        self.face.draw(image, &comparison.title, x, y, Align::Left, mark);
        y += 6.0 * scale;
        for line in &comparison.subtitle {
            y += 21.0 * scale;
            self.face.draw(image, line, x, y, Align::Left, TextStyle::new(9.5 * scale, MUTED));
        }
        self.scale_bar(comparison, image);
    }

    /// Scale bar of a round length at the depth of the prescribed vertex.
    fn scale_bar(&mut self, comparison: &Comparison, image: &mut Image) {
        let scale = self.layout.scale;
        let Some((_, inverse_depth)) = self.projection.project(Vec3::from_array(comparison.pull_m[0])) else {
            return;
        };
        let px_per_mm = 1e-3 * self.projection.focal_px * inverse_depth;
        let lengths_mm = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0];
        let Some(length_mm) = lengths_mm.into_iter().rfind(|mm| mm * px_per_mm <= 190.0 * scale) else {
            return;
        };
        let (left, y) = (40.0 * scale, self.layout.size.y - 40.0 * scale);
        let right = left + length_mm * px_per_mm;
        self.mask.reset(0, (y - 8.0 * scale) as i32, image.width(), (16.0 * scale) as usize + 2);
        let tick = 4.0 * scale;
        for (from, to) in [
            ([left, y], [right, y]),
            ([left, y - tick], [left, y + tick]),
            ([right, y - tick], [right, y + tick]),
        ] {
            self.mask.segment(from, to, 0.7 * scale, 1.0);
        }
        self.mask.paint(image, BRIGHT, 0.9);
        let text = format!("{length_mm} mm");
        let style = TextStyle::new(9.5 * scale, BRIGHT);
        self.face.draw(image, &text, right + 12.0 * scale, y + 4.5 * scale, Align::Left, style);
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

#[cfg(test)]
mod tests {
    use super::*;

    const FACES: [[u32; 3]; 8] =
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];

    /// An octahedron and an enlarged copy: the transparent shape encloses the solid.
    fn octahedra(growth: f32) -> Comparison {
        let rest_m: Vec<[f32; 3]> = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z]
            .map(|corner| (0.1 * corner).to_array())
            .to_vec();
        let grown = rest_m.iter().map(|p| p.map(|x| growth * x)).collect();
        let shape = |name: &str, position_m| DeformedShape {
            name: name.into(),
            position_m,
            values: vec![["force |h|".into(), "1.00 N".into()]],
            note: None,
        };
        Comparison {
            title: "octahedra".into(),
            subtitle: vec!["a line".into()],
            triangles: FACES.to_vec(),
            fixed: vec![false; 6],
            pull_m: [[0.1, 0.0, 0.0], [0.13, 0.0, 0.0]],
            outward: [1.0, 0.0, 0.0],
            shapes: vec![shape("same", rest_m.clone()), shape("grown", grown)],
            rest_m,
            solid: 0,
        }
    }

    fn bluish(image: &Image) -> usize {
        let free = Layout::new(image.width(), image.height()).free.map(|corner| corner.as_ivec2());
        let inside = |x: i32, y: i32| image.pixel(x as usize, y as usize).unwrap_or(0);
        (free[0].y..free[1].y)
            .flat_map(|y| (free[0].x..free[1].x).map(move |x| (x, y)))
            .filter(|&(x, y)| {
                let pixel = inside(x, y);
                (pixel & 0xff) > (pixel >> 16) + 40
            })
            .count()
    }

    #[test]
    fn a_different_shape_is_visible_and_an_equal_one_is_only_an_outline() {
        let (separation, same) =
            (bluish(&draw(&octahedra(1.3), 640, 360)), bluish(&draw(&octahedra(1.0), 640, 360)));
        assert!(separation > 4_000 && same < separation / 4, "{separation} against {same}");
    }

    #[test]
    fn all_points_are_inside_the_free_area() {
        for (width, height) in [(1280, 720), (700, 900), (400, 240)] {
            let comparison = octahedra(1.6);
            let layout = Layout::new(width, height);
            let surface = Surface::new(&comparison);
            let projection = viewpoint(&comparison, &surface, &layout);
            let [low, high] = layout.free;
            let mut max = Vec2::ZERO;
            for point in surface.all() {
                let (pixel, _) = projection.project(point).expect("in front");
                assert!(
                    pixel.cmpge(low - 2.0).all() && pixel.cmple(high + 2.0).all(),
                    "{pixel} {low} {high}"
                );
                max = max.max((pixel - 0.5 * (low + high)).abs() / (0.5 * (high - low)));
            }
            assert!(max.max_element() > 0.95, "the area is filled: {max}");
        }
    }

    /// No input may cause a panic: sizes down to a pixel, shapes and corners that do not fit, no shapes.
    #[test]
    fn any_size_and_any_shape_is_drawn() {
        for (width, height) in [(1, 1), (16, 9), (320, 200), (200, 900)] {
            assert_eq!(draw(&octahedra(1.2), width, height).pixels().len(), width * height);
        }
        let mut broken = octahedra(1.2);
        broken.shapes[1].position_m.pop();
        broken.triangles.push([0, 1, 77]);
        broken.shapes[0].position_m[0][0] = f32::NAN;
        broken.solid = 5;
        broken.shapes[0].note = Some("a note".into());
        let _ = draw(&broken, 160, 90);
        let _ = draw(&Comparison::default(), 160, 90);
    }
}
