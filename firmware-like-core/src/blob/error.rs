//! Why a blob was refused, with the numbers that explain it and the fix.

use core::fmt;

use crate::grid::LatticeError;
use crate::plane::PlaneError;

/// Why a blob was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BlobError {
    /// Shorter than any blob.
    TooShort {
        /// Bytes given.
        have: usize,
        /// Bytes of the smallest blob.
        need: usize,
    },
    /// The buffer's address is not a multiple of 8.
    Misaligned,
    /// The first bytes are not those of a blob.
    BadMagic,
    /// The layout is newer than this reader.
    NewerVersion {
        /// Version of the file.
        found: u32,
        /// Newest version that this reader supports.
        supported: u32,
    },
    /// A layout version older than any supported one.
    UnknownVersion {
        /// Version of the file.
        found: u32,
    },
    /// The file is shorter than the length it states.
    Truncated {
        /// Bytes given.
        have: u64,
        /// Bytes stated.
        need: u64,
    },
    /// The file is longer than the length it states.
    TooLong {
        /// Bytes given.
        have: u64,
        /// Bytes stated.
        need: u64,
    },
    /// The bytes are not those that were written.
    Checksum {
        /// Checksum in the file.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// The header cannot be decoded.
    Header,
    /// The blob exceeds a capacity of this build of the core, see [`crate::Limits`].
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
    Value {
        /// The field.
        what: &'static str,
        /// Index of the space concerned, or `None` for the organ.
        space: Option<u16>,
    },
    /// The grid of a space was refused.
    Lattice {
        /// Index of the space.
        space: u16,
        /// The reason.
        error: LatticeError,
    },
    /// A plane of the surface or of a space was refused.
    Plane {
        /// Index of the space, or `None` for the surface.
        space: Option<u16>,
        /// The reason.
        error: PlaneError,
    },
}

/// Part of the blob, for messages.
struct Of(Option<u16>);

impl fmt::Display for Of {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("of the organ"),
            Some(space) => write!(f, "of space {space}"),
        }
    }
}

impl fmt::Display for BlobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const AGAIN: &str = "make it again with `palpate pack`";
        match self {
            Self::TooShort { have, need } => {
                write!(
                    f,
                    "{have} bytes are not an organ blob (the smallest has {need}): is this the right file?"
                )
            }
            Self::Misaligned => f.write_str(
                "the buffer must start at an address divisible by 8: load it into an array of u64",
            ),
            Self::BadMagic => f.write_str(
                "this is not an organ blob (it does not start with PALPATE): is this the right file?",
            ),
            Self::Truncated { have, need } => {
                write!(f, "the file is cut short ({have} of {need} bytes): copy it again, or {AGAIN}")
            }
            Self::TooLong { have, need } => {
                write!(
                    f,
                    "the file is too long ({have} bytes where {need} were written): copy it again, or {AGAIN}"
                )
            }
            Self::Checksum { stored, computed } => write!(
                f,
                "checksum mismatch: the file is damaged (stored {stored:08x}, computed {computed:08x}); {AGAIN}"
            ),
            Self::NewerVersion { found, supported } => write!(
                f,
                "the blob has layout version {found}, this program reads version {supported}: update the program, or {AGAIN}"
            ),
            Self::UnknownVersion { found } => {
                write!(f, "the blob has the unknown layout version {found}; {AGAIN}")
            }
            Self::Header => write!(f, "the header cannot be decoded; {AGAIN}"),
            Self::Capacity { what, space, need, limit } => {
                write!(
                    f,
                    "{need} {what} {} are more than this build holds ({limit}): pack fewer, or build with a larger profile",
                    Of(*space)
                )
            }
            Self::Value { what, space } => write!(f, "{what} {} is not a valid number; {AGAIN}", Of(*space)),
            Self::Lattice { space, error } => write!(f, "grid of space {space}: {error}; {AGAIN}"),
            Self::Plane { space: None, error } => write!(f, "surface, {error}; {AGAIN}"),
            Self::Plane { space: Some(space), error } => write!(f, "space {space}, {error}; {AGAIN}"),
        }
    }
}

impl core::error::Error for BlobError {}
