//! A plot of series over two axes.

use super::axis::Axis;
use super::style::Style;
use super::svg::{END, MIDDLE, START, Svg};

/// A plot.
#[derive(Debug)]
pub(crate) struct Chart {
    /// Title above the plot.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The series.
    pub series: Vec<Series>,
    /// Level lines across the plot, each with a label.
    pub levels: Vec<(f64, String)>,
}

/// A series of points.
#[derive(Debug)]
pub(crate) struct Series {
    /// Its style.
    pub style: Style,
    /// Whether its points are connected.
    pub joined: bool,
    /// Whether its points have markers.
    pub marked: bool,
    /// Its points.
    pub points: Vec<Point>,
}

/// One point.
#[derive(Debug, Clone)]
pub(crate) struct Point {
    /// Horizontal value.
    pub x: f64,
    /// Vertical value.
    pub y: f64,
    /// Radius of its marker.
    pub r: f64,
    /// Tooltip.
    pub title: String,
    /// Label beside it.
    pub note: Option<String>,
}

/// Size of a plot in its own units; the page scales it.
pub(super) const WIDTH: f64 = 460.0;
pub(super) const HEIGHT: f64 = 330.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 48.0;

/// Approximate width of a digit of a tick label.
const TICK: f64 = 6.0;
/// Approximate width of a letter of a note, and height of its line.
const NOTE: [f64; 2] = [5.0, 9.0];
/// Offsets of a note from its point: above, below, or in line with it.
const NOTE_DY: [f64; 3] = [-5.0, 12.0, 4.0];

/// Whether two boxes (left, right, top, bottom) overlap.
fn overlap(a: &[f64; 4], b: &[f64; 4]) -> bool {
    a[0] < b[1] && b[0] < a[1] && a[2] < b[3] && b[2] < a[3]
}

/// Position of a pair of axes in the drawing.
pub(super) struct Frame<'a> {
    pub x: Option<&'a Axis>,
    pub y: &'a Axis,
}

impl Frame<'_> {
    pub(super) fn across(share: f64) -> f64 {
        LEFT + share * (WIDTH - LEFT - RIGHT)
    }

    pub(super) fn up(&self, value: f64) -> f64 {
        HEIGHT - BOTTOM - self.y.place(value) * (HEIGHT - BOTTOM - TOP)
    }

    pub(super) const FLOOR: f64 = HEIGHT - BOTTOM;

    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [Self::across(self.x.map_or(0.0, |axis| axis.place(x))), self.up(y)]
    }

    /// Grid lines, ticks and labels.
    pub(super) fn draw(&self, svg: &mut Svg, title: &str, x_label: &str) {
        let (left, right, floor) = (Self::across(0.0), Self::across(1.0), Self::FLOOR);
        svg.text([left, 16.0], START, "title", title);
        for tick in self.y.ticks() {
            let y = self.up(tick.value);
            svg.line([left, y], [right, y], if tick.text.is_some() { "grid" } else { "fine" });
            if let Some(text) = tick.text {
                svg.text([left - 6.0, y + 4.0], END, "tick", &text);
            }
        }
        for tick in self.x.map(Axis::ticks).unwrap_or_default() {
            let x = Self::across(self.x.map_or(0.0, |axis| axis.place(tick.value)));
            svg.line([x, TOP], [x, floor], if tick.text.is_some() { "grid" } else { "fine" });
            if let Some(text) = tick.text {
                let half = 0.5 * TICK * text.chars().count() as f64;
                svg.text([x.min(WIDTH - half), floor + 16.0], MIDDLE, "tick", &text);
            }
        }
        svg.line([left, floor], [right, floor], "axis");
        svg.line([left, TOP], [left, floor], "axis");
        svg.text([0.5 * (left + right), HEIGHT - 8.0], MIDDLE, "label", x_label);
        svg.text_upwards([14.0, 0.5 * (TOP + floor)], "label", &self.y.label);
    }

    /// A level line with its label.
    pub(super) fn level(&self, svg: &mut Svg, value: f64, word: &str) {
        if self.y.holds(value) {
            let y = self.up(value);
            svg.line([Self::across(0.0), y], [Self::across(1.0), y], "level");
            svg.text([Self::across(1.0) - 3.0, y - 4.0], END, "note", word);
        }
    }
}

/// Plots beside each other, as the content of a file.
pub(crate) fn row(charts: &[Chart], title: &str) -> String {
    let mut svg = Svg::default();
    for (number, chart) in charts.iter().enumerate() {
        svg.inside([number as f64 * WIDTH, 0.0], [WIDTH, HEIGHT], &chart.svg());
    }
    svg.finish_file(charts.len() as f64 * WIDTH, HEIGHT, title)
}

impl Chart {
    /// Returns the drawing.
    pub(crate) fn svg(&self) -> String {
        let mut svg = Svg::default();
        let frame = Frame { x: Some(&self.x), y: &self.y };
        frame.draw(&mut svg, &self.title, &self.x.label);
        for (value, word) in &self.levels {
            frame.level(&mut svg, *value, word);
        }
        let shown = |p: &&Point| p.x.is_finite() && p.y.is_finite();
        for series in self.series.iter().filter(|series| series.joined) {
            let points: Vec<[f64; 2]> =
                series.points.iter().filter(shown).map(|p| frame.at(p.x, p.y)).collect();
            svg.polyline(&points, series.style.colour, series.style.dash);
        }
        // Markers above all lines, the small ones last, so that none is hidden completely.
        let mut marks: Vec<(&Style, &Point)> = self
            .series
            .iter()
            .filter(|series| series.marked)
            .flat_map(|series| series.points.iter().filter(shown).map(|p| (&series.style, p)))
            .collect();
        marks.sort_by(|(_, a), (_, b)| b.r.total_cmp(&a.r));
        let mut written: Vec<[f64; 4]> = Vec::new();
        for (style, point) in marks {
            let at = frame.at(point.x, point.y);
            style.marker(&mut svg, at, point.r, &point.title);
            if let Some(note) = &point.note {
                // Beside the point, on the side of the middle of the plot.
                let (side, anchor) = if self.x.place(point.x) > 0.7 { (-1.0, END) } else { (1.0, START) };
                let x = at[0] + side * (point.r + 4.0);
                let width = NOTE[0] * note.chars().count() as f64;
                let left = if side < 0.0 { x - width } else { x };
                // Above or below, at the first position without another note.
                let boxed = |dy: f64| [left, left + width, at[1] + dy - NOTE[1], at[1] + dy];
                let is_free = |dy: &f64| !written.iter().any(|other| overlap(other, &boxed(*dy)));
                let dy = NOTE_DY.into_iter().find(is_free).unwrap_or(NOTE_DY[0]);
                written.push(boxed(dy));
                svg.text([x, at[1] + dy], anchor, "note", note);
            }
        }
        svg.finish(WIDTH, HEIGHT, &self.title)
    }
}
