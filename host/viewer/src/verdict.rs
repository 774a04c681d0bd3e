//! The certificate's verdict on a place, in a word.

use super::palette::{BAD, GOOD, MUTED, WAITING};

/// Numerical health of the space of an active node or contact point, as its certificate states it; the more
/// severe is the greater.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No reason to distrust it.
    Green,
    /// Usable after a review of the reasons.
    Yellow,
    /// Not measured.
    Unknown,
    /// Not usable as it is.
    Red,
}

impl Verdict {
    /// The word in the picture.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Green => "GREEN",
            Self::Yellow => "YELLOW",
            Self::Unknown => "UNKNOWN",
            Self::Red => "RED",
        }
    }

    /// The colour of the word.
    pub(super) const fn colour(self) -> u32 {
        match self {
            Self::Green => GOOD,
            Self::Yellow => WAITING,
            Self::Unknown => MUTED,
            Self::Red => BAD,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_severe_is_the_greatest() {
        let all = [Verdict::Red, Verdict::Green, Verdict::Unknown, Verdict::Yellow];
        let mut sorted = all;
        sorted.sort();
        assert_eq!(sorted.map(Verdict::word), ["GREEN", "YELLOW", "UNKNOWN", "RED"]);
        assert!(all.iter().all(|one| all.iter().filter(|other| other.colour() == one.colour()).count() == 1));
    }
}
