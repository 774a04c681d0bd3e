//! Verification of whole solves: constraints and reactions, and convergence to manufactured solutions.

mod constraints;
mod manufactured;
mod stability;
mod two_level;
