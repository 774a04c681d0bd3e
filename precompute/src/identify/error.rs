//! The error of an identification.

use crate::error::InputError;
use crate::fem::SolveFailure;
use crate::pipeline::PipelineError;

/// Why constants cannot be identified. `Display` is one line with the fix.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// Scene or table are not suited.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A measured place has no equilibrium with the present values.
    #[error(
        "the place of line {line} has no equilibrium ({failure}); begin with stiffer constants, leave out the deepest rows, \
         or refine the mesh"
    )]
    Unsolved {
        /// Line of the table.
        line: usize,
        /// The solver's failure.
        failure: SolveFailure,
    },
    /// The forces do not depend on a constant, or only on a combination with others.
    #[error("the forces do not tell `{0}`; leave it out of the free constants, or measure where it matters")]
    Undetermined(String),
    /// The fit ends before it converges.
    #[error(
        "the fit has not converged after {evaluations} evaluations (RMS residual {:.1} % of the forces); begin nearer to the \
         solution, bound the constants, or free fewer",
        100.0 * rms_share
    )]
    NotConverged {
        /// Evaluations of the forward problem.
        evaluations: usize,
        /// RMS residual over the RMS force.
        rms_share: f64,
    },
    /// The caller raised the stop flag.
    #[error("interrupted; nothing is written")]
    Interrupted,
}

impl From<InputError> for IdentifyError {
    fn from(error: InputError) -> Self {
        Self::Pipeline(error.into())
    }
}

impl IdentifyError {
    /// Whether the input caused the error, and not the computation.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Pipeline(error) => error.is_bad_input(),
            Self::Undetermined(_) => true,
            Self::Unsolved { .. } | Self::NotConverged { .. } | Self::Interrupted => false,
        }
    }

    /// Whether other values of the constants may be possible.
    pub(super) fn is_of_the_values(&self) -> bool {
        matches!(self, Self::Unsolved { .. } | Self::Pipeline(PipelineError::Input(_)))
    }
}
