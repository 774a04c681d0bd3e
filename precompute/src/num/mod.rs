//! Numerical types that are independent of meshes and bodies: SIMD lanes of f64, tensors, symmetric third
//! derivatives.

pub(crate) mod branch;
pub mod jet;
pub(crate) mod lanes;
pub mod parallel;
pub mod sequence;
pub(crate) mod tensor;
pub mod vector;
