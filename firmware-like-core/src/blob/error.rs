//! Why a blob was refused, with the numbers that explain it and the fix.

use core::fmt;

use super::format::VERSION;
use crate::grid::LatticeError;
use crate::plane::PlaneError;

/// Why a blob was refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BlobError {
    /// Shorter than any blob.
    #[error("{have} bytes are not an organ blob (the smallest has {need}): is this the right file?")]
    TooShort {
        /// Bytes given.
        have: usize,
        /// Bytes of the smallest blob.
        need: usize,
    },
    /// The buffer's address is not a multiple of 8.
    #[error("the buffer must start at an address divisible by 8: load it into an array of u64")]
    Misaligned,
    /// The first bytes are not those of a blob.
    #[error("this is not an organ blob (it does not start with PALPATE): is this the right file?")]
    BadMagic,
    /// The layout is newer than this reader.
    #[error(
        "the blob has layout version {found}, this program reads version {}: update the program, or {}",
        VERSION,
        AGAIN
    )]
    NewerVersion {
        /// Version of the file.
        found: u32,
    },
    /// A layout version older than any supported one.
    #[error("the blob has the unknown layout version {found}; {}", AGAIN)]
    UnknownVersion {
        /// Version of the file.
        found: u32,
    },
    /// The file is shorter than the length it states.
    #[error("the file is cut short ({have} of {need} bytes): copy it again, or {}", AGAIN)]
    Truncated {
        /// Bytes given.
        have: u64,
        /// Bytes stated.
        need: u64,
    },
    /// The file is longer than the length it states.
    #[error("the file is too long ({have} bytes where {need} were written): copy it again, or {}", AGAIN)]
    TooLong {
        /// Bytes given.
        have: u64,
        /// Bytes stated.
        need: u64,
    },
    /// The bytes are not those that were written.
    #[error(
        "checksum mismatch: the file is damaged (stored {stored:08x}, computed {computed:08x}); {}",
        AGAIN
    )]
    Checksum {
        /// Checksum in the file.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// The header cannot be decoded.
    #[error("the header cannot be decoded; {}", AGAIN)]
    Header,
    /// The blob exceeds a capacity of this build of the core, see [`crate::Limits`].
    #[error(
        "{need} {what} of {} are more than this build holds ({limit}): pack fewer, or build with a larger profile",
        Part(.space, "the organ")
    )]
    Capacity {
        /// The quantity that exceeds its limit.
        what: &'static str,
        /// Index of the space concerned, or `None` for the organ.
        space: Option<u16>,
        /// The number in the blob.
        need: usize,
        /// The largest number that fits.
        limit: usize,
    },
    /// A number in the header is out of its range.
    #[error("{what} of {} is not a valid number; {}", Part(.space, "the organ"), AGAIN)]
    Value {
        /// The field.
        what: &'static str,
        /// Index of the space concerned, or `None` for the organ.
        space: Option<u16>,
    },
    /// The grid of a space was refused.
    #[error("grid of space {space}: {error}; {}", AGAIN)]
    Lattice {
        /// Index of the space.
        space: u16,
        /// The reason.
        error: LatticeError,
    },
    /// A plane of the surface or of a space was refused.
    #[error("{}, {error}; {}", Part(.space, "surface"), AGAIN)]
    Plane {
        /// Index of the space, or `None` for the surface.
        space: Option<u16>,
        /// The reason.
        error: PlaneError,
    },
}

/// The fix for a blob that is not intact.
const AGAIN: &str = "make it again with `palpate pack`";

/// A space, or the name of a part of the blob that is no space.
struct Part<'e>(&'e Option<u16>, &'static str);

impl fmt::Display for Part<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str(self.1),
            Some(space) => write!(f, "space {space}"),
        }
    }
}
