//! Arithmetic used by the rest of the core: roots, exponentials, vectors of three, and lanes.

pub(crate) mod exponential;
pub mod lanes;
pub(crate) mod math;
pub mod vec3;
