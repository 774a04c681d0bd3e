//! The positions at which a space is sampled.

use serde::{Deserialize, Serialize};

use super::{GridIndex, SpaceGrid};
use crate::spec::{Chart, Quantity, Requirements, Tolerance, Workspace};

/// The positions at which the space of each active node of a scene is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampling {
    /// All points of a lattice within the radius.
    Lattice(Lattice),
    /// Adaptive sampling: as few scattered positions as the tolerance needs.
    Scattered(Scattered),
}

/// A lattice and its solution options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// The lattice points.
    pub grid: SpaceGrid,
    /// Whether to solve also the outer corners of the cells that intersect the ball.
    pub complete_cells: bool,
    /// Number of equal increments of each transition whose states are stored, if the scene requests it.
    pub increments: Option<u32>,
}

/// Parameters of adaptive sampling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Scattered {
    /// Largest displacement r_G, m.
    pub radius_m: f64,
    /// Tolerance of the force error.
    pub tolerance: Tolerance,
    /// Whether the tool only pushes. Positions at which it would have to pull are then not sampled.
    pub only_push: bool,
    /// Workspace of the tool in the model's frame, m; `None` means unbounded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub workspace_m: Option<Workspace>,
}

/// Maximum number of configurations of a scattered space: the cost of the fit grows with the cube of the
/// number.
const MAX_SOLVES: usize = 160;

impl Scattered {
    /// Requirements of the active node at rest position `rest_m`, m, with this outward normal.
    pub fn wanted(&self, max_force_n: f64, rest_m: [f64; 3], normal: [f64; 3]) -> Requirements {
        let push = self.only_push.then_some(normal);
        let workspace_m = self.workspace_of(rest_m);
        Requirements {
            tolerance: self.tolerance,
            radius_m: self.radius_m,
            max_force_n,
            push,
            workspace_m,
            column: None,
            quantity: Quantity::Energy,
            max_configurations: MAX_SOLVES,
        }
    }

    /// Requirements of a chart of a sphere's field.
    pub fn wanted_of(&self, max_force_n: f64, chart: &Chart) -> Requirements {
        Requirements {
            push: Some(chart.normal),
            column: Some(chart.column),
            quantity: Quantity::Root,
            ..self.wanted(max_force_n, chart.centre_m, chart.normal)
        }
    }

    /// The workspace as displacements of the node at rest position `rest_m`, m.
    pub(crate) fn workspace_of(&self, rest_m: [f64; 3]) -> Option<Workspace> {
        let from_rest = |corner: [f64; 3]| std::array::from_fn(|axis| corner[axis] - rest_m[axis]);
        self.workspace_m.map(|corners| corners.map(from_rest))
    }
}

impl Sampling {
    /// Largest displacement r_G, m.
    pub fn radius_m(&self) -> f64 {
        match self {
            Self::Lattice(lattice) => lattice.grid.radius_m,
            Self::Scattered(scattered) => scattered.radius_m,
        }
    }

    /// Number of points of one space without the rest point; `None` for adaptive sampling, where it is not
    /// known in advance.
    pub fn points(&self) -> Option<usize> {
        self.lattice().map(|lattice| lattice.grid.points(lattice.complete_cells).len() - 1)
    }

    /// Unit of the grid indices, m.
    pub fn unit_m(&self) -> f64 {
        match self {
            Self::Lattice(lattice) => lattice.grid.spacing_m,
            Self::Scattered(_) => super::UNIT_M,
        }
    }

    /// Displacement of a point, m.
    pub fn displacement_m(&self, index: GridIndex) -> [f64; 3] {
        index.map(|n| f64::from(n) * self.unit_m())
    }

    /// Number of equal increments of each transition whose states are stored.
    pub(crate) fn increments(&self) -> Option<u32> {
        match self {
            Self::Lattice(lattice) => lattice.increments,
            Self::Scattered(_) => None,
        }
    }

    /// The parameters of adaptive sampling, or `None` for a lattice.
    pub fn scattered(&self) -> Option<&Scattered> {
        match self {
            Self::Lattice(_) => None,
            Self::Scattered(scattered) => Some(scattered),
        }
    }

    /// The lattice, or `None` for adaptive sampling.
    pub fn lattice(&self) -> Option<&Lattice> {
        match self {
            Self::Lattice(lattice) => Some(lattice),
            Self::Scattered(_) => None,
        }
    }
}
