//! The emulated Falcon on the USB of a virtual machine, in real time. `hil/bench` and `palpate-hil falcon`
//! serve it.
//!
//! ```text
//! guest's driver <-> QEMU <-> socket <-> usbredir::Session <-> Rig (faults, hand) <-> emulated Falcon
//! guest's test   <-> QEMU <-> second serial line <----------> BenchCommand
//! ```
//!
//! Input: two sockets. Output: the device on the bus, and the forces on the hand over the serial line, which
//! no driver can measure. The seed alone determines the faults of a run, so both ends know them.

pub mod command;
mod fault;
mod jump;
pub mod log;
pub mod rig;
pub mod serve;

pub use command::{BenchCommand, Reply, Report};
pub use log::BenchRun;
pub use rig::{HOMING_STEP, Rig};
pub use serve::{Options, serve};
