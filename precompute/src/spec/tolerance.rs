//! How large an error of the force may be.

use crate::num::vector::norm;
use serde::{Deserialize, Serialize};

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
