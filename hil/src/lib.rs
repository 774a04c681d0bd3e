//! Hardware in the loop without hardware: emulated haptic devices at the far end of a real transport.
//!
//! ```text
//! host driver <-> pseudo terminal, memory <-> faults (seeded) <-> emulated firmware <-> simulated handle       Polhem
//! host driver <-> pseudo terminal, memory <-> faults (seeded) <-> the core's link::Device <-> simulated handle device link
//! host driver <-> FTDI transfers          <-> faults (seeded) <-> emulated chip, loader, firmware <-> grip     Falcon
//!
//! contract | matrix | closed loop -> rig: a real driver on one of these
//! ```
//!
//! In: bytes as a driver sends them, and the time (no clock is read in here but to give a pseudo terminal time). Out: bytes as the device
//! would answer, and a record of what the device was made to do.
//!
//! Invariants:
//! - the emulator is written from the protocol's description, not from the driver: a mistake would have to be made twice;
//! - it has no watchdog, like the real device: what it was told last it goes on doing. The device link has one, the core's own;
//! - the same seed and the same times give the same faults.
//!
//! Depends on palpate-core for its vectors and its controller, and on palpate-host for its model of a hand, the trait behind which the
//! Falcon's driver expects its chip, and (in [`rig`] and what stands on it) the drivers and the loop that are put to the test.
#![forbid(unsafe_code)]

pub mod bench;
pub mod closed_loop;
pub mod contract;
pub mod emulate;
pub mod falcon;
pub mod fault;
pub mod faulty;
pub mod felt;
pub mod handed;
pub mod hosts;
pub mod link;
pub mod matrix;
pub mod mechanism;
pub mod polhem;
pub mod port;
pub mod rig;
pub mod session;
mod shadow;
pub mod transport;
pub mod usbredir;

pub use falcon::{EmulatedFalcon, FalconConfig, FaultyFtdi, MemoryFtdi};
pub use fault::{FaultCounts, Faults};
pub use faulty::Faulty;
pub use felt::Felt;
pub use link::EmulatedLink;
pub use mechanism::{Handle, Path, Waypoint};
pub use polhem::EmulatedPolhem;
pub use port::MemoryPort;
pub use rig::Rig;
pub use transport::{MemoryTransport, PtyTransport, Transport};
