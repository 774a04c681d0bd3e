//! Input and output of a worker, the same on a thread and on another machine.

use serde::{Deserialize, Serialize};

use super::record::{Record, StoredSeed};
use super::task::Task;
use super::walk::{WalkJob, WalkOutcome};
use crate::num::jet::EnergyJet;

/// Work for a worker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Work {
    /// A point of a space.
    Point(Job),
    /// A held-out path or position.
    Walk(WalkJob),
}

/// Result of a worker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Done {
    /// A point of a space.
    Point(Box<Outcome>),
    /// Held-out reference values.
    Walk(WalkOutcome),
    /// No result: the run was stopped first.
    Abandoned,
}

/// A task of one space with its start state.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Job {
    /// Active node.
    pub active: u32,
    /// The task.
    pub task: Task,
    /// State of the parent; `None` for the rest point.
    pub seed: Option<StoredSeed>,
}

/// Result of a task.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Active node.
    pub active: u32,
    /// The record of the attempt.
    pub record: Record,
    /// State for the children; `None` if the solve failed.
    pub seed: Option<StoredSeed>,
    /// Intermediate configurations of the transition, if the scene requests them (scattered centres of radial
    /// basis functions).
    pub intermediate: Vec<EnergyJet>,
}
