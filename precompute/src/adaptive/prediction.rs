//! Predictions of a search compared with their solutions, and the result of a search.

use serde::{Deserialize, Serialize};

use crate::spec::GridIndex;

/// Length of the validation streak.
pub const STREAK: usize = 10;

/// A prediction compared with the solution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Test {
    /// Position in units of `spec::UNIT_M`.
    pub index: GridIndex,
    /// Absolute error of the force, N.
    pub error_n: f64,
    /// Tolerance of the force at this position, N.
    pub tolerance_n: f64,
    /// Whether the prediction counts: |h| is not far beyond the force limit.
    pub counts: bool,
}

/// Result of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verdict {
    /// All predictions of the linear model, at least ten, are within tolerance: the linear model suffices.
    Linear,
    /// The stopping criterion of the module's doc comment is met.
    Passed,
    /// The errors stagnate above the tolerance: the energy has a branch jump, and a lattice replaces the
    /// search.
    Stagnated,
    /// The maximum number of configurations is reached, and the stopping criterion is not met.
    NotReached,
    /// The largest force moves the node by less than the smallest radius of a space, even in its softest
    /// direction. Nothing is solved.
    TooStiff,
}

impl Verdict {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Passed => "passed",
            Self::Stagnated => "stalled",
            Self::NotReached => "not reached",
            Self::TooStiff => "too stiff",
        }
    }
}
