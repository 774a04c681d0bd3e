//! Colours and marker shapes: the palette of Okabe and Ito, which colour-blind readers can distinguish, and a
//! separate shape for each colour, for print in grey.

use palpate_core::Method;

use super::svg::Svg;

/// Shape of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Shape {
    Circle,
    Square,
    Diamond,
    Up,
    Down,
    Cross,
    Star,
}

/// Style of a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Style {
    /// Colour in CSS syntax.
    pub colour: &'static str,
    /// Shape of its markers.
    pub shape: Shape,
    /// Dashes of its line; empty for a solid line.
    pub dash: &'static str,
    /// Whether its markers have a white interior.
    pub hollow: bool,
}

/// Black, orange, sky, green, vermilion, blue, purple.
const PALETTE: [&str; 7] = ["#000000", "#e69f00", "#56b4e9", "#009e73", "#d55e00", "#0072b2", "#b0569a"];

impl Style {
    const fn new(colour: usize, shape: Shape, dash: &'static str) -> Self {
        Self { colour: PALETTE[colour], shape, dash, hollow: false }
    }

    /// The style of a method, which is the same in every plot.
    pub(in super::super) fn of_method(method: Method) -> Self {
        match method {
            Method::Trilinear => Self::new(1, Shape::Circle, ""),
            Method::Tricubic => Self::new(2, Shape::Square, ""),
            Method::Hybrid => Self::new(3, Shape::Diamond, "6 3"),
            Method::RbfLinear => Self::new(6, Shape::Down, "2 3"),
            Method::RbfCubic => Self::new(4, Shape::Cross, ""),
            Method::Hermite => Self::new(5, Shape::Up, "6 3"),
            Method::Energy => Self::new(0, Shape::Star, ""),
            Method::Kernel => Self::new(0, Shape::Diamond, "2 3"),
        }
    }

    /// One of several styles for series without a style of their own.
    pub(in super::super) fn number(n: usize) -> Self {
        const ALL: [Style; 7] = [
            Style::new(5, Shape::Circle, ""),
            Style::new(4, Shape::Square, "6 3"),
            Style::new(3, Shape::Up, "2 3"),
            Style::new(1, Shape::Diamond, "8 3 2 3"),
            Style::new(6, Shape::Down, ""),
            Style::new(2, Shape::Star, "6 3"),
            Style::new(0, Shape::Cross, ""),
        ];
        ALL[n % ALL.len()]
    }

    /// The same style with hollow markers.
    pub(in super::super) fn hollow(self) -> Self {
        Self { hollow: true, ..self }
    }

    /// Draws a marker of radius `r`.
    pub(super) fn marker(&self, svg: &mut Svg, at: [f64; 2], r: f64, title: &str) {
        svg.shape(&self.shape.path(at, r), self.colour, self.hollow, title);
    }

    /// A short line with a marker, for a legend.
    pub(in super::super) fn swatch(&self) -> String {
        let mut svg = Svg::default();
        svg.polyline(&[[1.0, 8.0], [33.0, 8.0]], self.colour, self.dash, 1.6);
        self.marker(&mut svg, [17.0, 8.0], 4.5, "");
        svg.finish(34.0, 16.0, "").replacen("<svg", "<svg class=\"swatch\"", 1)
    }

    /// A block, for a legend of bars.
    pub(in super::super) fn block(&self) -> String {
        let mut svg = Svg::default();
        svg.rectangle([8.0, 2.0], [18.0, 12.0], self.colour, self.hollow);
        svg.finish(34.0, 16.0, "").replacen("<svg", "<svg class=\"swatch\"", 1)
    }
}

impl Shape {
    /// Its outline. The areas of the shapes are about equal.
    fn path(self, [x, y]: [f64; 2], r: f64) -> String {
        let corners = |corners: &[(f64, f64)]| -> String {
            let points: Vec<String> =
                corners.iter().map(|(dx, dy)| format!("{:.1} {:.1}", x + r * dx, y + r * dy)).collect();
            format!("M{}Z", points.join("L"))
        };
        match self {
            Self::Circle => {
                let (left, r2) = (x - r, 2.0 * r);
                format!("M{left:.1} {y:.1}a{r:.1} {r:.1} 0 1 0 {r2:.1} 0a{r:.1} {r:.1} 0 1 0 -{r2:.1} 0Z")
            }
            Self::Square => corners(&[(-0.88, -0.88), (0.88, -0.88), (0.88, 0.88), (-0.88, 0.88)]),
            Self::Diamond => corners(&[(0.0, -1.25), (1.25, 0.0), (0.0, 1.25), (-1.25, 0.0)]),
            Self::Up => corners(&[(0.0, -1.25), (1.15, 0.8), (-1.15, 0.8)]),
            Self::Down => corners(&[(0.0, 1.25), (1.15, -0.8), (-1.15, -0.8)]),
            Self::Cross => {
                let (a, b) = (1.15, 0.42);
                let arm = [(b, 0.0), (a, a - b), (a - b, a), (0.0, b)];
                let mut all = Vec::new();
                for (sx, sy, back) in
                    [(1.0, 1.0, false), (-1.0, 1.0, true), (-1.0, -1.0, false), (1.0, -1.0, true)]
                {
                    let mut quarter = arm.map(|(x, y)| (sx * x, sy * y));
                    if back {
                        quarter.reverse();
                    }
                    all.extend(quarter);
                }
                corners(&all)
            }
            Self::Star => {
                let spike = |n: u32| {
                    let (s, c) = (std::f64::consts::PI * f64::from(n) / 5.0).sin_cos();
                    let r = if n.is_multiple_of(2) { 1.45 } else { 0.62 };
                    (r * s, -r * c)
                };
                corners(&(0..10).map(spike).collect::<Vec<_>>())
            }
        }
    }
}
