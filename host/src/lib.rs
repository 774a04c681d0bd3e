//! The real-time host: drives a haptic device from an organ blob at 1 kHz and shows the organ at 30 Hz.
//!
//! ```text
//! device <-> haptic thread (core's controller, 1 kHz) -> latest value -> viewer (30 Hz)
//!                                                     -> bounded queue -> caller -> recorder -> FILE.mcap
//! FILE.mcap -> the same loop on a virtual clock (replay): the same forces, bit for bit
//! ```
//!
//! Inputs: a blob, a device, a configuration. Outputs: forces for the hand, pictures, one record per tick,
//! timing statistics.
//!
//! Invariants:
//! - After start-up the haptic thread does not allocate, lock, format or write. It never waits for the viewer
//!   or the caller.
//! - On every exit (completed, stopped, device lost, panic) the device receives zero force.
//! - The host reads blobs only: this process contains no finite-element code.
//!
//! Depends on palpate-core only. `unsafe` is allowed in [`sys`] alone.
#![deny(unsafe_code)]

pub mod blob_file;
pub mod device;
pub mod doctor;
pub mod instructions;
pub mod model;
pub mod rt;
pub mod session;
pub mod settings;
pub mod sliding;
pub mod supervisor;
pub mod sys;

#[cfg(test)]
#[path = "../tests/common/synthetic.rs"]
mod synthetic;

pub use blob_file::BlobFile;
pub use device::{Device, DeviceError, DeviceErrorKind, DeviceInfo};
pub use instructions::{Instructions, Interpolator};
pub use rt::TickRecord;
pub use session::{SessionError, SessionOptions, SessionSummary, run_session};
