//! The interpolation methods, all behind the trait `Interpolant`.
//!
//! `energy` and `kernel` are gradients of a scalar potential and therefore conservative. The methods in
//! [`baseline`] are those of Peterlik 2010, kept for comparison.

pub mod baseline;
mod blend;
pub(crate) mod energy;
pub mod hermite;
mod interpolant;
pub mod kernel;

pub(crate) use interpolant::{Ball, Interpolant, estimate, force_inside, force_outside};

use serde::{Deserialize, Serialize};

use crate::num::vec3::Vec3;

/// Interpolation method for the reaction force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Method {
    /// Eight corners of the cell; C0.
    Trilinear,
    /// Catmull-Rom on the 64-point super-cell; C1.
    Tricubic,
    /// Tri-cubic where the super-cell is complete, tri-linear elsewhere (section 7 of the paper), made
    /// continuous.
    Hybrid,
    /// Radial basis functions, phi = r.
    RbfLinear,
    /// Radial basis functions, phi = r^3.
    RbfCubic,
    /// Cubic Hermite on each force component; C1.
    Hermite,
    /// Gradient of the quintic Hermite interpolant of the energy; C1, conservative.
    Energy,
    /// Gradient of the sum of Gaussians fitted to the energy at scattered configurations; smooth,
    /// conservative.
    Kernel,
}

impl Method {
    /// Every method.
    pub const ALL: [Self; 8] = [
        Self::Trilinear,
        Self::Tricubic,
        Self::Hybrid,
        Self::RbfLinear,
        Self::RbfCubic,
        Self::Hermite,
        Self::Energy,
        Self::Kernel,
    ];

    /// The methods whose tables consist of values at lattice points: all but the kernel.
    pub const OF_LATTICE: [Self; 7] = [
        Self::Trilinear,
        Self::Tricubic,
        Self::Hybrid,
        Self::RbfLinear,
        Self::RbfCubic,
        Self::Hermite,
        Self::Energy,
    ];

    /// The name used on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trilinear => "trilinear",
            Self::Tricubic => "tricubic",
            Self::Hybrid => "hybrid",
            Self::RbfLinear => "rbf-linear",
            Self::RbfCubic => "rbf-cubic",
            Self::Hermite => "hermite",
            Self::Energy => "energy",
            Self::Kernel => "kernel",
        }
    }

    /// The method with this [`Method::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }
}

/// The data behind a force. It is part of the result, not an error: incomplete cells are normal at the rim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Coverage {
    /// All eight corners of the cell are solved configurations.
    Cell,
    /// All 64 points of the super-cell are solved configurations.
    SuperCell,
    /// A scattered-data method inside its domain.
    Scattered,
    /// Data is missing: an unsolved corner, or a query outside the domain.
    Extrapolated,
}

impl Coverage {
    /// Every kind of coverage.
    pub const ALL: [Self; 4] = [Self::Cell, Self::SuperCell, Self::Scattered, Self::Extrapolated];

    /// The name used in CSV columns.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cell => "cell",
            Self::SuperCell => "supercell",
            Self::Scattered => "scattered",
            Self::Extrapolated => "extrapolated",
        }
    }

    /// The coverage with this [`Coverage::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|coverage| coverage.name() == name)
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
