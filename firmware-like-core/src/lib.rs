//! The controller core: reads an organ blob, finds contact, interpolates the reaction force and limits it, at
//! 1 kHz.
//!
//! ```text
//! blob (planes, CRC) -> Organ::read -> Space (lattice, tables) -> contact -> interpolate -> limit -> force
//! ```
//!
//! From the bytes of a blob to a command:
//!
//! ```
//! use palpate_core::{AlignedBytes, Config, Controller, Method, Organ, Sample, State, vec3};
//!
//! // std::fs::read in a program.
//! let blob = AlignedBytes::from(include_bytes!("../golden/organ-514.blob"));
//! let organ: Organ = Organ::read(&blob)?;
//! let controller = Controller::new(&organ, Config::new(Method::Energy))?;
//! let (mut state, node) = (State::new(), &organ.spaces[0].active);
//! state.arm();
//! // The tool moves from 1 mm above the active node to 2 mm below it, one sample per millisecond.
//! for tick in 0..300 {
//!     let height_m = 1e-3 - 1e-5 * tick as f32;
//!     let position_m = vec3::add(node.rest_position_m, vec3::scale(node.outward_normal, height_m));
//!     let sample = Sample { t_us: 1_000 * tick, position_m, ..Sample::default() };
//!     let command = controller.tick(&mut state, sample.t_us, Some(&sample));
//!     // command.hand_force_n goes to the device.
//!     # if tick == 299 { assert!(command.engaged == Some(0) && vec3::norm(command.hand_force_n) > 0.1); }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Strata, lowest first; a module imports only from those before it (a test of the workspace asserts it):
//! `num` (numbers), `plane` (checks of arrays), `grid`, `displacement` (the surface for pictures), `method`
//! (the interpolants, behind one trait), `space`, `blob`, `touch` (contact), `guard` (limits), `field` (where the
//! force comes from), `jet` (the jets of a live solver), `controller`.
//!
//! Invariants:
//! - a tick has no allocation, no `unsafe`, no panic, no unbounded loop, no clock and no I/O: time is an
//!   argument;
//! - an organ that [`Organ::read`] accepts can be queried without a further check, and every result is
//!   finite;
//! - h is the force by the tool ON the body. The hand is given -h; quantities for the hand are named
//!   `hand_*`;
//! - positions are in the model frame, displacements relative to the active node at rest; SI units.
//!
//! Features, none by default: `std` uses the hardware square root, with the same bits, and implies `alloc`,
//! which adds [`AlignedBytes`]. This crate depends on no other of the workspace.
#![cfg_attr(not(any(test, feature = "std")), no_std)]
#![forbid(unsafe_code)]

#[cfg(feature = "alloc")]
extern crate alloc;

mod blob;
mod controller;
mod displacement;
mod field;
mod grid;
mod guard;
mod jet;
mod method;
mod named;
mod num;
mod plane;
mod space;
mod tag;
mod touch;

#[cfg(feature = "alloc")]
pub use blob::AlignedBytes;
pub use blob::{Aligned, BlobError, Limits, Organ, Surface, format};
pub use controller::{Command, Config, Controller, ControllerError, Fault, Phase, Sample, State};
pub use displacement::{DisplacementPlanes, DisplacementTable};
pub use field::{Field, Touch};
pub use grid::{BallLattice, CORNERS, LatticeError, Location, MAX_CELLS, flags};
pub use guard::{LimitConfig, PassivityConfig, clamp_force};
pub use jet::{Jet, JetCoupling, JetError, JetFlags, JetMemory, Solver};
pub use method::baseline::rbf::{RBF_LANES, RbfPlanes};
pub use method::hermite::{HermiteNode, HermitePlanes};
pub use method::{Coverage, Estimate, ForceSample, Method, kernel};
pub use num::orientation::Orientation;
pub use num::vec3::Vec3;
pub use num::{lanes, vec3};
pub use plane::{PlaneError, PlaneProblem};
pub use space::{ActiveNode, SPACE_NAME_LEN, Space, SpacePlanes};
pub use tag::ConfigTag;
pub use touch::{ContactConfig, Foot, NodeWeight, TouchSurface, nearest_on_triangle};
