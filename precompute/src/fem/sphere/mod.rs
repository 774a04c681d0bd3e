//! A frictionless rigid sphere against the deformed skin.

mod complementarity;
mod gap;
mod skin;

pub(crate) use complementarity::complementary;
pub(crate) use gap::{Feature, Gap, Variation};
pub(crate) use skin::Skin;

use serde::{Deserialize, Serialize};

/// A rigid sphere without friction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Its radius, m.
    pub radius_m: f64,
}
