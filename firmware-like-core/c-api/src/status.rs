//! The status of a call, and the details of a refusal.

use core::ffi::{CStr, c_char};

use palpate_core::format::VERSION;
use palpate_core::{BlobError, ControllerError, PlaneProblem};

/// Result of a call. `PALPATE_STATUS_OK` is 0.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PalpateStatus {
    /// Success.
    Ok = 0,
    /// A required pointer is null or not aligned for its type.
    NullArgument = 1,
    /// The memory for an organ or a controller is null, too small, or not aligned to PALPATE_ALIGNMENT.
    Memory = 2,
    /// The organ has no space with this number.
    NoSuchSpace = 3,
    /// There is no method with this number.
    NoSuchMethod = 4,
    /// The blob has no table for the method: pack it with `--method`.
    MissingMethod = 5,
    /// The blob has no surface displacements.
    NoDisplacements = 6,
    /// A number of the configuration is not finite or not positive; `what` names it.
    Config = 7,
    /// Shorter than any blob.
    TooShort = 8,
    /// The blob does not start at an address divisible by 8.
    Misaligned = 9,
    /// The first bytes are not those of a blob.
    BadMagic = 10,
    /// The blob is shorter than the length it states (`have`, `need`).
    Truncated = 11,
    /// The blob is longer than the length it states (`have`, `need`).
    TooLong = 12,
    /// The bytes are not those that were written.
    Checksum = 13,
    /// The layout version (`need`) is newer than this library supports (`have`).
    NewerVersion = 14,
    /// The layout version (`have`) is older than any supported one.
    UnknownVersion = 15,
    /// The header cannot be decoded.
    Header = 16,
    /// The blob has more of `what` (`need`) than the capacity of this library (`have`).
    Capacity = 17,
    /// A number in the header is out of its range; `what` names it.
    Value = 18,
    /// The grid of a space is not valid.
    Lattice = 19,
    /// A plane of the blob is not valid; `what` names it.
    Plane = 20,
    /// The rest point of a space is not solved or not free of force.
    RestPoint = 21,
}

/// Longest `what` with its final zero, bytes.
pub const PALPATE_WHAT_LEN: usize = 32;

/// Why a call was refused.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PalpateProblem {
    /// The status that was returned.
    pub status: PalpateStatus,
    /// The space concerned, or -1.
    pub space: i32,
    /// The number found, or the largest number that fits.
    pub have: u64,
    /// The number needed.
    pub need: u64,
    /// Name of the field or plane concerned, a C string; empty if there is none.
    pub what: [c_char; PALPATE_WHAT_LEN],
}

impl PalpateProblem {
    /// A status without further details.
    pub(crate) const fn of(status: PalpateStatus) -> Self {
        Self { status, space: -1, have: 0, need: 0, what: [0; PALPATE_WHAT_LEN] }
    }

    const fn sizes(self, have: u64, need: u64) -> Self {
        Self { have, need, ..self }
    }

    fn space(self, space: Option<u16>) -> Self {
        Self { space: space.map_or(-1, i32::from), ..self }
    }

    fn what(mut self, what: &str) -> Self {
        // The last byte stays zero.
        let (_, text) = self.what.split_last_mut().unwrap_or((&mut 0, &mut []));
        for (to, byte) in text.iter_mut().zip(what.bytes()) {
            *to = byte as c_char;
        }
        self
    }
}

impl From<BlobError> for PalpateProblem {
    fn from(error: BlobError) -> Self {
        use PalpateStatus as Status;
        match error {
            BlobError::TooShort { have, need } => Self::of(Status::TooShort).sizes(have as u64, need as u64),
            BlobError::Misaligned => Self::of(Status::Misaligned),
            BlobError::BadMagic => Self::of(Status::BadMagic),
            BlobError::Truncated { have, need } => Self::of(Status::Truncated).sizes(have, need),
            BlobError::TooLong { have, need } => Self::of(Status::TooLong).sizes(have, need),
            BlobError::Checksum { stored, computed } => {
                Self::of(Status::Checksum).sizes(computed.into(), stored.into())
            }
            BlobError::NewerVersion { found } => {
                Self::of(Status::NewerVersion).sizes(VERSION.into(), found.into())
            }
            BlobError::UnknownVersion { found } => Self::of(Status::UnknownVersion).sizes(found.into(), 0),
            BlobError::Header => Self::of(Status::Header),
            BlobError::Capacity { what, space, need, limit } => {
                Self::of(Status::Capacity).sizes(limit as u64, need as u64).space(space).what(what)
            }
            BlobError::Value { what, space } => Self::of(Status::Value).space(space).what(what),
            BlobError::Lattice { space, .. } => Self::of(Status::Lattice).space(Some(space)).what("grid"),
            BlobError::Plane { space, error } => {
                let is_rest = error.problem == PlaneProblem::RestPoint;
                let status = if is_rest { Status::RestPoint } else { Status::Plane };
                Self::of(status).space(space).what(error.plane)
            }
        }
    }
}

impl From<ControllerError> for PalpateProblem {
    fn from(error: ControllerError) -> Self {
        match error {
            ControllerError::MissingMethod { method, space } => {
                Self::of(PalpateStatus::MissingMethod).space(Some(space)).what(method.name())
            }
            ControllerError::Config { what } => Self::of(PalpateStatus::Config).what(what),
        }
    }
}

/// One line for a log: the meaning of a status and the fix. Never null, not to be freed. Any number is
/// accepted.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_status_text(status: i32) -> *const c_char {
    text(status).as_ptr()
}

fn text(status: i32) -> &'static CStr {
    use PalpateStatus as Status;
    const TEXTS: [(PalpateStatus, &CStr); 22] = [
        (Status::Ok, c"done"),
        (Status::NullArgument, c"a pointer is null or not aligned for what it points to"),
        (
            Status::Memory,
            c"the memory is null, too small or not aligned: ask palpate_organ_size or palpate_controller_size, align to PALPATE_ALIGNMENT",
        ),
        (Status::NoSuchSpace, c"the organ has no space of this number: see palpate_organ_info"),
        (Status::NoSuchMethod, c"there is no method of this number: see PalpateMethod"),
        (Status::MissingMethod, c"the blob has no table for the method: pack it with `palpate pack --method`"),
        (Status::NoDisplacements, c"the blob holds no displacements: set `visual = true` in the scene and pack again"),
        (Status::Config, c"a number of the configuration must be finite and above zero"),
        (Status::TooShort, c"too short for an organ blob: is this the right file?"),
        (Status::Misaligned, c"the blob must start at an address divisible by 8"),
        (Status::BadMagic, c"not an organ blob: is this the right file?"),
        (Status::Truncated, c"the blob is cut short: copy it again"),
        (Status::TooLong, c"the blob is followed by other bytes: give its own length"),
        (Status::Checksum, c"checksum mismatch: the blob is damaged, copy it or pack it again"),
        (Status::NewerVersion, c"the blob was written by a newer version: update this library, or pack it again"),
        (Status::UnknownVersion, c"the blob has an unknown layout version: pack it again"),
        (Status::Header, c"the header cannot be decoded: pack it again"),
        (Status::Capacity, c"the blob has more than this library holds: pack less, or build with larger limits"),
        (Status::Value, c"a number in the header is not valid: pack it again"),
        (Status::Lattice, c"the grid of a space is not valid: pack it again"),
        (Status::Plane, c"a plane is not valid: pack it again"),
        (Status::RestPoint, c"the rest point of a space must be solved and without force: pack it again"),
    ];
    let found = TEXTS.iter().find(|(of, _)| *of as i32 == status);
    found.map_or(c"this number is not a status of this library", |(_, text)| text)
}
