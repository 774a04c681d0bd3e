//! A space from as few solves as its error needs: scattered configurations, each a test of the fit before it is part of it.
//!
//! [`Search`] decides where to solve next and when it is enough, a pure function of what was solved; [`Tolerance`] says what counts as
//! enough; the fit is [`crate::fit::KernelFit`]. Where the space folds the search stalls, and a lattice takes over ([`Switched`]). [`ScatteredPlan`] makes of it tasks like those of a lattice: scattered positions are points of
//! a lattice of a micrometre, so that whoever solves, stores and resumes need not know the difference.

mod alone;
mod linear;
mod plan;
mod reach;
mod resample;
mod search;
mod stall;
mod switched;

pub use alone::{Alone, alone, at_rest};
pub use linear::LinearSuits;
pub use plan::{ScatteredPlan, planned};
pub use resample::{Resampled, resample};
pub use search::{Found, LeftOut, PASSES, Search, Step, Target, Test, Verdict, Wanted, WithinReach};
pub use switched::Switched;

use serde::{Deserialize, Serialize};

use crate::configuration_space::GridIndex;

/// What scattered positions are counted in, m: far below what anybody resolves.
pub const UNIT_M: f64 = 1e-6;

/// Displacement of a point, m.
pub fn displacement_m(index: GridIndex) -> [f64; 3] {
    index.map(|n| f64::from(n) * UNIT_M)
}

/// The point nearest to a displacement.
fn nearest_index(displacement_m: [f64; 3]) -> GridIndex {
    displacement_m.map(|x| (x / UNIT_M).round() as i32)
}

/// What an error may be: beside the larger of the two it is within tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tolerance {
    /// Share of |h|.
    pub relative: f64,
    /// N.
    pub absolute_n: f64,
}

impl Tolerance {
    /// Half the just noticeable difference of force, 7 % of it, and never less than what a finger tells from nothing.
    pub const CANNOT_BE_FELT: Self = Self { relative: 0.035, absolute_n: 0.02 };

    /// What an error may be where the force is `force_n`, N.
    pub fn at(&self, force_n: [f64; 3]) -> f64 {
        (self.relative * norm(force_n)).max(self.absolute_n)
    }
}

fn norm(a: [f64; 3]) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}
