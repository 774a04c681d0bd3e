//! Values in groups side by side: bars with their figures on them, or stems with a marker at the top.

use super::axis::Axis;
use super::chart::{Frame, HEIGHT, WIDTH};
use super::style::Style;
use super::svg::{Anchor, Svg};

/// A plot of groups.
#[derive(Debug)]
pub(in super::super) struct Bars {
    /// Above it.
    pub title: String,
    /// What the groups are.
    pub x_label: String,
    /// Up the left side.
    pub y: Axis,
    /// Group by group.
    pub groups: Vec<Group>,
    /// Bars; or stems, which suit a logarithmic axis without a floor.
    pub solid: bool,
}

/// One group.
#[derive(Debug)]
pub(in super::super) struct Group {
    /// Under it.
    pub name: String,
    /// Its values; a gap where there is none.
    pub values: Vec<Value>,
}

/// One bar or stem.
#[derive(Debug)]
pub(in super::super) struct Value {
    /// How it looks.
    pub style: Style,
    /// How high it is.
    pub value: Option<f64>,
    /// Written over a bar.
    pub text: String,
    /// What a pointer that rests on it is told.
    pub title: String,
}

impl Bars {
    /// The drawing.
    pub(in super::super) fn svg(&self) -> String {
        let mut svg = Svg::default();
        let frame = Frame { x: None, y: &self.y };
        frame.draw(&mut svg, &self.title, &self.x_label);
        let share = 1.0 / self.groups.len().max(1) as f64;
        for (n, group) in self.groups.iter().enumerate() {
            let start = n as f64 * share;
            svg.text(
                [Frame::across(start + 0.5 * share), Frame::FLOOR + 16.0],
                Anchor::Middle,
                "tick",
                &group.name,
            );
            let step = 0.8 * share / group.values.len().max(1) as f64;
            for (m, value) in group.values.iter().enumerate() {
                let Some(height) = value.value.filter(|v| v.is_finite()) else { continue };
                let from = start + 0.1 * share + m as f64 * step;
                self.draw_value(&mut svg, &frame, [from, from + step], height, value);
            }
        }
        svg.finish(WIDTH, HEIGHT, &self.title)
    }

    fn draw_value(&self, svg: &mut Svg, frame: &Frame<'_>, [from, to]: [f64; 2], height: f64, value: &Value) {
        let middle = Frame::across(0.5 * (from + to));
        let top = frame.up(height);
        if self.solid {
            let (left, right) = (Frame::across(from) + 1.5, Frame::across(to) - 1.5);
            svg.rectangle(
                [left, top],
                [right - left, Frame::FLOOR - top],
                value.style.colour,
                value.style.hollow,
            );
            svg.text([middle, top - 5.0], Anchor::Middle, "note", &value.text);
        } else {
            svg.polyline(&[[middle, Frame::FLOOR], [middle, top]], value.style.colour, "", 1.6);
            value.style.marker(svg, [middle, top], 4.5, &value.title);
        }
    }
}
