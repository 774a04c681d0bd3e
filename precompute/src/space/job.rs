//! What a worker is given and what it gives back; the same on a thread and on another machine.

use serde::{Deserialize, Serialize};

use super::record::{Record, StoredSeed};
use super::task::Task;
use super::walk::{WalkJob, WalkOutcome};
use crate::num::jet::SymmetricThird;

/// What a worker is asked for.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Work {
    /// A point of a space.
    Point(Job),
    /// Held-out truth.
    Walk(WalkJob),
}

/// What a worker gives back.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Done {
    /// A point of a space.
    Point(Box<Outcome>),
    /// Held-out truth.
    Walk(WalkOutcome),
    /// Nothing: there was no time left to do it.
    Abandoned,
}

/// A task of one space, with what it starts from.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Job {
    /// Which active node.
    pub active: u32,
    /// The task.
    pub task: Task,
    /// State of the parent; `None` for the rest point.
    pub seed: Option<StoredSeed>,
}

/// A configuration between two grid points, a scattered centre for radial basis functions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Intermediate {
    /// Displacement of the active node, m.
    pub displacement_m: [f64; 3],
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S: xx, yy, zz, xy, xz, yz, N/m.
    pub stiffness_n_m: [f64; 6],
    /// W_ijk, N/m^2.
    pub third_n_m2: SymmetricThird,
}

/// What a worker found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Which active node.
    pub active: u32,
    /// The record.
    pub record: Record,
    /// State for the children; `None` if failed.
    pub seed: Option<StoredSeed>,
    /// States on the way, where the scene asks for them.
    pub intermediate: Vec<Intermediate>,
}
