//! What to solve next.

/// Why a position is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// The hand is there.
    Hand,
    /// The hand is there, and a new factor is wanted.
    Renewal,
    /// The hand may come there. A fold that lies ahead must not end the branch that the hand is on.
    Ahead,
    /// A fold with this number is enclosed,
    Bisection(usize),
    /// or the body lands behind it.
    Landing(usize),
}

impl Aim {
    /// Whether the hand is at the position.
    pub(super) fn is_at_hand(self) -> bool {
        matches!(self, Self::Hand | Self::Renewal)
    }
}

/// What to solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Task {
    pub(super) contact: u16,
    pub(super) control_m: [f64; 3],
    pub(super) aim: Aim,
}
