//! Why a space could not be packed.

use palpate_core::{BlobError, LatticeError};

use crate::fit::{FitError, Misfit};
use crate::num::parallel::ThreadError;
use crate::space::StoreError;
use crate::spec::GridIndex;

/// Why a space could not be packed.
#[derive(Debug)]
pub enum PackError {
    /// The store could not be read.
    Store(StoreError),
    /// A fit failed.
    Fit {
        /// Name of the active node.
        active: String,
        /// The error.
        error: FitError,
    },
    /// The displacements could not be packed.
    Displacement {
        /// Name of the active node.
        active: String,
        /// The configuration beyond the bound and its misfit; `None` if there are no modes.
        beyond: Option<(GridIndex, Misfit)>,
    },
    /// The core refuses the blob: a force or a length is not finite or out of range.
    Refused(BlobError),
    /// The lattice of an adaptive space is invalid for the core.
    Lattice {
        /// Name of the active node.
        active: String,
        /// The error.
        error: LatticeError,
    },
    /// A node has no kernel.
    NoKernel {
        /// Its name.
        active: String,
    },
    /// The threads could not be started.
    Threads(ThreadError),
    /// No space contains a configuration yet.
    Empty,
    /// A part exceeds the limits of the layout.
    TooLarge(&'static str),
}

impl std::fmt::Display for PackError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Store(error) => write!(f, "{error}"),
            Self::Fit { active, error } => write!(f, "active node {active}: {error}"),
            Self::Displacement { active, beyond: Some((index, misfit)) } => write!(
                f,
                "active node {active}: the displacement at grid point {index:?} is not packed closer than {:.4} mm rms, \
                 {:.4} mm at a node; allow more with displacement_rms_mm and displacement_max_mm under [needs]",
                1e3 * misfit.rms_m,
                1e3 * misfit.max_m
            ),
            Self::Displacement { active, beyond: None } => write!(
                f,
                "active node {active}: its displacements have no modes; look for damaged configurations with `palpate inspect`"
            ),
            Self::Refused(error) => {
                // The advice in the reader's message applies to files only.
                let why = error.to_string();
                let why = why.rsplit_once("; ").map_or(&why[..], |(why, _)| why);
                write!(
                    f,
                    "the blob could not be read ({why}) and is not written; check the units of the material, of the mesh and of \
                     `max_force_n`"
                )
            }
            Self::Lattice { active, error } => write!(f, "active node {active}: {error}; change `radius_m`"),
            Self::NoKernel { active } => write!(
                f,
                "active node {active} has no kernel to pack: it was sampled on a lattice, or a lattice replaced its adaptive sampling at a branch jump; pack `energy`"
            ),
            Self::Threads(error) => write!(f, "{error}"),
            Self::Empty => write!(f, "the store has no solved configuration; run `palpate precompute` first"),
            Self::TooLarge(what) => {
                write!(f, "{what} is too large for a blob; shorten it or pack fewer methods")
            }
        }
    }
}

impl std::error::Error for PackError {}

impl From<StoreError> for PackError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}
