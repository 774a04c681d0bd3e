//! A frictionless sphere against the deformed skin: rigid, or with a thin elastic layer.

mod complementarity;
mod gap;
mod layer;
mod skin;

pub(crate) use complementarity::complementary;
pub(crate) use gap::{Feature, Gap, Variation};
pub use layer::{CoatedSphere, Layer};
pub(crate) use skin::Skin;

use serde::{Deserialize, Serialize};

/// A sphere without friction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Its radius, m.
    pub radius_m: f64,
    /// Its elastic layer: what fields and live touch use.
    pub layer: Layer,
}
