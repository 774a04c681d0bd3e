//! Nonlinear finite elements. Elements and laws define a body, boundary conditions define its unknowns, and
//! the solver computes its equilibria.

pub mod assembly;
pub mod body;
pub mod boundary;
pub(crate) mod counterpart;
pub mod element;
pub mod kinematics;
pub mod material;
mod ordering;
pub mod pressure;
pub mod solvability;
pub mod solve;
