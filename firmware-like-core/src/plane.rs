//! Checks of planes, the arrays of a blob: one error type, whatever table a plane belongs to.

/// Largest absolute value that a force or a position may have, newtons or metres: far beyond any organ, and
/// small enough that no interpolation of such values overflows.
pub(crate) const LARGEST_VALUE: f32 = 1e9;

/// Why a plane was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{plane}: {problem}")]
pub struct PlaneError {
    /// Name of the plane.
    pub plane: &'static str,
    /// What is wrong with it.
    pub problem: PlaneProblem,
}

/// What is wrong with a plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PlaneProblem {
    /// It extends beyond the plane area of the blob.
    #[error("{len} elements at byte {offset} extend beyond the file")]
    OutOfBounds {
        /// Byte offset in the plane area.
        offset: u32,
        /// Number of elements.
        len: u32,
    },
    /// Its offset is not a multiple of 64.
    #[error("byte {offset} is not a multiple of 64")]
    Misaligned {
        /// Byte offset in the plane area.
        offset: u32,
    },
    /// It has another length than the grid, the surface or the other planes of its table require.
    #[error("{have} elements where {need} are needed")]
    Length {
        /// Elements found.
        have: usize,
        /// Elements needed.
        need: usize,
    },
    /// A value is NaN, infinite or so large that its interpolation could overflow, or a scale is negative.
    #[error("element {index} is NaN, infinite, too large or a negative scale")]
    Value {
        /// Element of the plane.
        index: usize,
    },
    /// An index refers to an element that does not exist, or a code has no meaning.
    #[error("element {index} is out of range")]
    OutOfRange {
        /// Element of the plane.
        index: usize,
    },
    /// An index is not larger than its predecessor.
    #[error("element {index} is not larger than its predecessor")]
    Order {
        /// Element of the plane.
        index: usize,
    },
    /// The flags of a slot contradict those of its neighbours.
    #[error("the flags of slot {slot} contradict its neighbours")]
    Flags {
        /// The slot.
        slot: usize,
    },
    /// The rest point is not solved, or its energy or force is not zero.
    #[error("the rest point must be solved and free of force")]
    RestPoint,
}

impl PlaneProblem {
    /// The problem as the error of a plane.
    pub(crate) const fn of(self, plane: &'static str) -> PlaneError {
        PlaneError { plane, problem: self }
    }
}

/// Checks the number of elements.
pub(crate) fn check_len<T>(name: &'static str, plane: &[T], need: usize) -> Result<(), PlaneError> {
    let have = plane.len();
    if have == need { Ok(()) } else { Err(PlaneProblem::Length { have, need }.of(name)) }
}

/// Checks that every element satisfies a condition.
pub(crate) fn check_values<T>(
    name: &'static str,
    plane: &[T],
    is_sound: impl Fn(&T) -> bool,
) -> Result<(), PlaneError> {
    match plane.iter().position(|value| !is_sound(value)) {
        None => Ok(()),
        Some(index) => Err(PlaneProblem::Value { index }.of(name)),
    }
}

/// Checks that no value is NaN or larger than [`LARGEST_VALUE`].
pub(crate) fn check_finite(name: &'static str, plane: &[f32]) -> Result<(), PlaneError> {
    // NaN fails the comparison.
    check_values(name, plane, |value| value.abs() <= LARGEST_VALUE)
}

/// Checks that every index or code is in its range.
pub(crate) fn check_range<T>(
    name: &'static str,
    plane: &[T],
    is_in_range: impl Fn(&T) -> bool,
) -> Result<(), PlaneError> {
    match plane.iter().position(|index| !is_in_range(index)) {
        None => Ok(()),
        Some(index) => Err(PlaneProblem::OutOfRange { index }.of(name)),
    }
}
