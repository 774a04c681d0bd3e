//! Requirements of adaptive sampling.

use serde::{Deserialize, Serialize};

use super::active::Column;
use super::tolerance::Tolerance;
use super::workspace::{Workspace, is_within};
use crate::num::vector::{dot, norm};

/// Largest ratio of pull to |h| at which a lattice still continues from a configuration.
const MAX_PULL_SHARE: f64 = 0.25;

/// What a fit interpolates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Quantity {
    /// W, whose gradient is h.
    #[default]
    Energy,
    /// s = sqrt(2 W) with h = max(0, s) ds/dd, of a tool that can leave the body: s rises linearly from the first touch,
    /// where W has no third derivatives.
    Root,
}

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
    /// The column along `push` in which the displacements lie; `None` for the whole ball.
    pub column: Option<Column>,
    /// What is interpolated.
    pub quantity: Quantity,
    /// Maximum number of configurations.
    pub max_configurations: usize,
}

impl Requirements {
    /// Whether pushing or the workspace limits the tool in addition to radius and force.
    pub(crate) fn is_kept_in(&self) -> bool {
        self.push.is_some() || self.workspace_m.is_some()
    }

    /// Whether a displacement, m, lies in the core of the column, if there is one.
    pub(crate) fn is_in_column(&self, displacement_m: [f64; 3]) -> bool {
        self.column.zip(self.push).is_none_or(|(column, normal)| {
            column.contains(normal, displacement_m, 0.0) && dot(displacement_m, normal) <= column.top_m
        })
    }

    /// Whether a tool that only pushes can have this force: it does not pull. A tool that leaves the body without being
    /// held has any force but none.
    pub(crate) fn pushes(&self, force_n: [f64; 3], normal: [f64; 3]) -> bool {
        match self.quantity {
            Quantity::Energy => dot(force_n, normal) <= 0.0,
            Quantity::Root => force_n != [0.0; 3],
        }
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
