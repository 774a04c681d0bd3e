//! The error bound of the packed displacements.

use serde::{Deserialize, Serialize};

/// Largest difference between the packed displacements of a configuration and the solver's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DisplacementBound {
    /// Root mean square over the surface nodes, m.
    pub rms_m: f64,
    /// Maximum over the surface nodes, m.
    pub max_m: f64,
}

impl Default for DisplacementBound {
    fn default() -> Self {
        Self { rms_m: 1e-4, max_m: 1e-3 }
    }
}

impl DisplacementBound {
    /// The smallest bound, m. The int16 of an outlier has a step of 3 um if the node moves by 0.1 m.
    pub(crate) const MIN_M: f64 = 1e-5;

    /// Part of the bound for the points of a fit's table, shared by the modes and the slopes. The rest covers
    /// the interpolation error between the points, because the cells are as large as the energy allows.
    #[must_use]
    pub(crate) fn at_points_of_a_fit(self) -> Self {
        const SHARE: f64 = 0.7;
        let of = |bound_m: f64| (SHARE * bound_m).max(Self::MIN_M);
        Self { rms_m: of(self.rms_m), max_m: of(self.max_m) }
    }
}
