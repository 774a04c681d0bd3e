//! The configuration space: positions of the active node, solved point by point (paper, 4.3 and 5.1).
//!
//! A `SpacePlan` selects the next point and its parent. A [`Job`] is one solve by a worker of an
//! [`Executor`], which has threads or processes. [`expand`] connects them, and the [`Store`] keeps every
//! attempt in SQLite.

pub(crate) mod executor;
pub(crate) mod expansion;
mod fallback;
mod job;
mod motion;
mod plan;
mod plans;
mod record;
mod salvage;
mod samples;
mod state;
pub(crate) mod store;
mod task;
mod walk;
mod worker;

pub use executor::{Executor, Threads, with_threads};
pub use expansion::{ExpansionError, Progress, expand};
pub use fallback::FallbackLattice;
pub use job::{Done, ExecutorError, Job, Outcome, Work};
pub(crate) use motion::SurfaceMotion;
pub use plan::{Phase, SolvesLeft};
pub use plans::{complete_charts, expand_model, replays, state};
pub use record::{Equilibrium, Record, Solution, StoredSeed};
pub(crate) use salvage::Salvaged;
pub use samples::branch_jumps;
pub(crate) use samples::samples;
pub use state::SpaceState;
pub use store::{Store, StoreError, StoreIdentity, solver_version};
pub use task::{TagCounts, Task};
pub use walk::{Kind, Truth, Walk, WalkJob, WalkOutcome};
pub use worker::WorkerContext;

#[cfg(test)]
pub(crate) mod tests;
