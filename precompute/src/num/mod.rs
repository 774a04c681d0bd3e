//! Numerical types that are independent of meshes and bodies: the jet of the condensed energy, vectors and
//! tensors, SIMD lanes of f64, deterministic sequences, and worker threads.

pub(crate) mod branch;
pub(crate) mod jet;
pub(crate) mod lanes;
pub(crate) mod parallel;
pub(crate) mod sequence;
pub(crate) mod tensor;
pub(crate) mod vector;

pub use jet::{EnergyJet, SECOND_INDICES, THIRD_INDICES};
pub use parallel::{ThreadError, in_parallel, on_each_thread};
pub use sequence::{SPLIT_MIX_STEP, in_ball, split_mix, unit_interval};
pub use vector::{distance, norm};
