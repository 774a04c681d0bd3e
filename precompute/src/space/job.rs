//! Input and output of a worker, the same on a thread and on another machine.

use serde::{Deserialize, Serialize};

use super::record::{Record, StoredSeed};
use super::task::Task;
use super::walk::{WalkJob, WalkOutcome};
use crate::num::jet::EnergyJet;
use crate::num::parallel::ThreadError;

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

/// Why an executor failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum ExecutorError {
    /// A worker stopped on an internal error.
    #[error("a worker stopped on an internal error; please report it")]
    Panicked,
    /// The start state of a job does not fit this body.
    #[error("a stored state does not fit the body; the file is damaged")]
    StartState,
    /// The connection to a worker on another machine is lost.
    #[error("{0}; the unfinished work of this worker is lost; run the same command to continue")]
    Lost(String),
    /// A worker returned a result that was not requested.
    #[error("a worker returned a result that was not requested; please report it")]
    UnexpectedResult,
    /// The operating system refuses to start so many threads.
    #[error(transparent)]
    Threads(ThreadError),
}
