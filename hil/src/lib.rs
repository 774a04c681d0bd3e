//! Hardware in the loop without hardware: emulated haptic devices at the far end of a real transport.
//!
//! ```text
//! host driver <-> pseudo terminal <-> faults (seeded) <-> emulated firmware <-> simulated handle
//! ```
//!
//! In: bytes as a driver sends them, and the time (no clock is read in here). Out: bytes as the device would answer, and a record of what
//! the device was made to do.
//!
//! Invariants:
//! - the emulator is written from the protocol's description, not from the driver: a mistake would have to be made twice;
//! - it has no watchdog, like the real device: what it was told last it goes on doing;
//! - the same seed and the same times give the same faults.
//!
//! Depends on palpate-core for its vectors only; the host's driver appears in the tests.
#![forbid(unsafe_code)]

pub mod fault;
pub mod mechanism;
pub mod polhem;
pub mod transport;

pub use fault::{Faults, Faulty};
pub use mechanism::{Handle, Waypoint};
pub use polhem::EmulatedPolhem;
pub use transport::{MemoryTransport, PtyTransport, Transport};
