//! Held-out truth: solved positions that no fit ever sees, to measure interpolations against (paper, 5.2 and 5.3).
//!
//! Three kinds: regular paths in 26 directions and random paths, as the paper has them, and independent uniform positions, which alone
//! carry a bound. [`positions`] draws them from a seed; [`crate::space::WalkJob`] solves a path, or a single position, in one go; [`run`] hands
//! the walks to a crew and keeps what comes back in the store of the space; [`summary`] counts.

pub mod positions;
pub mod run;
pub mod summary;

pub use positions::{Draw, is_on_training_lattice};
pub use run::{HeldOut, HeldOutError, HeldOutProgress};
pub use summary::Summary;
