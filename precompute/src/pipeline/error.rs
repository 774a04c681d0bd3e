//! Errors of the pipeline.

use std::path::PathBuf;

use palpate_core::BlobError;

use crate::certificate::LedgerError;
use crate::error::InputError;
use crate::held_out::HeldOutError;
use crate::num::parallel::ThreadError;
use crate::pack::PackError;
use crate::scene::BodyError;
use crate::space::{ExpansionError, StoreError};

/// An error of a step of the pipeline. `Display` is one line with the file, the problem and the fix.
#[derive(Debug)]
pub enum PipelineError {
    /// The scene or its mesh is invalid.
    Input(InputError),
    /// The body cannot be built.
    Body {
        /// The scene.
        path: PathBuf,
        /// Why.
        error: BodyError,
    },
    /// The scene has no grid.
    NoGrid {
        /// The scene.
        path: PathBuf,
    },
    /// The step needs a lattice, and the scene requests adaptive sampling.
    NotALattice {
        /// The scene.
        path: PathBuf,
    },
    /// No active node has this name.
    UnknownNode {
        /// The scene.
        path: PathBuf,
        /// The name.
        name: String,
        /// Names of the active nodes.
        known: Vec<String>,
    },
    /// The space was solved for a different scene than the one stored in it.
    OtherScene {
        /// The space.
        path: PathBuf,
    },
    /// An active node has unsolved positions.
    Unfinished(Unfinished),
    /// The space cannot be read or written.
    Store(StoreError),
    /// The configurations cannot be solved.
    Expansion(ExpansionError),
    /// The held-out positions cannot be solved.
    HeldOut(HeldOutError),
    /// The tables cannot be packed.
    Pack(PackError),
    /// The worker threads do not start.
    Threads(ThreadError),
    /// The core refuses the packed blob.
    Blob(BlobError),
    /// The certificate cannot be written as JSON.
    Certificate(serde_json::Error),
    /// The caller raised the stop flag.
    Interrupted,
}

/// An active node with unsolved positions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unfinished {
    /// The space.
    pub path: PathBuf,
    /// Name of the active node.
    pub active: String,
    /// Number of unsolved positions, a lower bound.
    pub open: usize,
}

impl std::fmt::Display for Unfinished {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { path, active, open } = self;
        write!(
            f,
            "{}: active node {active} is not finished: {open} points or more are still to be solved",
            path.display()
        )
    }
}

impl PipelineError {
    /// Whether the caller's input caused the error, and not the computation or the machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Body { error, .. } => !matches!(error, BodyError::NoRest(_)),
            Self::Store(error)
            | Self::Expansion(ExpansionError::Store(error))
            | Self::Pack(PackError::Store(error)) => !error.is_of_the_machine(),
            Self::Expansion(error) => matches!(error, ExpansionError::Rest(_)),
            Self::HeldOut(error) => error.is_bad_input(),
            Self::Threads(_)
            | Self::Pack(PackError::Threads(_))
            | Self::Blob(_)
            | Self::Certificate(_)
            | Self::Interrupted => false,
            _ => true,
        }
    }
}

impl std::fmt::Display for PipelineError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Input(error) => write!(f, "{error}"),
            Self::Body { path, error } => write!(f, "{}: {error}", path.display()),
            Self::NoGrid { path } => write!(f, "{}: no [grid]; add radius_m and spacing_m", path.display()),
            Self::NotALattice { path } => write!(
                f,
                "{}: this command needs a lattice; give [grid] a `spacing_m` instead of a tolerance",
                path.display()
            ),
            Self::UnknownNode { path, name, known } => {
                write!(f, "{}: no active node `{name}`; it has {}", path.display(), known.join(", "))
            }
            Self::OtherScene { path } => write!(
                f,
                "{}: the stored scene differs from the solved one; run `palpate precompute` again",
                path.display()
            ),
            Self::Unfinished(unfinished) => {
                write!(f, "{unfinished}; run `palpate precompute` again, or pack with --partial")
            }
            Self::Store(error) => write!(f, "{error}"),
            Self::Expansion(error) => write!(f, "{error}"),
            Self::HeldOut(error) => write!(f, "{error}"),
            Self::Pack(error) => write!(f, "{error}"),
            Self::Threads(error) => write!(f, "{error}"),
            Self::Blob(error) => write!(f, "the packed blob cannot be read back: {error}; please report it"),
            Self::Certificate(error) => write!(f, "the certificate cannot be written: {error}"),
            Self::Interrupted => {
                write!(f, "interrupted; the solved positions are kept, run the same command to continue")
            }
        }
    }
}

impl std::error::Error for PipelineError {}

impl From<LedgerError> for PipelineError {
    fn from(error: LedgerError) -> Self {
        match error {
            LedgerError::Store(error) => Self::Store(error),
            LedgerError::Threads(error) => Self::Threads(error),
        }
    }
}

macro_rules! from_errors {
    ($($variant:ident($error:ty)),* $(,)?) => { $(
        impl From<$error> for PipelineError {
            fn from(error: $error) -> Self {
                Self::$variant(error)
            }
        }
    )* };
}

from_errors!(
    Input(InputError),
    Store(StoreError),
    Expansion(ExpansionError),
    HeldOut(HeldOutError),
    Pack(PackError),
    Blob(BlobError),
    Certificate(serde_json::Error),
);
