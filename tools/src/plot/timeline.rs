//! Quantities over one time axis: panels one above the other, and lanes that show when a condition held.

use super::axis::Axis;
use super::svg::{END, MIDDLE, START, Svg};

/// Panels and lanes over one time axis.
#[derive(Debug)]
pub(crate) struct Timeline {
    /// Title above the panels.
    pub title: String,
    /// The time axis.
    pub time: Axis,
    /// The panels from top to bottom.
    pub panels: Vec<Panel>,
    /// The lanes below them.
    pub lanes: Vec<Lane>,
}

/// Curves with one vertical axis.
#[derive(Debug)]
pub(crate) struct Panel {
    /// Quantity and unit.
    pub title: String,
    /// Height of the plot.
    pub height: f64,
    /// The curves; the last one is drawn on top.
    pub curves: Vec<Curve>,
}

/// A curve.
#[derive(Debug)]
pub(crate) struct Curve {
    /// Its name in the legend; empty for a panel with a single curve.
    pub name: &'static str,
    /// Colour in CSS syntax.
    pub colour: &'static str,
    /// Dashes of its line; empty for a solid line.
    pub dash: &'static str,
    /// Pieces of time and value.
    pub pieces: Vec<Vec<[f64; 2]>>,
}

/// The times at which a condition held.
#[derive(Debug)]
pub(crate) struct Lane {
    /// Name of the condition.
    pub name: &'static str,
    /// Colour in CSS syntax.
    pub colour: &'static str,
    /// Whether the times are shaded in the panels, too.
    pub is_shaded: bool,
    /// Beginnings and ends.
    pub spans: Vec<[f64; 2]>,
    /// Moments with a label, in order.
    pub marks: Vec<(f64, &'static str)>,
    /// Text at the right end.
    pub note: String,
}

const WIDTH: f64 = 960.0;
const LEFT: f64 = 104.0;
const RIGHT: f64 = 72.0;
/// Height of the title, of the line above a panel, of a lane, and of the time axis.
const TITLE: f64 = 30.0;
const HEAD: f64 = 30.0;
const LANE: f64 = 17.0;
const FOOT: f64 = 44.0;
/// Height of a block in a lane, and its least width: a single tick must be visible.
const BLOCK: f64 = 9.0;
const LEAST: f64 = 1.5;
/// Opacity of the shading in the panels.
const SHADE: f64 = 0.13;
/// Approximate width of a letter of the legend and of a mark, and length of a line in the legend.
const LETTER: f64 = 6.5;
const SWATCH: f64 = 26.0;

impl Timeline {
    /// The content of an SVG file.
    pub(crate) fn svg_file(&self) -> String {
        let panels: f64 = self.panels.iter().map(|panel| HEAD + panel.height).sum();
        let lanes = TITLE + panels + 0.7 * HEAD;
        let floor = lanes + LANE * self.lanes.len() as f64;
        let mut svg = Svg::default();
        svg.text([LEFT, 20.0], START, "title", &self.title);
        let mut top = TITLE;
        for panel in &self.panels {
            self.draw_panel(&mut svg, top + HEAD, panel);
            top += HEAD + panel.height;
        }
        self.draw_time(&mut svg, [lanes, floor]);
        for (n, lane) in self.lanes.iter().enumerate() {
            self.draw_lane(&mut svg, lanes + LANE * (n as f64 + 0.5), lane);
        }
        svg.finish_file(WIDTH, floor + FOOT, &self.title)
    }

    fn across(&self, time: f64) -> f64 {
        LEFT + self.time.place(time) * (WIDTH - LEFT - RIGHT)
    }

    /// Left edge and width of a span, at least a visible one.
    fn extent(&self, [from, until]: [f64; 2]) -> [f64; 2] {
        let (left, right) = (self.across(from), self.across(until));
        [left, (right - left).max(LEAST)]
    }

    fn draw_panel(&self, svg: &mut Svg, top: f64, panel: &Panel) {
        let (right, floor) = (WIDTH - RIGHT, top + panel.height);
        for lane in self.lanes.iter().filter(|lane| lane.is_shaded) {
            for span in &lane.spans {
                let [x, width] = self.extent(*span);
                svg.block([x, top], [width, panel.height], lane.colour, SHADE);
            }
        }
        let points = || panel.curves.iter().flat_map(|curve| curve.pieces.iter().flatten());
        let axis = Axis::linear("", points().map(|point| point[1]));
        let up = |value: f64| floor - axis.place(value) * panel.height;
        svg.text([LEFT, top - 8.0], START, "label", &panel.title);
        for tick in axis.ticks() {
            let y = up(tick.value);
            svg.line([LEFT, y], [right, y], if tick.value == 0.0 { "axis" } else { "grid" });
            svg.text([LEFT - 6.0, y + 4.0], END, "tick", &tick.text.unwrap_or_default());
        }
        for tick in self.time.ticks() {
            let x = self.across(tick.value);
            svg.line([x, top], [x, floor], "grid");
        }
        svg.line([LEFT, top], [LEFT, floor], "axis");
        for curve in &panel.curves {
            for piece in &curve.pieces {
                let points: Vec<[f64; 2]> =
                    piece.iter().map(|[time, value]| [self.across(*time), up(*value)]).collect();
                svg.polyline(&points, curve.colour, curve.dash);
            }
        }
        self.draw_legend(svg, top - 8.0, panel);
    }

    /// The legend above the right end of a panel, where no curve runs.
    fn draw_legend(&self, svg: &mut Svg, y: f64, panel: &Panel) {
        let mut x = WIDTH - RIGHT;
        for curve in panel.curves.iter().rev().filter(|curve| !curve.name.is_empty()) {
            x -= LETTER * curve.name.chars().count() as f64;
            svg.text([x, y], START, "tick", curve.name);
            x -= SWATCH + 5.0;
            svg.polyline(&[[x, y - 4.0], [x + SWATCH, y - 4.0]], curve.colour, curve.dash);
            x -= 14.0;
        }
    }

    fn draw_time(&self, svg: &mut Svg, [top, floor]: [f64; 2]) {
        let right = WIDTH - RIGHT;
        for tick in self.time.ticks() {
            let x = self.across(tick.value);
            svg.line([x, top], [x, floor], "grid");
            svg.text([x, floor + 16.0], MIDDLE, "tick", &tick.text.unwrap_or_default());
        }
        svg.line([LEFT, floor], [right, floor], "axis");
        svg.text([0.5 * (LEFT + right), floor + 36.0], MIDDLE, "label", &self.time.label);
    }

    fn draw_lane(&self, svg: &mut Svg, middle: f64, lane: &Lane) {
        svg.text([LEFT - 6.0, middle + 4.0], END, "tick", lane.name);
        svg.line([LEFT, middle], [WIDTH - RIGHT, middle], "fine");
        for span in &lane.spans {
            let [x, width] = self.extent(*span);
            svg.block([x, middle - 0.5 * BLOCK], [width, BLOCK], lane.colour, 1.0);
        }
        // A label ends where its block begins. It is left out where there is no room.
        let mut free = LEFT;
        for (time, name) in &lane.marks {
            let right = self.across(*time) - 4.0;
            if right - LETTER * name.chars().count() as f64 >= free {
                svg.text([right, middle + 4.0], END, "tick", name);
                free = right;
            }
        }
        svg.text([WIDTH - RIGHT + 6.0, middle + 4.0], START, "tick", &lane.note);
    }
}
