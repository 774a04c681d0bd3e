//! What adaptive sampling is to reach.

use super::tolerance::Tolerance;
use super::workspace::{Workspace, is_within};
use crate::num::vector::norm;

/// A pull of such a share of the force is near enough to pressing for a lattice to go on.
const ALL_BUT_PRESSES: f64 = 0.25;
/// A cheaper body is learned to so many times the force limit, and to this share of the tolerance.
const BENEATH: f64 = 1.1;
const FINER: f64 = 0.3;

/// What is wanted of a space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// What an error may be.
    pub tolerance: Tolerance,
    /// Largest displacement r_G, m.
    pub radius_m: f64,
    /// Largest |h|, N.
    pub max_force_n: f64,
    /// Outward normal, if the tool only pushes: positions where h pulls are out of reach.
    pub push: Option<[f64; 3]>,
    /// The displacements within the device's workspace, if that is less than the ball.
    pub workspace_m: Option<Workspace>,
    /// Configurations at most.
    pub most: usize,
}

impl Wanted {
    /// What is wanted of a cheaper body that is to lie beneath this one: it may be softer or stiffer, and must not end before this one does.
    #[must_use]
    pub fn of_a_cheaper_body(&self) -> Self {
        let Tolerance { relative, absolute_n } = self.tolerance;
        let tolerance = Tolerance { relative: FINER * relative, absolute_n: FINER * absolute_n };
        Self { tolerance, max_force_n: BENEATH * self.max_force_n, ..*self }
    }

    /// Whether more than radius and force keep the tool in.
    pub fn is_kept_in(&self) -> bool {
        self.push.is_some() || self.workspace_m.is_some()
    }

    /// Whether a lattice goes on from a configuration: one that is in the workspace and, if the tool only pushes, presses or all but presses. Its
    /// neighbours are solved, so that the cells at the rim of what can be reached have their corners.
    pub fn lattice_goes_on_from(&self, displacement_m: [f64; 3], force_n: [f64; 3]) -> bool {
        let inside = self.workspace_m.is_none_or(|workspace| is_within(&workspace, &displacement_m));
        let pull_n =
            self.push.map_or(0.0, |normal| force_n.iter().zip(normal).map(|(h, n)| h * n).sum::<f64>());
        inside && pull_n <= ALL_BUT_PRESSES * norm(force_n)
    }
}
