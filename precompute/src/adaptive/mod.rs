//! Adaptive sampling with as few solves as the tolerance needs. Each solve tests the fit before it is added
//! to it.
//!
//! [`Search`] chooses the next positions and decides when to stop, as a pure function of the solved
//! configurations. The error criterion is [`crate::spec::Tolerance`], the fit [`crate::fit::KernelFit`].

mod alone;
mod fitted;
mod linear;
mod prediction;
mod reach;
mod resample;
mod search;
mod stagnation;

pub use alone::{Alone, alone};
pub(crate) use fitted::WithinReach;
pub use fitted::{AdaptiveFit, LeftOut};
pub use linear::LinearSuits;
pub use prediction::{PASSES, Test, Verdict};
pub use resample::{Resampled, resample};
pub use search::Target;
pub use search::{Found, Search, Step};
