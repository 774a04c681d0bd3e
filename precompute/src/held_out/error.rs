//! Errors of held-out runs.

use thiserror::Error;

use crate::space::{ExecutorError, Kind, StoreError};

/// Why the run ended early.
#[derive(Debug, Error)]
pub enum HeldOutError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The workers failed.
    #[error(transparent)]
    Executor(#[from] ExecutorError),
    /// A stop was requested; every finished walk is committed.
    #[error("interrupted; every finished path is kept, run the same command to continue")]
    Interrupted,
    /// The steps are too long for the paths. Nothing was solved.
    #[error(
        "steps of {} mm are too long for {} {} mm; take --step-mm {} or less, or no such paths with {}",
        in_mm(*.step_m),
        if *.paths == Kind::Random { "random paths in a ball of radius" } else { "regular paths of" },
        in_mm(*.of_m),
        in_mm(*.limit_m),
        if *.paths == Kind::Random { "--random 0" } else { "--regular-mm 0" }
    )]
    LongStep {
        /// The paths, regular or random.
        paths: Kind,
        /// The step, m.
        step_m: f64,
        /// Length of the regular paths, or radius of the ball of the random ones, m.
        of_m: f64,
        /// Longest possible step, m.
        limit_m: f64,
    },
    /// Uniform positions need the complete space of this active node.
    #[error(
        "{0}: uniform positions start from the solved space, which is not complete; run `palpate precompute` first, \
         or ask for none with --uniform 0"
    )]
    NoSpace(String),
    /// Uniform positions need a reachable point besides rest in this active node's space.
    #[error(
        "{0}: nothing but the rest point is reachable, so there is no uniform position; raise the force limit or \
         take a finer grid, or ask for none with --uniform 0"
    )]
    NoReach(String),
}

/// A length in millimetres, rounded to a nanometre.
fn in_mm(length_m: f64) -> f64 {
    (1e9 * length_m).round() / 1e6
}

impl HeldOutError {
    /// Whether the caller's input caused the error.
    pub(crate) fn is_bad_input(&self) -> bool {
        match self {
            Self::Store(error) => !error.is_of_the_machine(),
            Self::Interrupted | Self::Executor(_) => false,
            Self::LongStep { .. } | Self::NoSpace(_) | Self::NoReach(_) => true,
        }
    }
}
