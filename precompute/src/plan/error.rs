//! Errors of a plan.

use std::path::PathBuf;

use palpate_core::LatticeError;

use crate::num::parallel::ThreadError;
use crate::pipeline::PipelineError;
use crate::space::ExpansionError;

/// Why a scene cannot be planned.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The scene does not suit a plan.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The body of this scene cannot be solved at rest.
    #[error("{}: {}", .0.display(), .1)]
    Rest(PathBuf, ExpansionError),
    /// The largest force can move no active node of this scene; the text names the first.
    #[error("{}: {}", .0.display(), .1)]
    TooStiff(PathBuf, String),
    /// All probes of this scene failed; their number.
    #[error(
        "{}: all {} probes failed; check the constants and units of the material, or take a smaller radius_m",
        .0.display(),
        .1
    )]
    ProbesFailed(PathBuf, usize),
    /// The probes of a node have no fit.
    #[error(
        "the probing solves failed or coincide; use a larger radius_m or check the scene with `palpate path`"
    )]
    NoFit,
    /// The fit of a node has no lattice.
    #[error(transparent)]
    Lattice(#[from] LatticeError),
    /// The worker threads do not start.
    #[error(transparent)]
    Threads(#[from] ThreadError),
}

impl PlanError {
    /// Whether the caller's input caused the error, and not the computation or the machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Pipeline(error) => error.is_bad_input(),
            Self::Rest(..) | Self::TooStiff(..) => true,
            Self::ProbesFailed(..) | Self::NoFit | Self::Lattice(_) | Self::Threads(_) => false,
        }
    }
}
