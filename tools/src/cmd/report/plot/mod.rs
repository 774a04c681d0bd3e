//! Plots as inline SVG, written by hand: a pointer that rests on a marker is told its figures, one style
//! sheet serves screen and print, and the page needs no file beside it. Crate `plotters` would save little:
//! its SVG has neither titles nor classes.

mod axis;
mod bars;
mod chart;
mod style;
mod svg;

pub(super) use axis::Axis;
pub(super) use bars::{Bars, Group, Value};
pub(super) use chart::{Chart, Point, Series};
pub(super) use style::Style;
pub(super) use svg::escaped;
