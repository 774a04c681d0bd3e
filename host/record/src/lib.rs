//! Recordings of sessions: every tick in an MCAP file that robotics viewers can plot and that can be replayed
//! bit for bit.
//!
//! ```text
//! haptic thread -> bounded queue -> calling thread -> Recorder (bounded queue) -> TickWriter -> FILE.mcap
//! FILE.mcap -> Recording (header, ticks, end) -> replay | inspect
//! ```
//!
//! Inputs: [`TickRecord`](palpate_host::TickRecord)s. Output: one channel of JSON messages with their schema, a
//! metadata record of the settings that a replay must match, and one of the end of the session.
//! docs/formats.md, section 6, describes the file.
//!
//! Invariants:
//! - Writing never blocks the caller: if the queue is full, the record is dropped and counted.
//! - Every float is read back with its bits, finite or not.
//! - A truncated file is readable up to its end. At most the last second is missing.

mod header;
mod message;
mod reader;
mod recorder;
pub mod replay;
mod replay_device;
mod writer;

pub use header::{End, Header};
pub use reader::Recording;
pub use recorder::{Recorder, RecorderReport};
pub use replay::replay;
pub use writer::TickWriter;

use core::fmt;

/// The channel of the ticks.
pub const TOPIC: &str = "/palpate/tick";
/// Name of the schema of a tick.
pub const SCHEMA_NAME: &str = "palpate.Tick";
/// JSON schema of a tick. Plain types only (no unions, no references): viewers support nothing else.
pub const SCHEMA: &str = include_str!("tick.schema.json");
/// Version of messages and metadata. The reader refuses other versions.
pub const FORMAT: u32 = 3;

/// Name of the metadata record that opens a recording.
const SESSION: &str = "palpate.session";
/// Name of the metadata record that closes it.
const END: &str = "palpate.end";

/// Reason why a recording could not be written or read.
#[derive(Debug)]
pub enum RecordingError {
    /// Reading or writing failed.
    Io(std::io::Error),
    /// Damaged, or compressed with a method that this reader does not support.
    Mcap(mcap::McapError),
    /// Not an MCAP file, not a recording of Palpate, or truncated before the header.
    NotARecording,
    /// Written in another format version.
    Format(String),
    /// An entry of the metadata is missing or invalid.
    Entry(&'static str),
    /// An invalid message.
    Message {
        /// Number of messages before it.
        index: u64,
        /// What is wrong with it.
        what: String,
    },
    /// The recorder's thread panicked.
    Panicked,
}

impl fmt::Display for RecordingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::Mcap(mcap::McapError::UnsupportedCompression(name)) => {
                write!(
                    f,
                    "its chunks are compressed ({name}); unpack it with `mcap compress --compression none`"
                )
            }
            Self::Mcap(error) => write!(f, "damaged: {error}"),
            Self::NotARecording => {
                f.write_str("not a recording of Palpate, or truncated before its first second")
            }
            Self::Format(version) => {
                write!(f, "a recording of version {version}; this program reads version {FORMAT}")
            }
            Self::Entry(key) => write!(f, "`{key}` is missing or invalid in its metadata"),
            Self::Message { index, what } => write!(f, "message {index} is not a valid tick: {what}"),
            Self::Panicked => f.write_str("the recorder panicked (a defect of this program)"),
        }
    }
}

impl core::error::Error for RecordingError {}

impl From<mcap::McapError> for RecordingError {
    fn from(error: mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(error) => Self::Io(error),
            error => Self::Mcap(error),
        }
    }
}

impl From<std::io::Error> for RecordingError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}
