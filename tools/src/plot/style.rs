//! Colours and marker shapes: the palette of Okabe and Ito, which colour-blind readers can distinguish, and a
//! separate shape for each colour, for print in grey.

use palpate_core::Method;

use super::svg::Svg;

/// Shape of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
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
pub(crate) struct Style {
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
pub(crate) const PALETTE: [&str; 7] =
    ["#000000", "#e69f00", "#56b4e9", "#009e73", "#d55e00", "#0072b2", "#b0569a"];

impl Style {
    const fn new(colour: usize, shape: Shape, dash: &'static str) -> Self {
        Self { colour: PALETTE[colour], shape, dash, hollow: false }
    }

    /// The style of a method, which is the same in every plot.
    pub(crate) fn of_method(method: Method) -> Self {
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
    pub(crate) fn number(n: usize) -> Self {
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
    pub(crate) fn hollow(self) -> Self {
        Self { hollow: true, ..self }
    }

    /// Draws a marker of radius `r`.
    pub(super) fn marker(&self, svg: &mut Svg, at: [f64; 2], r: f64, title: &str) {
        svg.shape(&self.shape.path(at, r), self.colour, self.hollow, title);
    }

    /// A short line with a marker, for a legend.
    pub(crate) fn swatch(&self) -> String {
        let mut svg = Svg::default();
        svg.polyline(&[[1.0, 8.0], [33.0, 8.0]], self.colour, self.dash);
        self.in_legend(svg, &self.shape.path([17.0, 8.0], 4.5))
    }

    /// A block, for a legend of bars.
    pub(crate) fn block(&self) -> String {
        self.in_legend(Svg::default(), &rectangle([8.0, 2.0], [18.0, 12.0]))
    }

    fn in_legend(&self, mut svg: Svg, path: &str) -> String {
        svg.shape(path, self.colour, self.hollow, "");
        svg.finish(34.0, 16.0, "").replacen("<svg", "<svg class=\"swatch\"", 1)
    }
}

impl Shape {
    /// Its corners for radius 1; none for a circle. The areas of the shapes are about equal.
    const fn corners(self) -> &'static [(f64, f64)] {
        match self {
            Self::Circle => &[],
            Self::Square => &[(-0.88, -0.88), (0.88, -0.88), (0.88, 0.88), (-0.88, 0.88)],
            Self::Diamond => &[(0.0, -1.25), (1.25, 0.0), (0.0, 1.25), (-1.25, 0.0)],
            Self::Up => &[(0.0, -1.25), (1.15, 0.8), (-1.15, 0.8)],
            Self::Down => &[(0.0, 1.25), (1.15, -0.8), (-1.15, -0.8)],
            #[rustfmt::skip]
            Self::Cross => &[
                (0.42, 0.0), (1.15, 0.73), (0.73, 1.15), (0.0, 0.42), (-0.73, 1.15), (-1.15, 0.73),
                (-0.42, 0.0), (-1.15, -0.73), (-0.73, -1.15), (0.0, -0.42), (0.73, -1.15), (1.15, -0.73),
            ],
            #[rustfmt::skip]
            Self::Star => &[
                (0.0, -1.45), (0.364, -0.502), (1.379, -0.448), (0.590, 0.192), (0.852, 1.173),
                (0.0, 0.62), (-0.852, 1.173), (-0.590, 0.192), (-1.379, -0.448), (-0.364, -0.502),
            ],
        }
    }

    /// Its outline in path syntax.
    fn path(self, [x, y]: [f64; 2], r: f64) -> String {
        if self == Self::Circle {
            let (left, r2) = (x - r, 2.0 * r);
            return format!(
                "M{left:.1} {y:.1}a{r:.1} {r:.1} 0 1 0 {r2:.1} 0a{r:.1} {r:.1} 0 1 0 -{r2:.1} 0Z"
            );
        }
        let corners = self.corners().iter().map(|(dx, dy)| format!("{:.1} {:.1}", x + r * dx, y + r * dy));
        format!("M{}Z", corners.collect::<Vec<_>>().join("L"))
    }
}

/// Outline of a rectangle from its upper left corner, in path syntax.
pub(super) fn rectangle([x, y]: [f64; 2], [width, height]: [f64; 2]) -> String {
    format!("M{x:.1} {y:.1}h{width:.1}v{height:.1}h-{width:.1}Z")
}
