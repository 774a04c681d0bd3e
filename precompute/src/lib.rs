//! Palpate, offline half: scene -> mesh + material -> static hyperelastic solves -> configuration space -> blob.
//!
//! Inputs: a scene file and its mesh. Outputs: a store of solved configurations (`.space`) and, fitted from it, a
//! blob that `palpate-core` reads. All numbers are f64 and deterministic: the same scene gives the same bits
//! whatever the number of threads.
//!
//! Invariants: SI units; node indices are 0-based file order; h is the force by the tool ON the body, h = dW/dd;
//! displacements are relative to the active node at rest.
#![deny(unsafe_code)]

pub mod adaptive;
pub mod certificate;
pub mod error;
pub mod fem;
pub mod files;
pub mod fit;
pub mod held_out;
pub mod mesh;
pub mod num;
pub mod pack;
pub mod scene;
pub mod space;
pub mod spec;
