//! How far the packed displacements may be from the solver's.

use serde::{Deserialize, Serialize};

/// How far the packed displacements of a configuration may be from the solver's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DisplacementBound {
    /// Root mean square over the surface nodes, m.
    pub rms_m: f64,
    /// At any of them, m.
    pub max_m: f64,
}

impl Default for DisplacementBound {
    fn default() -> Self {
        Self { rms_m: 1e-4, max_m: 1e-3 }
    }
}

impl DisplacementBound {
    /// The smallest bound there is, m: the step of an outlier's int16 is 3 um where it moves by 0.1 m.
    pub const LEAST_M: f64 = 1e-5;

    /// What is left of it for the points of a fit's table, for its modes and slopes alike: its cells are as wide as the energy allows, and what
    /// lies between the points errs too.
    #[must_use]
    pub fn at_points_of_a_fit(self) -> Self {
        const SHARE: f64 = 0.7;
        let of = |bound_m: f64| (SHARE * bound_m).max(Self::LEAST_M);
        Self { rms_m: of(self.rms_m), max_m: of(self.max_m) }
    }
}
