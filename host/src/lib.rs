//! The real-time host: drives a haptic device from an organ blob at 1 kHz and shows the organ at 30 Hz.
//!
//! ```text
//! device <-> haptic thread (core's controller, 1 kHz) -> latest value -> viewer (30 Hz)
//!                                                     -> bounded queue -> caller (reports) -> recorder -> FILE.mcap
//! FILE.mcap -> the same loop on a virtual clock (replay): the same forces, bit for bit
//! ```
//!
//! In: a blob, a device, a configuration. Out: forces to the hand, pictures, one record a tick, and what the timing came to.
//!
//! Invariants:
//! - the haptic thread allocates, locks, formats and writes nothing once it runs; it never waits for the viewer or the caller;
//! - on every way out (done, stopped, device lost, panic) the device gets zero force;
//! - the host knows blobs only: no finite-element code is in this process.
//!
//! Depends on palpate-core only. `unsafe` is allowed in [`sys`] alone.
#![deny(unsafe_code)]

pub mod blob_file;
pub mod deformation;
pub mod device;
pub mod doctor;
pub mod instructions;
pub mod model;
pub mod recording;
pub mod replay;
pub mod rt;
pub mod session;
pub mod settings;
pub mod sliding;
pub mod supervisor;
pub mod sys;
pub mod viewer;

#[cfg(test)]
#[path = "../tests/common/synthetic.rs"]
mod synthetic;

pub use blob_file::BlobFile;
pub use device::{Device, DeviceError, DeviceErrorKind, DeviceInfo};
pub use instructions::{Instructions, Interpolator};
pub use recording::{Recorder, Recording};
pub use replay::replay;
pub use rt::TickRecord;
pub use session::{SessionError, SessionOptions, SessionSummary, run_session};
