//! Held-out reference solutions: solved positions that no fit uses, for the measurement of interpolation
//! errors (paper, 5.2 and 5.3).
//!
//! There are three kinds: regular paths in 26 directions and random paths, as in the paper, and independent
//! uniform positions. Bounds come from the uniform positions alone. `positions` draws them from a seed, and
//! `places` draws where on the skin between contact points a uniform position is.
//! [`crate::space::WalkJob`] solves a path or a single position in one job. `run` sends the walks to an
//! executor and stores the outcomes in the store of the space. `summary` counts them.

mod error;
mod places;
mod positions;
mod run;
mod summary;

pub use error::HeldOutError;
pub use places::{Place, Places};
pub use positions::{Draw, is_on_training_lattice, regular_directions};
pub use run::{HeldOut, HeldOutProgress};
pub use summary::Summary;
