//! A still picture of scalar fields on a surface: one column per field, one row per side.

use super::camera::Projection;
use super::font::{Align, TextStyle, Typeface};
use super::image::Image;
use super::material::Material;
use super::palette::{BRIGHT, ColourMap, FAINT, MUTED, linear, packed};
use super::raster::{Raster, Vertex};
use super::scene::FIXED_COLOUR;
use super::shade::Shader;
use super::smooth::Smooth;
use super::still::{camera, fit, in_range, samples, vertices};
use super::ticks::{self, Scale};
use super::viewpoint::{box_of, longest_axis, up_axis};
use glam::{Vec2, Vec3};

/// Colour of vertices without a value.
const NONE_COLOUR: u32 = 0x6b_727a;

/// A side of the surface, as seen with its long axis across the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// From the front.
    Front,
    /// From behind.
    Back,
    /// From the left of the front.
    Left,
    /// From the right of the front.
    Right,
    /// From above; the front is at the bottom.
    Above,
    /// From below; the front is at the top.
    Below,
}

impl Side {
    /// All sides.
    pub const ALL: [Self; 6] = [Self::Front, Self::Back, Self::Left, Self::Right, Self::Above, Self::Below];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Back => "back",
            Self::Left => "left",
            Self::Right => "right",
            Self::Above => "above",
            Self::Below => "below",
        }
    }

    /// From the surface to the eye: horizontal views are slightly from above, so that the top is seen too, and
    /// vertical ones slightly from the front, so that the long axis stays across.
    fn towards(self, long: Vec3, up: Vec3) -> Vec3 {
        let front = long.cross(up).normalize_or_zero();
        let towards = match self {
            Self::Front => front + 0.35 * up,
            Self::Back => -front + 0.35 * up,
            Self::Left => -long + 0.35 * up,
            Self::Right => long + 0.35 * up,
            Self::Above => up + 0.08 * front,
            Self::Below => -up + 0.08 * front,
        };
        towards.normalize_or_zero()
    }
}

/// The side from which a place of a surface with this outward normal is seen best.
#[must_use]
pub fn side_facing(position_m: &[[f32; 3]], outward: [f32; 3]) -> Side {
    let points: Vec<Vec3> = position_m.iter().map(|&x| Vec3::from(x)).collect();
    let long = longest_axis(&points, box_of(&points).0);
    let up = up_axis(&[], long);
    let facing = |side: &Side| side.towards(long, up).dot(Vec3::from(outward));
    let better = |best: Side, side: Side| if facing(&side) > facing(&best) { side } else { best };
    Side::ALL.into_iter().fold(Side::Front, better)
}

/// Content of the picture.
#[derive(Debug, Clone, Default)]
pub struct SurfaceMap {
    /// Heading.
    pub title: String,
    /// Line below the heading.
    pub subtitle: String,
    /// The surface, counter-clockwise seen from outside; the corners index `position_m`.
    pub triangles: Vec<[u32; 3]>,
    /// Vertices, m.
    pub position_m: Vec<[f32; 3]>,
    /// Whether each vertex is fixed.
    pub fixed: Vec<bool>,
    /// The fields.
    pub fields: Vec<ScalarField>,
    /// The sides, a row each.
    pub sides: Vec<Side>,
}

/// A scalar field on the vertices.
#[derive(Debug, Clone, Default)]
pub struct ScalarField {
    /// Name with its unit.
    pub name: String,
    /// Value per vertex; `None` for a vertex without a value.
    pub values: Vec<Option<f32>>,
    /// Whether the colour scale is logarithmic.
    pub is_logarithmic: bool,
    /// Lower end of the colour scale; vertices with a smaller value are grey, as those without one.
    pub from: Option<f32>,
}

impl ScalarField {
    /// The scale of its values.
    fn scale(&self) -> Scale {
        ticks::scale(self.range(), self.is_logarithmic)
    }

    /// Smallest and largest value. With one value or none the range is still not empty.
    fn range(&self) -> [f32; 2] {
        let has_place = |x: &&f32| x.is_finite() && (**x > 0.0 || !self.is_logarithmic);
        let all = self.values.iter().flatten().filter(has_place).copied().chain(self.from);
        let shown = all.filter(|x| self.is_shown(*x));
        let [low, high] =
            shown.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
        match (low < high, low.is_finite()) {
            (true, _) => [low, high],
            (_, true) if self.is_logarithmic => [0.5 * low, 2.0 * low],
            (_, true) => [low.min(0.0), low.max(0.0) + 1.0],
            (_, false) => [1.0, 10.0],
        }
    }

    /// Whether a value has a colour.
    fn is_shown(&self, value: f32) -> bool {
        self.from.is_none_or(|from| value >= from)
    }

    /// Position of a value on a scale with these ends, 0..1.
    fn share(&self, ends: [f32; 2], value: f32) -> f32 {
        let scale = |x: f32| if self.is_logarithmic { x.max(f32::MIN_POSITIVE).ln() } else { x };
        let [low, high] = ends.map(scale);
        (scale(value) - low) / (high - low)
    }
}

/// Draws the map. A corner out of range is not drawn, nor is a field with a different number of vertices.
#[must_use]
pub fn draw(map: &SurfaceMap, width: usize, height: usize) -> Image {
    let mut image = Image::new(width, height);
    let scale = (height as f32 / 720.0).min(width as f32 / 1280.0).max(0.05);
    let mut face = Typeface::new();
    let margin = 36.0 * scale;
    face.draw(
        &mut image,
        &map.title,
        margin,
        46.0 * scale,
        Align::Left,
        TextStyle::new(17.0 * scale, BRIGHT),
    );
    face.draw(
        &mut image,
        &map.subtitle,
        margin,
        72.0 * scale,
        Align::Left,
        TextStyle::new(9.5 * scale, MUTED),
    );
    let (top, legend) = (92.0 * scale, 84.0 * scale);
    let columns = map.fields.len().max(1);
    let rows = map.sides.len().max(1) as f32;
    let [panel_width, panel_height] =
        [width / columns, ((height as f32 - top - legend) / rows).max(1.0) as usize];
    let colours = ColourMap::new();
    let mut shader = Shader::new();
    for (column, field) in map.fields.iter().enumerate() {
        let left = column * panel_width;
        for (row, side) in map.sides.iter().enumerate() {
            let panel = panel(map, field, &colours, &mut shader, [panel_width, panel_height], *side);
            let at = top as usize + row * panel_height;
            paste(&mut image, &panel, left, at);
            let style = TextStyle::new(9.0 * scale, MUTED);
            let y = at as f32 + 16.0 * scale;
            face.draw(&mut image, side.name(), left as f32 + margin, y, Align::Left, style);
        }
        let bar = Bar {
            left: left as f32 + 0.18 * panel_width as f32,
            right: left as f32 + 0.82 * panel_width as f32,
            top: height as f32 - legend + 28.0 * scale,
            scale,
        };
        bar.draw(field, &colours, &mut face, &mut image);
    }
    image
}

/// The legend of a field.
struct Bar {
    left: f32,
    right: f32,
    top: f32,
    scale: f32,
}

impl Bar {
    fn draw(&self, field: &ScalarField, colours: &ColourMap, face: &mut Typeface, image: &mut Image) {
        let Self { left, right, top, scale } = *self;
        let style = TextStyle::new(10.0 * scale, BRIGHT);
        face.draw(image, &field.name, 0.5 * (left + right), top - 9.0 * scale, Align::Centre, style);
        for x in left as i32..right as i32 {
            let colour = packed(colours.linear((x as f32 - left) / (right - left)));
            image.fill_rect(x, top as i32, 1, (12.0 * scale) as i32, colour, 1.0);
        }
        let Scale { ends, marks } = field.scale();
        for mark in marks {
            let x = left + field.share(ends, mark) * (right - left);
            let line = (scale.round() as i32).max(1);
            image.fill_rect(x as i32, (top + 12.0 * scale) as i32, line, (4.0 * scale) as i32, FAINT, 1.0);
            let style = TextStyle::new(9.0 * scale, MUTED);
            face.draw(image, &ticks::label(mark), x, top + 30.0 * scale, Align::Centre, style);
        }
    }
}

/// The surface with one field, from one side.
fn panel(
    map: &SurfaceMap,
    field: &ScalarField,
    colours: &ColourMap,
    shader: &mut Shader,
    [width, height]: [usize; 2],
    side: Side,
) -> Image {
    let mut image = Image::new(width, height);
    let count = map.position_m.len();
    let triangles = in_range(&map.triangles, count);
    if field.values.len() != count || triangles.is_empty() {
        return image;
    }
    let Scale { ends, .. } = field.scale();
    let colour = |at: usize| match field.values[at] {
        Some(value) if field.is_shown(value) => colours.linear(field.share(ends, value)),
        None if map.fixed.get(at) == Some(&true) => linear(FIXED_COLOUR),
        _ => linear(NONE_COLOUR),
    };
    let mut vertices = vertices(&map.position_m, &triangles, colour);
    let smooth = Smooth::new(&triangles, count);
    smooth.refine(&mut vertices);
    let projection = viewpoint(&vertices, [width, height], side);
    let mut raster = Raster::new(width, height, samples(width, height), &projection);
    raster.begin(&projection);
    raster.draw(&vertices, smooth.triangles(), Material::Plain);
    shader.resolve(&raster, &mut image);
    image
}

/// The view of a side that fills the panel.
fn viewpoint(vertices: &[Vertex], [width, height]: [usize; 2], side: Side) -> Projection {
    let points: Vec<Vec3> = vertices.iter().map(|vertex| vertex.position_m).collect();
    let (centre_m, radius_m) = box_of(&points);
    let long = longest_axis(&points, centre_m);
    let up = up_axis(&[], long);
    let size = Vec2::new(width as f32, height as f32);
    let camera = camera(centre_m, radius_m, side.towards(long, up), up);
    fit(camera, [width, height], [0.06 * size, 0.94 * size], &points)
}

fn paste(image: &mut Image, part: &Image, left: usize, top: usize) {
    let (width, height) = (image.width(), image.height());
    for y in 0..part.height().min(height.saturating_sub(top)) {
        for x in 0..part.width().min(width.saturating_sub(left)) {
            let from = y * part.width() + x;
            image.pixels_mut()[(top + y) * width + left + x] = part.pixels()[from];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACES: [[u32; 3]; 8] =
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];

    fn octahedron(values: Vec<Option<f32>>) -> SurfaceMap {
        let corners = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        SurfaceMap {
            title: "octahedron".into(),
            subtitle: "a line".into(),
            triangles: FACES.to_vec(),
            position_m: corners.map(|corner| (0.1 * corner).to_array()).to_vec(),
            fixed: vec![false; 6],
            fields: vec![ScalarField { name: "field".into(), values, is_logarithmic: false, from: None }],
            sides: vec![Side::Front, Side::Back],
        }
    }

    /// Each face of the octahedron has its own value; every side shows its four faces and no others.
    #[test]
    fn each_side_shows_its_own_faces() {
        // Longest along x, so that z is up and y is across: the front is at -y.
        let half = [Vec3::X * 2.0, Vec3::Y, Vec3::Z * 1.2, Vec3::X * -2.0, -Vec3::Y, Vec3::Z * -1.2];
        let sides = [
            (Side::Front, 4, 1),
            (Side::Back, 1, 4),
            (Side::Left, 3, 0),
            (Side::Right, 0, 3),
            (Side::Above, 2, 5),
            (Side::Below, 5, 2),
        ];
        for (side, seen, hidden) in sides {
            let warm_with = |corner: usize| {
                let values = (0..6).map(|at| Some(if at == corner { 1.0 } else { 0.0 })).collect();
                let mut map = octahedron(values);
                map.position_m = half.map(|corner| (0.1 * corner).to_array()).to_vec();
                map.sides = vec![side];
                warm(&draw(&map, 640, 360))
            };
            let (seen, hidden) = (warm_with(seen), warm_with(hidden));
            assert!(seen > hidden + 2_000, "{}: {seen} {hidden}", side.name());
        }
    }

    /// With a lower end the scale begins there, and smaller values have no colour.
    #[test]
    fn a_scale_with_a_lower_end_begins_at_it() {
        let field = |values: [f32; 2]| ScalarField {
            values: values.map(Some).to_vec(),
            from: Some(1.0),
            ..ScalarField::default()
        };
        assert_eq!(field([0.2, 3.0]).range(), [1.0, 3.0]);
        assert!(field([0.2, 3.0]).is_shown(1.0) && !field([0.2, 3.0]).is_shown(0.99));
        let [low, high] = field([0.2, 0.5]).range();
        assert!(low <= 1.0 && high > 1.0, "{low} {high}");
        assert!(ScalarField::default().is_shown(-1.0));
        // A body with small values only looks like one without values.
        let drawn = |field: ScalarField| {
            let map = octahedron(vec![None; 6]);
            panel(&map, &field, &ColourMap::new(), &mut Shader::new(), [120, 90], Side::Front)
        };
        let values = |from, value| ScalarField { values: vec![value; 6], from, ..ScalarField::default() };
        let [small, none, large] = [(Some(1.0), Some(0.5)), (Some(1.0), None), (Some(1.0), Some(2.0))]
            .map(|(from, value)| drawn(values(from, value)));
        assert_eq!(small.pixels(), none.pixels());
        assert_ne!(large.pixels(), none.pixels());
    }

    /// A place is shown from the side to which its normal points.
    #[test]
    fn a_place_is_seen_from_the_side_that_it_faces() {
        let half = [Vec3::X * 2.0, Vec3::Y, Vec3::Z * 1.2, Vec3::X * -2.0, -Vec3::Y, Vec3::Z * -1.2];
        let position_m = half.map(|corner| (0.1 * corner).to_array());
        let sides = [Side::Right, Side::Back, Side::Above, Side::Left, Side::Front, Side::Below];
        for (corner, side) in half.into_iter().zip(sides) {
            assert_eq!(side_facing(&position_m, corner.normalize().to_array()), side, "{corner}");
        }
    }

    /// Pixels in the panels that are more red than blue.
    fn warm(image: &Image) -> usize {
        image.pixels().iter().filter(|&&pixel| (pixel >> 16 & 0xff) > (pixel & 0xff) + 60).count()
    }

    #[test]
    fn vertices_without_a_value_are_grey() {
        let with = draw(&octahedron((0..6).map(|n| Some(n as f32)).collect()), 640, 360);
        let without = draw(&octahedron(vec![None; 6]), 640, 360);
        // The legend is in both.
        assert!(warm(&with) > 4 * warm(&without), "{} against {}", warm(&with), warm(&without));
        let lit = |image: &Image| image.pixels().iter().filter(|&&p| p & 0xff > 0x20).count();
        assert!(lit(&without) > 10_000, "grey, but drawn: {}", lit(&without));
    }

    #[test]
    fn marks_are_at_their_values() {
        for is_logarithmic in [false, true] {
            let values = [3.0, 30.0, 300.0].map(Some).to_vec();
            let field = ScalarField { values, is_logarithmic, ..ScalarField::default() };
            let Scale { ends, marks } = field.scale();
            assert_eq!((field.range(), field.share(ends, ends[0])), ([3.0, 300.0], 0.0));
            assert!((field.share(ends, ends[1]) - 1.0).abs() < 1e-6 && ends[0] <= 3.0 && ends[1] >= 300.0);
            let shares: Vec<f32> = marks.iter().map(|mark| field.share(ends, *mark)).collect();
            assert!(shares.is_sorted() && shares.iter().all(|share| (-1e-6..=1.000_001).contains(share)));
            // The mean of the marks' ratios, or of their differences, is in the middle between two of them.
            let [a, b] = [marks[0], marks[1]];
            let middle = if is_logarithmic { (a * b).sqrt() } else { 0.5 * (a + b) };
            assert!((field.share(ends, middle) - 0.5 * (shares[0] + shares[1])).abs() < 1e-5);
        }
        // With one value, with none, or with one that has no logarithm, the scale is still valid.
        for (values, is_logarithmic) in
            [[Some(2.0), None], [None; 2], [Some(0.0), None], [Some(0.0), Some(7.0)]]
                .into_iter()
                .flat_map(|values| [(values, false), (values, true)])
        {
            let field = ScalarField { values: values.to_vec(), is_logarithmic, ..ScalarField::default() };
            let Scale { ends, marks } = field.scale();
            assert!(marks.len() >= 4 && marks.iter().all(|mark| mark.is_finite()), "{values:?}: {marks:?}");
            assert!(field.share(ends, 2.0).is_finite() && field.share(ends, 0.0).is_finite(), "{values:?}");
        }
        assert_eq!(draw(&SurfaceMap::default(), 64, 48).pixels().len(), 64 * 48);
    }
}
