//! Recordings of sessions: every tick in an MCAP file that robotics viewers plot and that can be replayed bit for bit.
//!
//! ```text
//! haptic thread -> bounded queue -> calling thread -> Recorder (bounded queue) -> its thread -> TickWriter -> FILE.mcap
//! FILE.mcap -> Recording (header, ticks, end) -> replay | inspect
//! ```
//!
//! In: [`TickRecord`](crate::TickRecord)s. Out: one channel of JSON messages with their schema inside, a metadata record of what a replay
//! must match, and one of how the session ended. docs/formats.md, section 6, describes the file.
//!
//! Invariants:
//! - nobody waits for the disk: a record that finds the queue full is dropped and counted;
//! - what is read back has the bits that were written, of every float, finite or not;
//! - a file is readable up to where it ends, whatever ended it; at most the last second is missing.

mod header;
mod message;
mod reader;
mod recorder;
mod writer;

pub use header::{End, Header};
pub use reader::Recording;
pub use recorder::{Recorder, RecorderReport};
pub use writer::TickWriter;

use core::fmt;

/// The channel of the ticks.
pub const TOPIC: &str = "/palpate/tick";
/// Name of the schema of a tick.
pub const SCHEMA_NAME: &str = "palpate.Tick";
/// JSON schema of a tick. Plain types only (no unions, no references): viewers understand no more.
pub const SCHEMA: &str = include_str!("tick.schema.json");
/// Version of messages and metadata; another one is refused.
pub const FORMAT: u32 = 3;

/// Name of the metadata record that opens a recording.
const SESSION: &str = "palpate.session";
/// Name of the metadata record that closes it.
const END: &str = "palpate.end";

/// Why a recording was not written or cannot be read.
#[derive(Debug)]
pub enum RecordingError {
    /// Reading or writing failed.
    Io(std::io::Error),
    /// Damaged, or compressed in a way that is not read here.
    Mcap(mcap::McapError),
    /// No MCAP file, or none of Palpate's, or cut before it began.
    NotARecording,
    /// Of another version.
    Format(String),
    /// An entry of the metadata is missing or has no sense.
    Entry(&'static str),
    /// A message that is no tick.
    Message {
        /// Messages before it.
        index: u64,
        /// What is wrong.
        what: String,
    },
    /// The thread of the recorder panicked.
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
            Self::NotARecording => f.write_str("no recording of Palpate, or cut before its first second"),
            Self::Format(version) => {
                write!(f, "a recording of version {version}; this program reads version {FORMAT}")
            }
            Self::Entry(key) => write!(f, "`{key}` is missing or has no sense in its metadata"),
            Self::Message { index, what } => write!(f, "message {index} is no tick: {what}"),
            Self::Panicked => f.write_str("the recorder panicked (a fault of this program)"),
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
