//! The organ blob, the only data that crosses from the offline to the on-line part: layout, reader, errors.

mod bytes;
mod error;
pub mod format;
mod profile;
mod reader;

pub use bytes::Aligned;
#[cfg(feature = "alloc")]
pub use bytes::AlignedBytes;
pub use error::BlobError;
pub use profile::{Limits, MICROCONTROLLER_SPACES, PC_SPACES};
pub use reader::{Organ, Surface};

/// An organ on a PC.
pub type PcOrgan<'a> = Organ<'a, PC_SPACES>;

/// An organ on a microcontroller, to be read with [`Organ::read_within`] and [`Limits::MICROCONTROLLER`].
pub type MicrocontrollerOrgan<'a> = Organ<'a, MICROCONTROLLER_SPACES>;
