//! The solver beside the haptic loop: it follows the hand and solves where the force is not known well enough.
//!
//! ```text
//! Hand -> choice (what is not known?) -> continuation from the nearest kept state -> jet -> the loop
//!                                              |                                      |
//!                                              +------- states, memory of jets <------+
//! ```
//!
//! A jet is the condensed energy W with its derivatives h, S and W_ijk at one control, and its third-order Taylor
//! series is the model of the force round it. A place of the skin that the tool can touch is a *contact*: a vertex
//! that is not fixed. Every contact has its own jets; within a triangle of contacts the forces are blended. All
//! contacts share the equations of one body, so going from one to the next costs no analysis.
//!
//! [`LiveSolver::step`] does one piece of work and returns. It reads no clock: the caller measures the time and
//! says how long the step took ([`LiveSolver::took`]), which the prediction of the hand needs.

mod beyond;
mod branches;
mod choice;
mod error;
mod hand;
mod memory;
mod published;
mod renewals;
mod skin;
mod solver;
mod states;
mod tabled;
mod task;
mod times;
mod truth;
mod workers;

pub use error::LiveError;
pub use hand::{Axis, Hand, Partner, Touch};
pub use memory::Trust;
pub use published::{Published, Step, Totals};
pub use skin::Skin;
pub use solver::LiveSolver;
pub use truth::Truth;
