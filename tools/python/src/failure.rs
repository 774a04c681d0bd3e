//! Failures as exceptions with the one line of the command line.
//!
//! Bad input is `palpate.InputError` (a `ValueError`), work that failed is `palpate.SolveError` (a
//! `RuntimeError`): the exit codes 2 and 1 of the command line.

use std::fmt::Display;
use std::path::Path;

use palpate_precompute::InputError;
use palpate_precompute::pipeline::PipelineError;
use palpate_precompute::space::StoreError;
use pyo3::prelude::*;
use pyo3::types::PyType;

/// A failure of a call.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The input cannot be used.
    Input(String),
    /// The input is valid, but the work failed.
    Work(String),
    /// The exception of a callback, or `KeyboardInterrupt`.
    Raised(PyErr),
}

impl Failure {
    /// Bad input, in one line that names the cause and the fix.
    pub(crate) fn input(line: impl Display) -> Self {
        Self::Input(line.to_string())
    }

    /// Failed work, in one line.
    pub(crate) fn work(line: impl Display) -> Self {
        Self::Work(line.to_string())
    }

    /// A file that cannot be read or written.
    pub(crate) fn file(path: &Path, error: &std::io::Error) -> Self {
        Self::input(format!("{}: {error}; check the name, the folder and its permissions", path.display()))
    }
}

impl From<PipelineError> for Failure {
    fn from(error: PipelineError) -> Self {
        if error.is_bad_input() { Self::input(error) } else { Self::work(error) }
    }
}

impl From<InputError> for Failure {
    fn from(error: InputError) -> Self {
        Self::input(error)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        PipelineError::from(error).into()
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        let (class, line) = match failure {
            Failure::Raised(error) => return error,
            Failure::Input(line) => ("InputError", line),
            Failure::Work(line) => ("SolveError", line),
        };
        let line = line.split_whitespace().collect::<Vec<_>>().join(" ");
        Python::attach(|py| {
            let found = py.import("palpate._errors").and_then(|module| module.getattr(class));
            match found.and_then(|class| Ok(class.cast_into::<PyType>()?)) {
                Ok(class) => PyErr::from_type(class, line),
                Err(error) => error,
            }
        })
    }
}
