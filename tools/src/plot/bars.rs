//! Groups of values: bars with their values as labels, or stems with a marker at the top.

use super::axis::Axis;
use super::chart::{Frame, HEIGHT, WIDTH};
use super::style::{Style, rectangle};
use super::svg::{MIDDLE, Svg};

/// A plot of groups.
#[derive(Debug)]
pub(crate) struct Bars {
    /// Title above the plot.
    pub title: String,
    /// Label of the groups.
    pub x_label: String,
    /// The vertical axis.
    pub y: Axis,
    /// The groups from left to right: the label below each, and its values.
    pub groups: Vec<(String, Vec<Value>)>,
    /// Bars if true; otherwise stems, which suit a logarithmic axis without a floor.
    pub solid: bool,
}

/// One bar or stem.
#[derive(Debug)]
pub(crate) struct Value {
    /// Its style.
    pub style: Style,
    /// Its height; a missing one leaves a gap.
    pub value: Option<f64>,
    /// Label above a bar, or tooltip of a stem.
    pub text: String,
}

impl Bars {
    /// Returns the drawing.
    pub(crate) fn svg(&self) -> String {
        let mut svg = Svg::default();
        let frame = Frame { x: None, y: &self.y };
        frame.draw(&mut svg, &self.title, &self.x_label);
        let share = 1.0 / self.groups.len().max(1) as f64;
        for (n, (name, values)) in self.groups.iter().enumerate() {
            let start = n as f64 * share;
            let middle = Frame::across(start + 0.5 * share);
            svg.text([middle, Frame::FLOOR + 16.0], MIDDLE, "tick", name);
            let step = 0.8 * share / values.len().max(1) as f64;
            for (m, value) in values.iter().enumerate() {
                let Some(height) = value.value.filter(|v| v.is_finite()) else { continue };
                let from = start + 0.1 * share + m as f64 * step;
                let [left, right] = [from, from + step].map(Frame::across);
                self.draw_value(&mut svg, [left, right, frame.up(height)], value);
            }
        }
        svg.finish(WIDTH, HEIGHT, &self.title)
    }

    fn draw_value(&self, svg: &mut Svg, [left, right, top]: [f64; 3], Value { style, text, .. }: &Value) {
        let middle = 0.5 * (left + right);
        if self.solid {
            let path = rectangle([left + 1.5, top], [right - left - 3.0, Frame::FLOOR - top]);
            svg.shape(&path, style.colour, style.hollow, "");
            svg.text([middle, top - 5.0], MIDDLE, "note", text);
        } else {
            svg.polyline(&[[middle, Frame::FLOOR], [middle, top]], style.colour, "");
            style.marker(svg, [middle, top], 4.5, text);
        }
    }
}
