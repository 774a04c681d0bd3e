//! The error of a recording.

use crate::format::FORMAT;
use core::fmt;

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
    Metadata(String),
    /// An invalid message.
    Message {
        /// Number of messages before it.
        index: u64,
        /// What is wrong with it.
        what: String,
    },
    /// The organ of a live session is too large to be part of the recording: its bytes.
    Organ(usize),
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
            Self::Metadata(what) => write!(f, "invalid metadata: {what}"),
            Self::Message { index, what } => write!(f, "message {index} is not a valid tick: {what}"),
            Self::Organ(len) => write!(f, "the organ of {len} bytes is too large for a recording"),
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
