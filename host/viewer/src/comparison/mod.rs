//! A still picture of several deformed shapes of one surface on top of each other, like the paper's Fig. 5.
//!
//! One shape is a shaded solid. The others are transparent in different colours, each with its outline and,
//! outside the solid, its mesh; inside the solid only a faint outline is drawn. The rest shape is a grey
//! outline. A key on the right names the shapes and lists values supplied by the caller. This module is
//! independent of the meaning of the shapes.

mod labels;
mod painter;
mod surface;

use super::camera::Projection;
use super::font::Typeface;
use super::image::{Image, StrokeMask};
use super::palette::BRIGHT;
use super::raster::Raster;
use super::shade::Shader;
use super::still::samples;

use glam::Vec2;
use surface::{Surface, viewpoint};

const SOLID_COLOUR: u32 = 0xb8_4f3c;
/// Colours of the other shapes, distinguishable from each other and from the solid with colour blindness too.
const COLOURS: [u32; 6] = [0x46_c8ff, 0xff_d84d, 0xc9_8bff, 0x6f_e39a, 0xff_9ec4, 0xf2_efe6];
/// Opacity of a transparent shape over the background, and over the solid, whose form must stay visible.
const GLASS: [f32; 2] = [0.42, 0.17];

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
    let factor = samples(width, height);
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

/// The buffers of a picture under construction.
struct Painter {
    raster: Raster,
    glass: Raster,
    shader: Shader,
    mask: StrokeMask,
    face: Typeface,
    projection: Projection,
    layout: Layout,
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

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
