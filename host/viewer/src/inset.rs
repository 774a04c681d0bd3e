//! The side view of a touch, in a corner of the picture: the section of the skin, the tool, and the depth.

use super::camera::Projection;
use super::font::{Align, TextStyle, Typeface};
use super::image::{Image, StrokeMask};
use super::palette::{BRIGHT, FAINT, MUTED};
use super::regions::Regions;
use super::section::{Inside, Plane};
use super::ticks::{label, round_below};
use super::tool::{PAD_COLOUR, PAD_HEIGHT, Tool};
use super::touched::Touched;
use crate::deformation::Deformation;
use glam::{Vec2, Vec3};
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
const REGION_COLOUR: u32 = 0xc4_aaf5;

/// Text beside the bar where a region is in the section.
const REGION_NOTE: &str = "inclusion (estimated)";

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
    region: Vec<[Vec2; 2]>,
    regions: Regions,
    region_m: Vec<Vec3>,
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
        let sphere_m = organ.tool.sphere().map_or(0.0, |sphere| sphere.radius_m);
        let pad_m = organ.tool.fingertip().map_or(sphere_m, |tip| tip.radius_m);
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
            region: Vec::new(),
            regions: Regions::default(),
            region_m: Vec::new(),
        }
    }

    /// Sets the boundaries of regions.
    pub(super) fn set_regions(&mut self, regions: &Regions) {
        self.regions.clone_from(regions);
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
            && frame.pixel(Vec2::new(0.0, -touched.below_m())).y > frame.top + HEADING * frame.scale;
        if !(touched.is_engaged || is_near) {
            return;
        }
        let plane = Plane::of(touched, projection);
        let Self { height_m, rest, skin, region, region_m, regions, .. } = self;
        plane.contour(surface.rest_m(), triangles, height_m, rest);
        plane.contour(surface.position_m(), triangles, height_m, skin);
        regions.position_into(surface.position_m(), region_m);
        plane.contour(region_m, &regions.triangles, height_m, region);
        self.draw_ground(&frame, image);
        self.draw_skin(&frame, image);
        self.draw_tool(&frame, (tool, &plane), touched, image);
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
        for (contour, colour, alpha) in
            [(&self.skin, TISSUE_COLOUR, 0.5), (&self.region, REGION_COLOUR, 0.22)]
        {
            let pixels = contour.iter().map(|ends| ends.map(|end| frame.pixel(end) - corner));
            self.inside.find(pixels, columns);
            for column in 1..columns.saturating_sub(1) {
                for [from, to] in self.inside.spans(column) {
                    let (from, to) = (from.max(ceiling).round(), to.min(floor).round());
                    let x = first as i32 + column as i32;
                    image.fill_rect(x, from as i32, 1, (to - from).max(0.0) as i32, colour, alpha);
                }
            }
        }
        for (contour, half_width, colour, alpha) in [
            (&self.rest, 0.55, BRIGHT, 0.75),
            (&self.region, 0.8, REGION_COLOUR, 0.9),
            (&self.skin, 1.15, SKIN_COLOUR, 1.0),
        ] {
            clear(&mut self.mask, frame);
            for ends in contour {
                let [from, to] = ends.map(|end| frame.pixel(end).to_array());
                self.mask.segment(from, to, half_width * scale.max(0.6), 1.0);
            }
            self.mask.paint(image, colour, alpha);
        }
    }

    /// The tool, and its depth as the dimension of a technical drawing.
    fn draw_tool(
        &mut self,
        frame: &Frame,
        (tool, plane): (Tool, &Plane),
        touched: &Touched,
        image: &mut Image,
    ) {
        let depth_m = touched.depth_m();
        let line = frame.scale.max(0.6);
        let centre = frame.pixel(Vec2::new(0.0, -touched.below_m()));
        let at = frame.pixel(Vec2::new(0.0, -depth_m));
        let half_width = match tool {
            Tool::Sphere(radius_m) | Tool::Capsule(radius_m, _) => {
                let radius = radius_m * frame.per_m;
                let half = frame.per_m * plane.direction(tool.half_m()) * Vec2::new(1.0, -1.0);
                self.draw_rounded(frame, (centre, half), radius, image);
                radius + half.x.abs()
            }
            Tool::Ball(_) => {
                clear(&mut self.mask, frame);
                self.mask.segment(at.to_array(), at.to_array(), 4.0 * line, 1.0);
                self.mask.paint(image, PAD_COLOUR, 1.0);
                4.0 * line
            }
            Tool::Fingertip(radius_m) => {
                let radius = radius_m * frame.per_m;
                let face = (0..=64).map(|i| (core::f32::consts::PI * i as f32 / 64.0).sin_cos());
                let outline = face.map(|(sin, cos)| at + radius * Vec2::new(cos, -PAD_HEIGHT * sin));
                self.draw_outline(frame, &outline.collect::<Vec<_>>(), image);
                radius
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

    /// What is within a radius of the line from `centre` to half a line on either side: a sphere, or a capsule as it is seen along
    /// the plane.
    fn draw_rounded(&mut self, frame: &Frame, (centre, half): (Vec2, Vec2), radius: f32, image: &mut Image) {
        let outward = half.normalize_or(Vec2::X);
        let outline = (0..=64).map(|i| {
            let angle = core::f32::consts::TAU * (i as f32 / 64.0 - 0.25);
            let end = if i <= 32 { half } else { -half };
            centre + end + radius * Vec2::from_angle(angle).rotate(outward)
        });
        self.draw_outline(frame, &outline.collect::<Vec<_>>(), image);
    }

    /// The tool, whose outline is closed by its ends. A pad has its face where it would be if it did not give way.
    fn draw_outline(&mut self, frame: &Frame, outline: &[Vec2], image: &mut Image) {
        let line = frame.scale.max(0.6);
        let (low, high) = outline.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), point| {
            (low.min(point.x), high.max(point.x))
        });
        let (first, columns) = (low.floor(), (high - low) as usize + 2);
        let corner = Vec2::new(first, 0.0);
        let last = [outline[outline.len() - 1], outline[0]];
        let sides = outline.windows(2).map(|pair| [pair[0], pair[1]]).chain([last]);
        self.inside.find(sides.map(|ends| ends.map(|end| end - corner)), columns);
        let [ceiling, floor] = [frame.top + HEADING * frame.scale, frame.top + frame.height - 1.0];
        let [left, right] = [frame.left + 1.0, frame.left + frame.width - 1.0].map(|x| x.round() as i32);
        for column in 0..columns {
            let x = first as i32 + column as i32;
            for [from, to] in self.inside.spans(column).filter(|_| (left..right).contains(&x)) {
                let (from, to) = (from.max(ceiling).round(), to.min(floor).round());
                image.fill_rect(x, from as i32, 1, (to - from).max(0.0) as i32, PAD_COLOUR, 0.30);
            }
        }
        clear(&mut self.mask, frame);
        let line_of: Vec<[f32; 2]> = outline.iter().chain([&outline[0]]).map(Vec2::to_array).collect();
        self.mask.polyline(&line_of, 0.7 * line);
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
        let is_in = |end: &Vec2| {
            let pixel = frame.pixel(*end);
            (left..left + width).contains(&pixel.x) && (top..top + height).contains(&pixel.y)
        };
        if self.region.as_flattened().iter().any(is_in) {
            let place = (left + width - margin, y + 2.0 * scale);
            let style = TextStyle::new(9.0 * scale, REGION_COLOUR);
            self.face.draw_with_halo(image, REGION_NOTE, place, Align::Right, style);
        }
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
mod tests;
