//! Plots as inline SVG, generated without a library: a marker shows its values as a tooltip, one style sheet
//! serves screen and print, and the page needs no other file. The crate `plotters` would save little, because
//! its SVG has neither titles nor classes.

mod axis;
mod bars;
mod chart;
mod style;
mod svg;

pub(super) use axis::Axis;
pub(super) use bars::{Bars, Value};
pub(super) use chart::{Chart, Point, Series};
pub(super) use style::Style;
pub(super) use svg::escaped;
