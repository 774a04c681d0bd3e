//! Numbers that know nothing of meshes or bodies: lanes of f64, tensors of them, symmetric third derivatives.

pub mod branch;
pub mod jet;
pub mod lanes;
pub mod tensor;
pub mod vector;
