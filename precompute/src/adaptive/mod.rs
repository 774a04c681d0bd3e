//! Adaptive sampling: as few solves as the error needs, each a test of the fit before it is part of it.
//!
//! [`Search`] decides where to solve next and when it is enough, a pure function of what was solved; [`crate::spec::Tolerance`]
//! says what counts as enough; the fit is [`crate::fit::KernelFit`].

mod alone;
mod fitted;
mod linear;
mod reach;
mod resample;
mod search;
mod stagnation;

pub use alone::{Alone, alone, at_rest};
pub use fitted::{AdaptiveFit, LeftOut, WithinReach};
pub use linear::LinearSuits;
pub use resample::{Resampled, resample};
pub use search::{Found, PASSES, Search, Step, Target, Test, Verdict};
