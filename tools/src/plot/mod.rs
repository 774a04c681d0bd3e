//! Plots as SVG, inline or as files, generated without a library: a marker shows its values as a tooltip, one style
//! sheet serves screen and print, and a page needs no other file. The crate `plotters` would save little, because
//! its SVG has neither titles nor classes.

mod axis;
mod bars;
mod chart;
mod style;
mod svg;
mod timeline;

pub(crate) use axis::Axis;
pub(crate) use bars::{Bars, Value};
pub(crate) use chart::{Chart, Point, Series, row};
pub(crate) use style::{PALETTE, Style};
pub(crate) use svg::{STYLE, escaped};
pub(crate) use timeline::{Curve, Lane, Panel, Timeline};
