//! Which positions a space is made of.

use serde::{Deserialize, Serialize};

use super::{GridIndex, SpaceGrid};
use crate::spec::{Tolerance, Wanted, Workspace};

/// Which positions the space of every active node of a scene is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampling {
    /// Every point of a lattice within reach.
    Lattice(Lattice),
    /// As few scattered ones as the error needs.
    Scattered(Scattered),
}

/// A lattice and how it is solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// The points.
    pub grid: SpaceGrid,
    /// Whether the corners outside the ball of the cells that reach into it are solved.
    pub complete_cells: bool,
    /// Equal parts in which every transition is made and kept, if the scene asks for it.
    pub increments: Option<u32>,
}

/// What scattered positions are to give.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Scattered {
    /// Largest displacement r_G, m.
    pub radius_m: f64,
    /// What an error of the force may be.
    pub tolerance: Tolerance,
    /// Whether the tool only pushes: positions where it would have to pull are not reached.
    pub only_push: bool,
    /// The box that the tool stays in, in the model's frame, m; none where it may be anywhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub workspace_m: Option<Workspace>,
}

/// Configurations of a scattered space at most: the fit takes the cube of them.
const MOST: usize = 160;

impl Scattered {
    /// What is wanted of the active node that rests here, m, with this outward normal.
    pub fn wanted(&self, max_force_n: f64, rest_m: [f64; 3], normal: [f64; 3]) -> Wanted {
        let push = self.only_push.then_some(normal);
        let workspace_m = self.workspace_of(rest_m);
        Wanted {
            tolerance: self.tolerance,
            radius_m: self.radius_m,
            max_force_n,
            push,
            workspace_m,
            most: MOST,
        }
    }

    /// The workspace in displacements of the node that rests here, m.
    pub fn workspace_of(&self, rest_m: [f64; 3]) -> Option<Workspace> {
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

    /// What grid indices count, m.
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

    /// Equal parts in which every transition is made and kept.
    pub fn increments(&self) -> Option<u32> {
        match self {
            Self::Lattice(lattice) => lattice.increments,
            Self::Scattered(_) => None,
        }
    }

    /// What is wanted of scattered positions, if they are.
    pub fn scattered(&self) -> Option<&Scattered> {
        match self {
            Self::Lattice(_) => None,
            Self::Scattered(scattered) => Some(scattered),
        }
    }

    /// The lattice, if it is one.
    pub fn lattice(&self) -> Option<&Lattice> {
        match self {
            Self::Lattice(lattice) => Some(lattice),
            Self::Scattered(_) => None,
        }
    }
}
