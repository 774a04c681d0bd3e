//! Draws the arrow of the pull, the key, the heading and the scale bar.

use super::surface::REST_COLOUR;
use super::{Comparison, DeformedShape, GLASS, Painter, colours};
use crate::font::{Align, TextStyle};
use crate::image::Image;
use crate::palette::{BRIGHT, MUTED, WAITING};
use crate::scene::FIXED_COLOUR;
use glam::{Vec2, Vec3};

impl Painter {
    /// Arrow from the rest position of the prescribed vertex to its displaced position, with the length in
    /// mm.
    pub(super) fn pull(&mut self, comparison: &Comparison, image: &mut Image) {
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
    pub(super) fn key(&mut self, comparison: &Comparison, image: &mut Image) {
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

    pub(super) fn captions(&mut self, comparison: &Comparison, image: &mut Image) {
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
