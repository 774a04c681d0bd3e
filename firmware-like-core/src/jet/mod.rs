//! Jets of a live solver: the force near solved positions, received while the tool touches.
//!
//! ```text
//! frame -> Jet::decode (checked once) -> JetMemory::insert -> nearest jet -> fade -> ladder -> force
//! ```
//!
//! A jet holds W, h, S and the third derivatives at one displacement of one contact point (a space of the
//! organ). The solver is a process of its own and may be late or end; the force stays bounded and smooth.

mod frame;
mod ladder;
mod memory;
mod stiffest;
mod table;
mod trusted;
mod turning;

pub use frame::{Jet, JetCoupling, JetError, JetFlags};
pub use ladder::Solver;
pub use memory::JetMemory;
