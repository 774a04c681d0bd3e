//! The emulated Falcon on the USB of a virtual machine, in real time. `hil/bench` and `palpate-hil falcon`
//! serve it.
//!
//! ```text
//! guest's driver <-> QEMU <-> socket <-> usbredir::Session <-> Rig (faults, hand) <-> emulated Falcon
//! guest's test   <-> QEMU <-> second serial line <----------> BenchCommand
//! ```
//!
//! In real time a run needs no further commands. For the contract suite the device is a [`Stepped`] one; the
//! rig in the guest advances its time ([`RigRequest`]).
//!
//! Input: two sockets. Output: the device on the bus, and the forces on the hand over the serial line, which
//! no driver can measure. The seed alone determines the faults of a run, so both ends know them.

pub mod command;
mod fault;
mod jump;
pub mod log;
pub mod remote;
pub mod rig;
pub mod serve;
pub mod stepped;

pub use command::{BenchCommand, Reply, Report, Request};
pub use log::BenchRun;
pub use remote::{RigReply, RigRequest};
pub use rig::{HOMING_STEP, Rig};
pub use serve::{Options, serve};
pub use stepped::Stepped;
