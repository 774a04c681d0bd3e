//! The real-time host: drives a haptic device from an organ blob at 1 kHz.
//!
//! ```text
//! device <-> haptic thread (core's controller, 1 kHz) -> latest value  -> observer (30 Hz): palpate-viewer
//!                                                     -> bounded queue -> statistics, observer
//!                                                     -> bounded queue -> recorder: palpate-record
//! ```
//!
//! Inputs: a blob, a device, a configuration. Outputs: forces for the hand, one record per tick, timing
//! statistics. It knows no window and no file format of records: a driver compiles without them.
//!
//! Invariants:
//! - After start-up the haptic thread does not allocate, lock, format or write. It never waits for an observer
//!   or a recorder.
//! - On every exit (completed, stopped, device lost, panic) the device receives zero force.
//! - The host reads blobs and jets only: this process contains no finite-element code. A live solver is a process
//!   of its own ([`live`]).
//!
//! Depends on palpate-core only. `unsafe` is allowed in [`sys`] alone.
#![deny(unsafe_code)]

pub mod blob_file;
pub mod device;
pub mod doctor;
pub mod first_place;
pub mod guard;
pub mod instructions;
pub mod live;
pub mod model;
pub mod rt;
pub mod session;
pub mod settings;
pub mod sys;
mod vector_form;

#[cfg(test)]
#[path = "../tests/common/synthetic.rs"]
mod synthetic;

pub use blob_file::{BlobFile, PREFERENCE};
pub use device::{Device, DeviceError, DeviceErrorKind, DeviceInfo};
pub use instructions::{Instructions, Interpolator};
pub use rt::TickRecord;
pub use session::{SessionError, SessionOptions, SessionSummary, run_live_session, run_session};
