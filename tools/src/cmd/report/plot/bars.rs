//! Groups of values: bars with their values as labels, or stems with a marker at the top.

use super::axis::Axis;
use super::chart::{Frame, HEIGHT, WIDTH};
use super::style::Style;
use super::svg::{Anchor, Svg};

/// A plot of groups.
#[derive(Debug)]
pub(in super::super) struct Bars {
    /// Title above the plot.
    pub title: String,
    /// Label of the groups.
    pub x_label: String,
    /// The vertical axis.
    pub y: Axis,
    /// The groups, from left to right.
    pub groups: Vec<Group>,
    /// Bars if true; otherwise stems, which suit a logarithmic axis without a floor.
    pub solid: bool,
}

/// One group.
#[derive(Debug)]
pub(in super::super) struct Group {
    /// Label below the group.
    pub name: String,
    /// Its values, with a gap for each missing one.
    pub values: Vec<Value>,
}

/// One bar or stem.
#[derive(Debug)]
pub(in super::super) struct Value {
    /// Its style.
    pub style: Style,
    /// Its height.
    pub value: Option<f64>,
    /// Label above a bar.
    pub text: String,
    /// Tooltip.
    pub title: String,
}

impl Bars {
    /// Returns the drawing.
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
