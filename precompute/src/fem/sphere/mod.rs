//! A frictionless sphere or capsule against the deformed skin: rigid, or with a thin elastic layer.

mod beside;
mod complementarity;
mod foot;
mod gap;
mod layer;
mod overlap;
mod skin;
mod wall;

pub(crate) use complementarity::complementary;
pub(crate) use gap::{Feature, Gap, Variation};
pub use layer::{CoatedSphere, Layer};
pub(crate) use skin::Skin;

use serde::{Deserialize, Serialize};

/// Where a sphere or capsule is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Posture {
    /// Displacement of its centre from where that is zero, m.
    pub(crate) displacement_m: [f64; 3],
    /// Half axis of a capsule, m; zero of a sphere.
    pub(crate) half_m: [f64; 3],
}

/// A capsule without friction: what a sphere covers whose centre moves along a line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Capsule {
    /// The sphere.
    pub sphere: Sphere,
    /// The way from the middle of the line to one end in the frame of the grip, m.
    pub half_axis_m: [f64; 3],
}

/// A sphere without friction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Its radius, m.
    pub radius_m: f64,
    /// Its elastic layer: what fields and live touch use.
    pub layer: Layer,
}

impl Sphere {
    /// Share of the layer outside the radius. With a third inside, the force differs from that of the rigid sphere as often
    /// up as down.
    const OUTSIDE: f64 = 2.0 / 3.0;

    /// Distance from the centre within which the layer touches, m.
    pub fn reach_m(&self) -> f64 {
        self.radius_m + Self::OUTSIDE * self.layer.thickness_m
    }
}
