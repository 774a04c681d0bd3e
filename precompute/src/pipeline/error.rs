//! Errors of the pipeline.

use std::path::PathBuf;

use crate::error::InputError;
use crate::held_out::HeldOutError;
use crate::num::parallel::ThreadError;
use crate::pack::PackError;
use crate::scene::BodyError;
use crate::space::{ExecutorError, ExpansionError, StoreError};

/// An error of a step of the pipeline. `Display` is one line with the file, the problem and the fix.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The scene, its mesh or a space does not suit the step.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The body of this scene cannot be built.
    #[error("{}: {}", .0.display(), .1)]
    Body(PathBuf, BodyError),
    /// The space cannot be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The configurations cannot be solved.
    #[error(transparent)]
    Expansion(#[from] ExpansionError),
    /// The held-out positions cannot be solved.
    #[error(transparent)]
    HeldOut(#[from] HeldOutError),
    /// The tables cannot be packed.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// The worker threads do not start.
    #[error(transparent)]
    Threads(#[from] ThreadError),
    /// The caller raised the stop flag.
    #[error("interrupted; the solved positions are kept, run the same command to continue")]
    Interrupted,
}

impl PipelineError {
    /// Whether the caller's input caused the error, and not the computation or the machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Input(_) => true,
            Self::Body(_, error) => !matches!(error, BodyError::NoRest(_)),
            Self::Store(error)
            | Self::Expansion(ExpansionError::Store(error))
            | Self::Pack(PackError::Store(error)) => !error.is_of_the_machine(),
            Self::Expansion(error) => matches!(error, ExpansionError::Rest(_)),
            Self::HeldOut(error) => error.is_bad_input(),
            Self::Pack(error) => !matches!(error, PackError::Threads(_)),
            Self::Threads(_) | Self::Interrupted => false,
        }
    }
}

impl From<ExecutorError> for PipelineError {
    fn from(error: ExecutorError) -> Self {
        Self::Expansion(error.into())
    }
}
