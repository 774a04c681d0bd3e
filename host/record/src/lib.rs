//! Recordings of sessions: every tick in an MCAP file that robotics viewers can plot and that can be replayed
//! bit for bit.
//!
//! ```text
//! haptic thread -> Recorder's queue (bounded) -> Recorder's thread -> TickWriter -> FILE.mcap
//! FILE.mcap -> Recording (header, ticks, end) -> inspect
//!                                             -> replay: the same loop on a virtual clock
//! ```
//!
//! Inputs: [`TickRecord`](palpate_host::TickRecord)s. Output: one channel of JSON messages with their schema, a
//! metadata record of the settings that a replay must match, and one of the end of the session. A recording of a
//! live session also holds its organ and every jet, so that its replay gives the same bits.
//! docs/formats.md, section 6, describes the file.
//!
//! Invariants:
//! - The haptic thread never waits: records that find the queue full are dropped and counted.
//! - Every float is read back with its bits, finite or not.
//! - A truncated file is readable up to its end. At most the last second is missing.
//!
//! Depends on palpate-core and palpate-host.
#![forbid(unsafe_code)]

mod error;
mod format;
mod header;
mod jet_message;
mod message;
mod reader;
mod recorder;
pub mod replay;
mod replay_device;
mod replay_jets;
mod writer;

pub use error::RecordingError;
pub use format::{FORMAT, JET_TOPIC, SCHEMA, SCHEMA_NAME, TOPIC};
pub use header::{End, Header};
pub use reader::Recording;
pub use recorder::{Queues, Recorder, RecorderReport};
pub use replay::replay;
pub use writer::TickWriter;
