//! Failures of a command: one line and an exit code.

use std::io::ErrorKind;
use std::path::Path;
use std::process::ExitCode;

use palpate_precompute::held_out::HeldOutError;
use palpate_precompute::identify::IdentifyError;
use palpate_precompute::pack::PackError;
use palpate_precompute::pipeline::PipelineError;
use palpate_precompute::plan::PlanError;
use palpate_precompute::space::{ExpansionError, StoreError};

/// A command's failure.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The input cannot be used: exit code 2.
    Input(anyhow::Error),
    /// The input is valid, but the work failed: exit code 1.
    Work(anyhow::Error),
}

impl Failure {
    /// Bad input, in one line that names the cause and the fix.
    pub(crate) fn input(message: impl std::fmt::Display) -> Self {
        Self::Input(anyhow::anyhow!("{message}"))
    }

    /// Failed work, in one line.
    pub(crate) fn work(message: impl std::fmt::Display) -> Self {
        Self::Work(anyhow::anyhow!("{message}"))
    }

    /// A file that cannot be read or written: bad input, or failed work if the disk is full.
    pub(crate) fn file(path: &Path, error: &std::io::Error) -> Self {
        if matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded) {
            let path = path.display();
            return Self::work(format!(
                "{path}: no space left on the disk ({error}); free some space and run the same command again"
            ));
        }
        if error.kind() == ErrorKind::IsADirectory {
            return Self::input(format!("{}: is a folder; give the name of a file", path.display()));
        }
        Self::input(format!("{}: {error}; check the name, the folder and its permissions", path.display()))
    }

    /// The message on one line: causes appended, line breaks replaced.
    pub(crate) fn line(&self) -> String {
        let (Self::Input(error) | Self::Work(error)) = self;
        format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ")
    }

    /// The same failure with an addition to its message.
    pub(crate) fn with(self, more: &str) -> Self {
        match self {
            Self::Input(error) => Self::Input(anyhow::anyhow!("{error:#}{more}")),
            Self::Work(error) => Self::Work(anyhow::anyhow!("{error:#}{more}")),
        }
    }

    /// 2 for bad input, 1 for failed work.
    pub(crate) fn exit_code(&self) -> ExitCode {
        match self {
            Self::Input(_) => ExitCode::from(2),
            Self::Work(_) => ExitCode::from(1),
        }
    }
}

macro_rules! of_pipeline {
    ($($error:ty),* $(,)?) => { $(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                let error = PipelineError::from(error);
                if error.is_bad_input() { Self::input(error) } else { Self::work(error) }
            }
        }
    )* };
}

of_pipeline!(
    ExpansionError,
    HeldOutError,
    PipelineError,
    PackError,
    StoreError,
    palpate_precompute::InputError,
);

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Self {
        if error.is_bad_input() { Self::input(error) } else { Self::work(error) }
    }
}

impl From<IdentifyError> for Failure {
    fn from(error: IdentifyError) -> Self {
        if error.is_bad_input() { Self::input(error) } else { Self::work(error) }
    }
}

impl From<palpate_precompute::mesh::MeshFault> for Failure {
    fn from(error: palpate_precompute::mesh::MeshFault) -> Self {
        Self::input(error)
    }
}
