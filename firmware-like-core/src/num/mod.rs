//! Arithmetic used by the rest of the core: roots, exponentials, vectors of three, rotations, and lanes.

pub(crate) mod exponential;
pub mod lanes;
pub(crate) mod math;
pub(crate) mod orientation;
pub mod vec3;
