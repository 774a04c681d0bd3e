//! The SVG elements of the plots, as text.

use std::fmt::Write;

/// The style sheet of the plots.
pub(crate) const STYLE: &str = include_str!("style.css");

/// Edge of a text at its position, in SVG's words.
pub(super) const START: &str = "start";
pub(super) const MIDDLE: &str = "middle";
pub(super) const END: &str = "end";

/// A drawing under construction.
#[derive(Debug, Default)]
pub(super) struct Svg {
    body: String,
}

impl Svg {
    /// The whole element, `width` by `height` units, with `title` for screen readers.
    pub(super) fn finish(self, width: f64, height: f64, title: &str) -> String {
        format!(
            "<svg viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" aria-label=\"{}\">{}</svg>",
            escaped(title),
            self.body
        )
    }

    /// The same as the content of a file: with the style sheet of the plots, on white.
    pub(super) fn finish_file(self, width: f64, height: f64, title: &str) -> String {
        let own =
            format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" ");
        let head =
            format!("><style>\n{STYLE}</style><rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>");
        self.finish(width, height, title).replacen("<svg ", &own, 1).replacen('>', &head, 1) + "\n"
    }

    /// Another whole element with its upper left corner at a place.
    pub(super) fn inside(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], element: &str) {
        let own = format!("<svg x=\"{x:.0}\" y=\"{y:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" ");
        self.body.push_str(&element.replacen("<svg ", &own, 1));
    }

    /// A straight line with a class of the style sheet.
    pub(super) fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], class: &str) {
        let _ = write!(
            self.body,
            "<line class=\"{class}\" x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\"/>"
        );
    }

    /// A line through points.
    pub(super) fn polyline(&mut self, points: &[[f64; 2]], colour: &str, dash: &str) {
        let _ = write!(
            self.body,
            "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\" stroke-dasharray=\"{dash}\" points=\""
        );
        for [x, y] in points {
            let _ = write!(self.body, "{x:.1},{y:.1} ");
        }
        self.body.push_str("\"/>");
    }

    /// A closed outline in path syntax, filled or hollow, with `title` as tooltip.
    pub(super) fn shape(&mut self, path: &str, colour: &str, hollow: bool, title: &str) {
        let fill = if hollow { "#ffffff" } else { colour };
        let _ = write!(
            self.body,
            "<path d=\"{path}\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.2\"><title>{}</title></path>",
            escaped(title)
        );
    }

    /// A filled rectangle from its upper left corner.
    pub(super) fn block(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], colour: &str, opacity: f64) {
        let _ = write!(
            self.body,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{colour}\" \
             fill-opacity=\"{opacity}\"/>"
        );
    }

    /// Text with a class of the style sheet.
    pub(super) fn text(&mut self, [x, y]: [f64; 2], anchor: &str, class: &str, text: &str) {
        let _ = write!(
            self.body,
            "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>",
            escaped(text)
        );
    }

    /// Text that runs upwards.
    pub(super) fn text_upwards(&mut self, [x, y]: [f64; 2], class: &str, text: &str) {
        let _ = write!(
            self.body,
            "<text class=\"{class}\" transform=\"translate({x:.1} {y:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escaped(text)
        );
    }
}

/// Text escaped for element content and attributes.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
