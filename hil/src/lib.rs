//! Hardware-in-the-loop tests without hardware: emulated haptic devices behind a real transport.
//!
//! ```text
//! Polhem:      host driver <-> pseudo terminal, memory <-> faults (seeded) <-> emulated firmware <-> handle
//! device link: host driver <-> pseudo terminal, memory <-> faults (seeded) <-> link::Device <-> handle
//! Falcon:      host driver <-> FTDI transfers <-> faults (seeded) <-> chip, loader, firmware <-> grip
//! Haply:       host driver <-> WebSocket <-> emulated service <-> handle
//!
//! contract | matrix | closed loop -> rig: a real driver on one of these
//! ```
//!
//! Input: the bytes that a driver sends, and the time. Only a pseudo terminal runs on the wall clock. Output:
//! the bytes that the device returns, and a record of the forces on the hand.
//!
//! Invariants:
//! - Each emulator is written from the protocol's description and shares no code with the driver, so that an
//!   error in one shows against the other.
//! - The emulated Polhem and Falcon have no watchdog, like the real devices: they hold the last command. The
//!   device link has the core's own watchdog.
//! - The same seed and the same times give the same faults.
//!
//! Depends on palpate-core for vectors and the controller. Depends on palpate-host for its hand model, for
//! the trait of the Falcon's USB chip, and in [`rig`] and the modules above it for the drivers and the loop
//! under test.
#![forbid(unsafe_code)]

pub mod bench;
pub mod closed_loop;
pub mod contract;
pub mod emulate;
pub mod falcon;
pub mod fault;
pub mod faulty;
pub mod force_record;
pub mod haply;
pub mod haply_rate;
pub mod hosts;
pub mod link;
pub mod matrix;
pub mod mechanism;
pub mod polhem;
pub mod port;
pub mod rig;
pub mod session;
mod shadow;
pub mod tick;
pub mod transport;
pub mod usbredir;

pub use falcon::{EmulatedFalcon, FalconConfig, FaultyFtdi, MemoryFtdi};
pub use fault::{FaultCounts, Faults};
pub use faulty::Faulty;
pub use force_record::ForceRecord;
pub use link::EmulatedLink;
pub use mechanism::{Handle, Path, Waypoint};
pub use polhem::EmulatedPolhem;
pub use port::MemoryPort;
pub use rig::Rig;
pub use transport::{MemoryTransport, PtyTransport, Transport};
