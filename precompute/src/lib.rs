//! Palpate, offline half: scene -> mesh + material -> static hyperelastic solves -> configuration space -> blob.
//!
//! Inputs: a scene file and its mesh. Outputs: a store of solved configurations (`.space`) and, fitted from it, a
//! blob that `palpate-core` reads. All numbers are f64 and deterministic: the same scene gives the same bits
//! whatever the number of threads.
//!
//! Invariants: SI units; node indices are 0-based file order; h is the force by the tool ON the body, h = dW/dd;
//! displacements are relative to the active node at rest.
#![deny(unsafe_code)]

pub mod assembly;
pub mod blob_writer;
pub mod body;
pub mod boundary;
pub mod certificate;
pub mod configuration_space;
pub mod element;
pub mod error;
pub mod fit;
pub mod held_out;
pub mod kinematics;
pub mod lanes;
pub mod material;
pub mod mesh;
pub mod output;
pub mod pressure;
pub mod scattered;
pub mod scene;
pub mod solve;
pub mod tensor;
