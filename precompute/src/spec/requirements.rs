//! Requirements of adaptive sampling.

use serde::{Deserialize, Serialize};

use super::tolerance::Tolerance;
use super::workspace::{Workspace, is_within};
use crate::num::vector::norm;

/// Largest ratio of pull to |h| at which a lattice still continues from a configuration.
const MAX_PULL_SHARE: f64 = 0.25;

/// Requirements of the sampling of one space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Requirements {
    /// Tolerance of the force error.
    pub tolerance: Tolerance,
    /// Largest displacement r_G, m.
    pub radius_m: f64,
    /// Largest |h|, N.
    pub max_force_n: f64,
    /// Outward normal if the tool only pushes; positions where h points along it are then not sampled.
    pub push: Option<[f64; 3]>,
    /// The device's workspace as displacements, m; `None` if the ball lies within it.
    pub workspace_m: Option<Workspace>,
    /// Maximum number of configurations.
    pub max_configurations: usize,
}

impl Requirements {
    /// Whether pushing or the workspace limits the tool in addition to radius and force.
    pub(crate) fn is_kept_in(&self) -> bool {
        self.push.is_some() || self.workspace_m.is_some()
    }

    /// Whether a lattice continues from a configuration, that is, whether its neighbours are solved. It
    /// continues in the workspace and, if the tool only pushes, up to a small pull. The margin gives the
    /// cells at the boundary of the reachable set all their corners.
    pub(crate) fn lattice_goes_on_from(&self, displacement_m: [f64; 3], force_n: [f64; 3]) -> bool {
        let inside = self.workspace_m.is_none_or(|workspace| is_within(&workspace, &displacement_m));
        let pull_n =
            self.push.map_or(0.0, |normal| force_n.iter().zip(normal).map(|(h, n)| h * n).sum::<f64>());
        inside && pull_n <= MAX_PULL_SHARE * norm(force_n)
    }
}
