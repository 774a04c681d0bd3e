//! The emulated Falcon on the bus of a virtual machine, in real time: what `hil/bench` and `palpate-hil falcon` serve.
//!
//! ```text
//! guest's driver <-> QEMU <-> socket <-> usbredir::Session <-> Rig (faults, hand) <-> emulated Falcon
//! guest's test   <-> QEMU <-> second serial line <----------> Orders
//! ```
//!
//! In real time a run goes by itself, and its faults follow from its seed. For the contract suite the device is a [`Stepped`] one instead, whose time
//! the guest's rig moves ([`Ask`]).
//!
//! In: two sockets. Out: the device on the bus, and the truth about it over the serial line: what the hand felt, which no driver can know.
//! The faults of a run follow from its seed alone, so both ends know them.

pub mod ask;
mod jump;
pub mod log;
pub mod order;
pub mod rig;
pub mod serve;
pub mod stepped;
pub mod strike;

pub use ask::{Ask, Told};
pub use order::{Order, Report};
pub use rig::{HOMING_MOVES, Rig};
pub use serve::{Options, serve};
pub use stepped::Stepped;
pub use strike::Strike;
