//! Which interpolation method answers, and on what data the answer stands.

use serde::{Deserialize, Serialize};

use crate::vec3::Vec3;

/// Interpolation method for the reaction force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Method {
    /// Eight corners of the cell; C0.
    Trilinear,
    /// Catmull-Rom on the 64-point super-cell; C1.
    Tricubic,
    /// Tri-cubic where the super-cell is complete, tri-linear elsewhere (section 7 of the paper), made continuous.
    Hybrid,
    /// Radial basis functions, phi = r.
    RbfLinear,
    /// Radial basis functions, phi = r^3.
    RbfCubic,
    /// Cubic Hermite on each force component; C1.
    Hermite,
    /// Gradient of the quintic Hermite interpolant of the energy; C1, conservative.
    Energy,
    /// Gradient of the very sum of Gaussians that was fitted to the energy at scattered configurations; smooth, conservative.
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

    /// Those whose tables are made of the points of a lattice: all but the kernel, which needs a fit.
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

    /// Reads back [`Method::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }
}

/// On what data a force stands. Part of the answer, not an error: incomplete cells are normal at the rim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Coverage {
    /// All eight corners of the cell are solved configurations.
    Cell,
    /// All 64 points of the super-cell are solved configurations.
    SuperCell,
    /// Scattered-data method with solved configurations at all corners round the query.
    Scattered,
    /// A missing corner, the rim or beyond: the out-of-table policy answered.
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

    /// Reads back [`Coverage::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|coverage| coverage.name() == name)
    }
}

/// Everything one evaluation gives, always finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// h, force by the tool on the body, newtons.
    pub force_n: Vec3,
    /// dh_i/dd_j as rows i, newtons per metre: the derivative of this very interpolant. Symmetric for `energy` and `kernel` alone.
    pub stiffness_n_m: [Vec3; 3],
    /// W, joules, where the force is its gradient: `energy`, inside the ball and away from folds, and `kernel` within its reach.
    pub energy_j: Option<f32>,
    /// The data behind it.
    pub coverage: Coverage,
}

/// Reaction force at one query, always finite, with its coverage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSample {
    /// h, force by the tool on the body, newtons.
    pub force_n: Vec3,
    /// The data behind it.
    pub coverage: Coverage,
}
