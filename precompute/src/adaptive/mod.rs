//! Adaptive sampling with as few solves as the tolerance needs. Each solve tests the fit before it is added
//! to it.
//!
//! [`Search`] chooses the next positions and decides when to stop, as a pure function of the solved
//! configurations. The error criterion is [`crate::spec::Tolerance`], the fit [`crate::fit::KernelFit`].

mod branch;
mod fitted;
mod linear;
mod local;
mod prediction;
mod reach;
mod resample;
mod search;
mod stagnation;

pub(crate) use branch::on_one_branch;
pub(crate) use fitted::MOST_DATA;
pub use fitted::{AdaptiveFit, LeaveOneOutErrors, Shared};
pub use linear::LinearModelErrors;
pub use prediction::{STREAK, Test, Verdict};
pub use resample::{Resampled, resample};
pub(crate) use search::{MAX_FORCE_FACTOR, Step};
pub use search::{Search, SolveResult, Target};
