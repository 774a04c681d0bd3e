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
pub use profile::Limits;
pub use reader::{Organ, Surface};
