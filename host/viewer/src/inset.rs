//! The side view of a touch, in a corner of the picture: the section of the skin, the tool, and the depth.

use super::camera::Projection;
use super::font::{Align, TextStyle, Typeface};
use super::image::{Image, StrokeMask};
use super::palette::{BRIGHT, FAINT, MUTED};
use super::section::{Inside, Plane};
use super::ticks::{label, round_below};
use super::tool::{PAD_COLOUR, PAD_HEIGHT, Tool};
use super::touched::Touched;
use crate::deformation::Deformation;
use glam::Vec2;
use palpate_core::Organ;

/// Left, distance of the bottom from that of the picture, width and height, for a picture 720 pixels high.
const BOX: [f32; 4] = [836.0, 26.0, 286.0, 188.0];
/// Space on the right that the legend needs, for a picture 720 pixels high.
const LEGEND: f32 = 152.0;
/// Height of the line of text above the section.
const HEADING: f32 = 27.0;
/// Share of the section that is above the skin at rest.
const ABOVE: f32 = 0.36;
/// Width of the section in radii of the pad, and in radii of the largest grid.
const WIDTH: [f32; 2] = [6.0, 1.2];
/// Width of the section without active nodes, m.
const USUAL_WIDTH_M: f32 = 0.06;
/// Depths below this are not named, m.
const MIN_DEPTH_M: f32 = 5e-5;

const GROUND_COLOUR: u32 = 0x0c_1014;
const TISSUE_COLOUR: u32 = 0x8a_3a30;
const SKIN_COLOUR: u32 = 0xf0_a070;

/// The side view; the buffers are reused.
#[derive(Debug, Clone)]
pub(super) struct Inset {
    width_m: f32,
    face: Typeface,
    mask: StrokeMask,
    inside: Inside,
    height_m: Vec<f32>,
    rest: Vec<[Vec2; 2]>,
    skin: Vec<[Vec2; 2]>,
}

/// The section in the picture.
#[derive(Clone, Copy)]
struct Frame {
    left: f32,
    top: f32,
    width: f32,
    height: f32,
    /// Pixels per metre.
    per_m: f32,
    /// Pixels per unit of a picture 720 high.
    scale: f32,
}

impl Frame {
    /// The frame in a picture of this size; `None` if the picture is too narrow for it.
    fn of(image: &Image, width_m: f32) -> Option<Self> {
        let scale = image.height() as f32 / 720.0;
        let [left, bottom, width, height] = BOX.map(|length| length * scale);
        let frame = Self {
            left,
            top: image.height() as f32 - bottom - height,
            width,
            height,
            per_m: width / width_m,
            scale,
        };
        (left + width + LEGEND * scale <= image.width() as f32 + 1.0).then_some(frame)
    }

    /// Pixel of a point of the section, m.
    fn pixel(&self, point_m: Vec2) -> Vec2 {
        let skin = self.top + HEADING * self.scale + ABOVE * (self.height - HEADING * self.scale);
        Vec2::new(self.left + 0.5 * self.width + self.per_m * point_m.x, skin - self.per_m * point_m.y)
    }
}

impl Inset {
    /// The scale is that of the organ, so that depths can be compared from touch to touch.
    pub(super) fn new<const N: usize>(organ: &Organ<'_, N>) -> Self {
        let pad_m = organ.fingertip.map_or(0.0, |tip| tip.radius_m);
        let grid_m = organ.spaces.iter().map(|space| space.lattice().radius_m()).fold(0.0, f32::max);
        let width_m = (WIDTH[0] * pad_m).max(WIDTH[1] * grid_m);
        Self {
            width_m: if width_m > 0.0 { width_m } else { USUAL_WIDTH_M },
            face: Typeface::default(),
            mask: StrokeMask::default(),
            inside: Inside::default(),
            height_m: Vec::new(),
            rest: Vec::new(),
            skin: Vec::new(),
        }
    }

    /// Draws the side view, unless a free tool is too far from the skin to be in it.
    pub(super) fn draw(
        &mut self,
        (touched, tool): (&Touched, Tool),
        (surface, triangles): (&Deformation, &[[u32; 3]]),
        projection: &Projection,
        image: &mut Image,
    ) {
        let Some(frame) = Frame::of(image, self.width_m) else { return };
        let is_near = touched.tool_m.distance(touched.contact_m) < 0.5 * self.width_m
            && frame.pixel(Vec2::new(0.0, -touched.depth_m())).y > frame.top + HEADING * frame.scale;
        if !(touched.is_engaged || is_near) {
            return;
        }
        let plane = Plane::of(touched, projection);
        let Self { height_m, rest, skin, .. } = self;
        plane.contour(surface.rest_m(), triangles, height_m, rest);
        plane.contour(surface.position_m(), triangles, height_m, skin);
        self.draw_ground(&frame, image);
        self.draw_skin(&frame, image);
        self.draw_tool(&frame, tool, touched, image);
        self.draw_text(&frame, touched, image);
    }

    fn draw_ground(&self, frame: &Frame, image: &mut Image) {
        let Frame { left, top, width, height, .. } = *frame;
        let [x, y, width, height] = [left, top, width, height].map(|length| length.round() as i32);
        image.fill_rect(x, y, width, height, GROUND_COLOUR, 0.86);
        for (x, y, width, height) in [
            (x, y, width, 1),
            (x, y + height - 1, width, 1),
            (x, y + 1, 1, height - 2),
            (x + width - 1, y + 1, 1, height - 2),
        ] {
            image.fill_rect(x, y, width, height, FAINT, 0.6);
        }
    }

    /// The body, its skin at rest as a thin line and its skin now as a thick one.
    fn draw_skin(&mut self, frame: &Frame, image: &mut Image) {
        let Frame { left, top, width, height, scale, .. } = *frame;
        let (first, ceiling) = (left.round(), (top + HEADING * scale).round());
        let floor = (top + height).round() - 1.0;
        let corner = Vec2::new(first, 0.0);
        let columns = width.round() as usize;
        let pixels = self.skin.iter().map(|ends| ends.map(|end| frame.pixel(end) - corner));
        self.inside.find(pixels, columns);
        for column in 1..columns.saturating_sub(1) {
            for [from, to] in self.inside.spans(column) {
                let (from, to) = (from.max(ceiling), to.min(floor));
                let rows = (to.round() - from.round()).max(0.0) as i32;
                let x = first as i32 + column as i32;
                image.fill_rect(x, from.round() as i32, 1, rows, TISSUE_COLOUR, 0.5);
            }
        }
        for (contour, half_width, colour, alpha) in
            [(&self.rest, 0.55, BRIGHT, 0.75), (&self.skin, 1.15, SKIN_COLOUR, 1.0)]
        {
            clear(&mut self.mask, frame);
            for ends in contour {
                let [from, to] = ends.map(|end| frame.pixel(end).to_array());
                self.mask.segment(from, to, half_width * scale.max(0.6), 1.0);
            }
            self.mask.paint(image, colour, alpha);
        }
    }

    /// The tool, and its depth as the dimension of a technical drawing.
    fn draw_tool(&mut self, frame: &Frame, tool: Tool, touched: &Touched, image: &mut Image) {
        let depth_m = touched.depth_m();
        let line = frame.scale.max(0.6);
        let at = frame.pixel(Vec2::new(0.0, -depth_m));
        let half_width = match tool {
            Tool::Point(_) => {
                clear(&mut self.mask, frame);
                self.mask.segment(at.to_array(), at.to_array(), 4.0 * line, 1.0);
                self.mask.paint(image, PAD_COLOUR, 1.0);
                4.0 * line
            }
            Tool::Fingertip(radius_m) => {
                self.draw_pad(frame, at, radius_m * frame.per_m, image);
                radius_m * frame.per_m
            }
        };
        if !touched.is_engaged || depth_m.abs() < MIN_DEPTH_M {
            return;
        }
        clear(&mut self.mask, frame);
        let x = at.x + half_width + 13.0 * line;
        let rest = frame.pixel(Vec2::ZERO).y;
        for y in [rest, at.y] {
            self.mask.segment([at.x + half_width + 3.0 * line, y], [x + 4.0 * line, y], 0.45 * line, 1.0);
        }
        self.mask.segment([x, rest], [x, at.y], 0.45 * line, 1.0);
        let barb = 3.0 * line.copysign(at.y - rest);
        if (at.y - rest).abs() > 9.0 * line {
            for (y, along) in [(rest, barb), (at.y, -barb)] {
                for side in [-2.0 * line, 2.0 * line] {
                    self.mask.segment([x, y], [x + side, y + along], 0.45 * line, 1.0);
                }
            }
        }
        self.mask.paint(image, BRIGHT, 0.9);
    }

    /// A pad: its face, where it would be if it did not give way, and the finger above it as an arc.
    fn draw_pad(&mut self, frame: &Frame, at: Vec2, radius: f32, image: &mut Image) {
        let line = frame.scale.max(0.6);
        let arc: Vec<[f32; 2]> = (0..=32)
            .map(|i| (core::f32::consts::PI * i as f32 / 32.0).sin_cos())
            .map(|(sin, cos)| [at.x + radius * cos, at.y - PAD_HEIGHT * radius * sin])
            .collect();
        let sides = arc.windows(2).map(|pair| [pair[0], pair[1]].map(Vec2::from_array));
        let first = (at.x - radius).floor();
        let corner = Vec2::new(first, 0.0);
        self.inside.find(
            sides
                .chain([[Vec2::new(at.x - radius, at.y), Vec2::new(at.x + radius, at.y)]])
                .map(|ends| ends.map(|end| end - corner)),
            (2.0 * radius) as usize + 2,
        );
        let [low, high] = [frame.top + HEADING * frame.scale, frame.top + frame.height - 1.0];
        for column in 0..(2.0 * radius) as usize + 2 {
            for [from, to] in self.inside.spans(column) {
                let (from, to) = (from.max(low).round(), to.min(high).round());
                let x = first as i32 + column as i32;
                image.fill_rect(x, from as i32, 1, (to - from).max(0.0) as i32, PAD_COLOUR, 0.30);
            }
        }
        clear(&mut self.mask, frame);
        self.mask.polyline(&arc, 0.7 * line);
        self.mask.segment(arc[0], arc[arc.len() - 1], 0.7 * line, 1.0);
        self.mask.paint(image, PAD_COLOUR, 0.95);
    }

    fn draw_text(&mut self, frame: &Frame, touched: &Touched, image: &mut Image) {
        let Frame { left, top, width, height, per_m, scale } = *frame;
        let name = TextStyle::new(9.5 * scale, MUTED);
        let (margin, y) = (10.0 * scale, top + 18.0 * scale);
        self.face.draw(image, "side view", left + margin, y, Align::Left, name);
        let depth = TextStyle::new(12.0 * scale, BRIGHT);
        let text = depth_in_words(touched);
        self.face.draw(image, &text, left + width - margin, y, Align::Right, depth);
        let bar_m = round_below(0.25 * self.width_m);
        let (bar, y) = (bar_m * per_m, top + height - 9.0 * scale);
        let thick = (scale.round() as i32).max(1);
        let [x, length] = [left + margin, bar].map(|x| x.round() as i32);
        image.fill_rect(x, y as i32, length, thick, BRIGHT, 0.9);
        for end in [x, x + length - thick] {
            image.fill_rect(end, (y - 3.0 * scale) as i32, thick, (3.0 * scale) as i32, BRIGHT, 0.9);
        }
        let text = format!("{} mm", label(1e3 * bar_m));
        let style = TextStyle::new(9.0 * scale, BRIGHT);
        let x = left + margin + bar + 7.0 * scale;
        self.face.draw_with_halo(image, &text, (x, y + 2.0 * scale), Align::Left, style);
    }
}

/// Clears a mask of the section.
fn clear(mask: &mut StrokeMask, frame: &Frame) {
    let (left, top) = (frame.left.round() + 1.0, (frame.top + HEADING * frame.scale).round());
    let bottom = (frame.top + frame.height).round() - 1.0;
    let width = (frame.width.round() - 2.0).max(0.0);
    mask.reset(left as i32, top as i32, width as usize, (bottom - top).max(0.0) as usize);
}

/// Depth of the tool along the normal: in, out, or not touching.
fn depth_in_words(touched: &Touched) -> String {
    let depth_m = touched.depth_m();
    match (touched.is_engaged, depth_m > -MIN_DEPTH_M) {
        (false, _) => "not touching".into(),
        (true, true) => format!("{:.1} mm deep", 1e3 * depth_m.max(0.0)),
        (true, false) => format!("{:.1} mm out", -1e3 * depth_m),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;
    use crate::synthetic::{self, Shape};
    use glam::Vec3;
    use palpate_core::NodeWeight;

    const SIZE: [usize; 2] = [1280, 720];

    /// The side view of the first active node, pressed by the tool to a depth, with the frame.
    fn drawn(
        tool: Tool,
        depth_m: f32,
        is_engaged: bool,
        [width, height]: [usize; 2],
    ) -> (Image, Option<Frame>) {
        let shape = Shape { subdivisions: 5, ..Shape::default() };
        let blob = synthetic::organ(&shape);
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let active = &organ.spaces[0].active;
        let normal = Vec3::from_array(active.outward_normal);
        let contact_m = Vec3::from_array(active.rest_position_m);
        let touched = Touched { tool_m: contact_m - normal * depth_m, contact_m, normal, is_engaged };
        let mut surface = Deformation::at_rest(&organ);
        let whole = NodeWeight { space: 0, weight: f32::from(u8::from(is_engaged)) };
        let shares = [whole, NodeWeight::default(), NodeWeight::default()];
        surface.update(&organ, &shares, (-normal * depth_m).to_array());
        let camera = OrbitCamera::framing(Vec3::ZERO, 0.1, Vec3::new(0.1, -1.0, 0.3), Vec3::Z);
        let mut image = Image::new(width, height);
        let mut inset = Inset::new(&organ);
        let skin = (&surface, organ.surface.triangles);
        inset.draw((&touched, tool), skin, &camera.projection(width, height), &mut image);
        let frame = Frame::of(&image, inset.width_m);
        (image, frame)
    }

    /// Rows of a column with a colour, from the top.
    fn rows(image: &Image, x: f32, is: impl Fn(i32, i32, i32) -> bool) -> Vec<usize> {
        let channel = |pixel: u32, shift: u32| (pixel >> shift & 255) as i32;
        let has = |y: &usize| {
            image.pixel(x as usize, *y).is_some_and(|p| is(channel(p, 16), channel(p, 8), channel(p, 0)))
        };
        (0..image.height()).filter(has).collect()
    }

    /// The thick line is the skin now, where the node is at the depth of the tool; the thin one is at rest.
    #[test]
    fn skin_and_tool_are_at_their_depths() {
        for depth_m in [0.004_f32, 0.009] {
            let (image, frame) = drawn(Tool::Point(0.003), depth_m, true, SIZE);
            let frame = frame.expect("it fits");
            // Between the tool and the dimension, 4 mm beside the node.
            let beside = |depth_m: f32| frame.pixel(Vec2::new(-0.004, -depth_m));
            let skin = rows(&image, beside(0.0).x, |r, g, b| r > 200 && g > 120 && b < 150 && r - b > 80);
            let rest =
                rows(&image, beside(0.0).x, |r, g, b| r > 120 && (r - b).abs() < 30 && (r - g).abs() < 30);
            // The synthetic dent is 1 / (1 + r^2 / reach^2) of the depth, and the body curves away.
            let dent_m = depth_m / (1.0 + (0.004_f32 / 0.024).powi(2));
            let (at_rest, pressed) = (beside(0.0).y, beside(dent_m).y);
            assert!(!rest.is_empty() && (rest[0] as f32 - at_rest).abs() < 4.0, "{rest:?} {at_rest}");
            assert!(skin.iter().any(|y| (*y as f32 - pressed).abs() < 4.0), "{skin:?} {pressed}");
            let tool = frame.pixel(Vec2::new(0.0, -depth_m));
            let ball = rows(&image, tool.x, |r, g, b| r > 180 && g > 215 && b > 230);
            let middle = 0.5 * (ball[0] + ball[ball.len() - 1]) as f32;
            assert!((middle - tool.y).abs() <= 1.5, "{ball:?} {}", tool.y);
        }
    }

    /// A pad is as wide as it is, from its arc to its face.
    #[test]
    fn a_pad_has_its_size() {
        let (pad_m, depth_m) = (0.010, 0.005);
        let (image, frame) = drawn(Tool::Fingertip(pad_m), depth_m, true, SIZE);
        let frame = frame.expect("it fits");
        let edge = |r: i32, g: i32, b: i32| r > 110 && g > 150 && b > 160;
        let top = rows(&image, frame.pixel(Vec2::ZERO).x, edge);
        let [arc, face] = [PAD_HEIGHT * pad_m - depth_m, -depth_m].map(|y| frame.pixel(Vec2::new(0.0, y)).y);
        assert!((top[0] as f32 - arc).abs() < 2.5, "{top:?} {arc}");
        assert!((top[top.len() - 1] as f32 - face).abs() < 2.5, "{top:?} {face}");
        let y = face as usize;
        let row: Vec<usize> = (frame.left as usize..(frame.left + frame.width) as usize)
            .filter(|x| !rows(&image, *x as f32, edge).iter().all(|row| row.abs_diff(y) > 1))
            .collect();
        let width = (row[row.len() - 1] - row[0]) as f32;
        // The lines of the dimension begin beside the pad.
        let expected = 2.0 * pad_m * frame.per_m;
        assert!(width > expected - 3.0 && width < expected + 24.0, "{width} {expected}");
    }

    /// Without room, or with a free tool far away, there is no side view; near the skin there is.
    #[test]
    fn it_is_drawn_where_it_has_room_and_a_use() {
        let lit = |depth_m, is_engaged, size| {
            let (image, _) = drawn(Tool::Point(0.003), depth_m, is_engaged, size);
            image.pixels().iter().filter(|pixel| **pixel != 0).count()
        };
        assert!(lit(0.004, true, SIZE) > 20_000 && lit(-0.004, false, SIZE) > 20_000);
        assert_eq!(lit(-0.04, false, SIZE), 0);
        for size in [[1, 1], [200, 900], [720, 720], [16, 9]] {
            lit(0.004, true, size);
        }
        assert_eq!(lit(0.004, true, [720, 720]), 0);
    }

    #[test]
    fn the_depth_is_told_in_words() {
        let touched = |depth_m: f32, is_engaged| Touched {
            tool_m: Vec3::Z * -depth_m,
            contact_m: Vec3::ZERO,
            normal: Vec3::Z,
            is_engaged,
        };
        let words = [(0.00512, true), (-0.0131, true), (-0.00001, true), (-0.002, false)]
            .map(|(depth_m, is_engaged)| depth_in_words(&touched(depth_m, is_engaged)));
        assert_eq!(words, ["5.1 mm deep", "13.1 mm out", "0.0 mm deep", "not touching"]);
    }
}
