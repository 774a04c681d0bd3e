//! The interpolation methods, all behind the trait `Interpolant`.
//!
//! `energy` and `kernel` are gradients of a scalar potential and therefore conservative. The methods in
//! `baseline` are those of Peterlik 2010, kept for comparison.

pub(crate) mod baseline;
mod blend;
pub(crate) mod energy;
pub(crate) mod hermite;
pub(crate) mod interpolant;
pub mod kernel;
pub(crate) mod root;

use serde::{Deserialize, Serialize};

use crate::named::named;
use crate::num::vec3::Vec3;

named! {
    /// Interpolation method for the reaction force.
    #[derive(Serialize, Deserialize)]
    pub enum Method {
        /// Eight corners of the cell; C0.
        Trilinear = "trilinear",
        /// Catmull-Rom on the 64-point super-cell; C1.
        Tricubic = "tricubic",
        /// Tri-cubic where the super-cell is complete, tri-linear elsewhere (section 7 of the paper), made
        /// continuous.
        Hybrid = "hybrid",
        /// Radial basis functions, phi = r.
        RbfLinear = "rbf-linear",
        /// Radial basis functions, phi = r^3.
        RbfCubic = "rbf-cubic",
        /// Cubic Hermite on each force component; C1.
        Hermite = "hermite",
        /// Gradient of the quintic Hermite interpolant of the energy; C1, conservative.
        Energy = "energy",
        /// Gradient of the sum of Gaussians fitted to the energy at scattered configurations; smooth,
        /// conservative.
        Kernel = "kernel",
    }
}

impl Method {
    /// The methods whose tables consist of values at lattice points: all but the kernel.
    pub const OF_LATTICE: [Self; 7] = {
        let [lattice @ .., last] = Self::ALL;
        assert!(matches!(last, Self::Kernel));
        lattice
    };
}

named! {
    /// The data behind a force. It is part of the result, not an error: incomplete cells are normal at the
    /// rim.
    #[derive(Serialize, Deserialize)]
    pub enum Coverage {
        /// All eight corners of the cell are solved configurations.
        Cell = "cell",
        /// All 64 points of the super-cell are solved configurations.
        SuperCell = "supercell",
        /// A scattered-data method inside its domain.
        Scattered = "scattered",
        /// Data is missing: an unsolved corner, or a query outside the domain.
        Extrapolated = "extrapolated",
    }
}

/// Reaction force with its derivatives at one displacement. All numbers are finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// h, the force by the tool on the body, newtons.
    pub force_n: Vec3,
    /// dh_i/dd_j as rows i, newtons per metre: the exact derivative of the interpolant inside its domain.
    pub stiffness_n_m: [Vec3; 3],
    /// W, joules, where the force is its gradient: `energy` away from folds, and `kernel`, inside their
    /// domains.
    pub energy_j: Option<f32>,
    /// The data behind the force.
    pub coverage: Coverage,
}

/// Reaction force at one displacement, always finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSample {
    /// h, the force by the tool on the body, newtons.
    pub force_n: Vec3,
    /// The data behind the force.
    pub coverage: Coverage,
}
