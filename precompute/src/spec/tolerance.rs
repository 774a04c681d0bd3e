//! Tolerance of the force error.

use crate::num::vector::norm;
use serde::{Deserialize, Serialize};

/// Tolerance of the force error: the larger of the relative and the absolute part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tolerance {
    /// Relative part, as a share of |h|.
    pub relative: f64,
    /// Absolute part, N.
    pub absolute_n: f64,
}

/// A share in per cent with at most three decimals.
pub(crate) fn percent_in_words(share: f64) -> String {
    let text = format!("{:.3}", 100.0 * share);
    text.trim_end_matches('0').trim_end_matches('.').into()
}

impl Tolerance {
    /// Half the just noticeable difference of force (7 %), and at least the detection threshold of a finger.
    pub const IMPERCEPTIBLE: Self = Self { relative: 0.035, absolute_n: 0.02 };

    /// Default tolerance of the error of the discretisation. It is the same at every touch, so a person could
    /// notice it only beside the other tissue: it may be as large as the just noticeable difference of force, 7
    /// to 10 %.
    pub const OF_MESH: Self = Self { relative: 0.08, absolute_n: 0.02 };

    /// Largest permitted error at the force `force_n`, N.
    pub fn at(&self, force_n: [f64; 3]) -> f64 {
        self.of_size(norm(force_n))
    }

    /// Largest permitted error at a force of this size, N.
    pub fn of_size(&self, size_n: f64) -> f64 {
        (self.relative * size_n).max(self.absolute_n)
    }
}
