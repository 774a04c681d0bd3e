//! What a worker is given and what it gives back; the same on a thread and on another machine.

use serde::{Deserialize, Serialize};

use super::record::{Record, StoredSeed};
use super::task::Task;
use super::walk::{WalkJob, WalkOutcome};
use crate::num::jet::EnergyJet;

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

/// What a worker found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Which active node.
    pub active: u32,
    /// The record.
    pub record: Record,
    /// State for the children; `None` if failed.
    pub seed: Option<StoredSeed>,
    /// Configurations on the way, where the scene asks for them: scattered centres for radial basis functions.
    pub intermediate: Vec<EnergyJet>,
}
