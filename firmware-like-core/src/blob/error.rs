//! Why a blob was refused, with the numbers that explain it and the mend.

use core::fmt;

use crate::grid::LatticeError;
use crate::rbf::RbfError;
use crate::table::TableError;

/// What is wrong with one plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaneProblem {
    /// It reaches beyond the plane area.
    OutOfBounds {
        /// Byte offset in the plane area.
        offset: u32,
        /// Elements.
        len: u32,
    },
    /// Its offset is not a multiple of 64.
    Misaligned {
        /// Byte offset in the plane area.
        offset: u32,
    },
    /// Its length or one of its values.
    Table(TableError),
    /// The same for the six planes of an RBF table.
    Rbf(RbfError),
    /// A slot whose flags contradict each other.
    Flags {
        /// The slot.
        slot: usize,
    },
}

impl From<TableError> for PlaneProblem {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
}

impl From<RbfError> for PlaneProblem {
    fn from(error: RbfError) -> Self {
        Self::Rbf(error)
    }
}

impl fmt::Display for PlaneProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfBounds { offset, len } => {
                write!(f, "{len} elements at byte {offset} reach out of the file")
            }
            Self::Misaligned { offset } => write!(f, "byte {offset} is not a multiple of 64"),
            Self::Table(error) => error.fmt(f),
            Self::Rbf(error) => error.fmt(f),
            Self::Flags { slot } => write!(f, "the flags of slot {slot} contradict its neighbours"),
        }
    }
}

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
    /// Not a blob at all.
    BadMagic,
    /// The file ends before its own length.
    Truncated {
        /// Bytes given.
        have: u64,
        /// Bytes announced.
        need: u64,
    },
    /// The file goes on after its own length.
    TooLong {
        /// Bytes given.
        have: u64,
        /// Bytes announced.
        need: u64,
    },
    /// The bytes are not those that were written.
    Checksum {
        /// Checksum in the file.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// Written by a newer version.
    NewerVersion {
        /// Version of the file.
        found: u32,
        /// Newest version this reader knows.
        supported: u32,
    },
    /// A version that never was.
    UnknownVersion {
        /// Version of the file.
        found: u32,
    },
    /// The header cannot be decoded.
    Header,
    /// More of something than this build of the core holds.
    Capacity {
        /// Of what.
        what: &'static str,
        /// Its space, or `None` for the organ.
        space: Option<u16>,
        /// How many the blob has.
        need: usize,
        /// How many fit.
        limit: usize,
    },
    /// A number in the header is not what it must be.
    Value {
        /// The field.
        what: &'static str,
        /// Its space, or `None` for the organ.
        space: Option<u16>,
    },
    /// The grid of a space.
    Lattice {
        /// The space.
        space: u16,
        /// What is wrong with it.
        error: LatticeError,
    },
    /// A plane of the surface or of a space.
    Plane {
        /// The plane.
        what: &'static str,
        /// Its space, or `None` for the surface.
        space: Option<u16>,
        /// What is wrong with it.
        problem: PlaneProblem,
    },
    /// The rest point of a space is not solved, or its force is not zero.
    RestPoint {
        /// The space.
        space: u16,
    },
}

/// Where in the blob, for messages.
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
                write!(f, "{have} bytes are no organ blob (the smallest has {need}): is this the right file?")
            }
            Self::Misaligned => f.write_str(
                "the buffer must start at an address divisible by 8: load it into an array of u64",
            ),
            Self::BadMagic => {
                f.write_str("this is no organ blob (it does not start with PALPATE): is this the right file?")
            }
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
                "the blob has layout version {found}, this program reads up to {supported}: update the program, or {AGAIN}"
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
            Self::Plane { what, space, problem } => {
                write!(f, "plane {what} {}: {problem}; {AGAIN}", Of(*space))
            }
            Self::RestPoint { space } => {
                write!(f, "the rest point of space {space} must be solved and without force; {AGAIN}")
            }
        }
    }
}

impl core::error::Error for BlobError {}
