//! The controller core: reads an organ blob, finds contact, interpolates the reaction force, limits it. 1 kHz.
//!
//! ```text
//! blob (planes, CRC) -> Organ::read -> Space (lattice, tables) -> contact -> interpolate -> limit -> hand force
//! ```
//!
//! In: one blob as bytes (checked once, never copied) and, each tick, the time and the newest HIP sample.
//! Out: one [`controller::Command`]: the force for the hand and what the viewer and the recorder want to know.
//!
//! Invariants:
//! - no allocation, no `unsafe`, no panic path, no unbounded loop, no clock and no I/O: time is an argument;
//! - what [`blob::Organ::read`] accepts can be queried without a further check, and every query is finite;
//! - h is the force by the tool ON the body. The hand is given -h, and whatever is meant for it is named `hand_*`;
//! - positions are in the model frame, displacements relative to the active node at rest; SI units.
//!
//! Depends on no other crate of ours: blob layout and controller are what both ends of the link share.
#![cfg_attr(not(any(test, feature = "std")), no_std)]
#![forbid(unsafe_code)]

pub mod blend;
pub mod blob;
pub mod contact;
pub mod continuation;
pub mod controller;
pub mod displacement;
pub mod fade;
pub mod flags;
pub mod grid;
pub mod hermite;
pub mod kernel;
pub mod lanes;
pub mod limit;
pub mod math;
pub mod method;
pub mod passivity;
pub mod profile;
pub mod rbf;
pub mod speed;
pub mod stiffness;
pub mod surface;
pub mod table;
pub mod tag;
pub mod tricubic;
pub mod trilinear;
pub mod vec3;
pub mod velocity;

pub use blob::{BlobError, Organ, Surface};
pub use contact::{ContactConfig, ContactKind};
pub use controller::{Command, Config, Controller, Fault, Phase, Sample, State};
pub use grid::{BallLattice, LatticeError};
pub use limit::LimitConfig;
pub use method::{Coverage, Estimate, ForceSample, Method};
pub use passivity::PassivityConfig;
pub use surface::{Share, TouchSurface};
pub use table::Space;
pub use tag::ConfigTag;
pub use vec3::Vec3;
