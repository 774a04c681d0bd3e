//! Arithmetic that the rest of the core stands on: roots, exponentials, vectors of three, and lanes.

pub(crate) mod exponential;
pub mod lanes;
pub(crate) mod math;
pub mod vec3;
