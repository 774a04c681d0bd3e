//! Hardware in the loop without hardware: emulated haptic devices at the far end of a real transport.
//!
//! ```text
//! host driver <-> pseudo terminal <-> faults (seeded) <-> emulated firmware <-> simulated handle       Polhem
//! host driver <-> FTDI transfers  <-> faults (seeded) <-> emulated chip, loader, firmware <-> grip     Falcon
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
//! Depends on palpate-core for its vectors, and on palpate-host for its model of a hand and the trait behind which the Falcon's driver
//! expects its chip; the drivers themselves appear in the tests and in the bench's guest only.
#![forbid(unsafe_code)]

pub mod bench;
pub mod falcon;
pub mod fault;
pub mod faulty;
pub mod mechanism;
pub mod polhem;
pub mod transport;
pub mod usbredir;

pub use falcon::{EmulatedFalcon, FalconConfig, FaultyFtdi, MemoryFtdi};
pub use fault::{FaultCounts, Faults};
pub use faulty::Faulty;
pub use mechanism::{Handle, Path, Waypoint};
pub use polhem::EmulatedPolhem;
pub use transport::{MemoryTransport, PtyTransport, Transport};
