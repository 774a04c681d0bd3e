//! Why a space could not be packed.

use palpate_core::{BlobError, LatticeError};
use thiserror::Error;

use crate::fit::FitError;
use crate::num::parallel::ThreadError;
use crate::space::StoreError;
use crate::spec::GridIndex;

/// Why a space could not be packed.
#[derive(Debug, Error)]
pub enum PackError {
    /// The store could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A fit failed.
    #[error("active node {active}: {error}")]
    Fit {
        /// Name of the active node.
        active: String,
        /// The error.
        error: FitError,
    },
    /// The table of a sphere is of the root of the energy.
    #[error("the field of a sphere has the method energy alone; ask for `--methods energy`")]
    OnlyEnergy,
    /// The displacements have no modes.
    #[error(
        "active node {0}: its displacements have no modes; look for damaged configurations with `palpate inspect`"
    )]
    Modes(String),
    /// The displacements of a configuration exceed the bound.
    #[error(
        "active node {active}: the displacement at grid point {index:?} is not packed closer than {:.4} mm rms, \
         {:.4} mm at a node; allow more with displacement_rms_mm and displacement_max_mm under [needs]",
        1e3 * .rms_m,
        1e3 * .max_m
    )]
    Displacement {
        /// Name of the active node.
        active: String,
        /// The configuration.
        index: GridIndex,
        /// Its root mean square misfit over the nodes, m.
        rms_m: f64,
        /// Its largest misfit at a node, m.
        max_m: f64,
    },
    /// The core refuses the blob: a force or a length is not finite or out of range.
    #[error(
        "the blob could not be read ({}) and is not written; check the units of the material, of the mesh and of \
         `max_force_n`",
        without_advice(.0)
    )]
    Refused(BlobError),
    /// The lattice of an adaptive space is invalid for the core.
    #[error("active node {active}: {error}; change `radius_m`")]
    Lattice {
        /// Name of the active node.
        active: String,
        /// The error.
        error: LatticeError,
    },
    /// A node has no kernel.
    #[error(
        "active node {active} has no kernel to pack: it was sampled on a lattice, or a lattice replaced its adaptive \
         sampling at a branch jump; pack `energy`"
    )]
    NoKernel {
        /// Its name.
        active: String,
    },
    /// The threads could not be started.
    #[error(transparent)]
    Threads(#[from] ThreadError),
    /// No space contains a configuration yet.
    #[error(
        "no configuration of the space is solved; finish `palpate precompute`, and if all its solves failed, check the material"
    )]
    Empty,
    /// A part exceeds the limits of the layout.
    #[error("{0} is too large for a blob; shorten it or pack fewer methods")]
    TooLarge(&'static str),
}

/// The reader's message without its advice, which applies to files only.
fn without_advice(error: &BlobError) -> String {
    let why = error.to_string();
    why.rsplit_once("; ").map_or(why.clone(), |(why, _)| why.into())
}
