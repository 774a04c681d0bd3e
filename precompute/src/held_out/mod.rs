//! Held-out truth: solved positions that no fit ever sees, to measure interpolations against (paper, 5.2 and 5.3).
//!
//! Three kinds: regular paths in 26 directions and random paths, as the paper has them, and independent uniform positions, which alone
//! carry a bound. [`positions`] draws them from a seed; [`walk`] solves a path, or a single position, in one go; [`run`] hands
//! the walks to a crew and keeps what comes back in the store of the space; [`summary`] counts.

pub mod positions;
pub mod run;
pub mod summary;
pub mod walk;

pub use positions::{Draw, is_on_training_lattice};
pub use run::{HeldOut, HeldOutError, HeldOutProgress};
pub use summary::Summary;
pub use walk::{Truth, Walk, WalkJob, WalkOutcome};

/// Which kind of held-out truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
pub enum Kind {
    /// One of the 26 straight paths towards the neighbours of a lattice point.
    Regular,
    /// A path of small steps whose direction turns slowly.
    Random,
    /// A position drawn uniformly from the ball, solved from the nearest solved corner of its cell.
    Uniform,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Regular, Self::Random, Self::Uniform];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Regular => "regular",
            Self::Random => "random",
            Self::Uniform => "uniform",
        }
    }

    /// The kind of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}
