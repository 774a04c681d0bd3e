//! Nonlinear finite elements: elements and laws make a body, boundary conditions number its unknowns, and the solver finds
//! its equilibria.

pub mod assembly;
pub mod body;
pub mod boundary;
pub mod counterpart;
pub mod element;
pub mod kinematics;
pub mod material;
mod ordering;
pub mod pressure;
pub mod solvability;
pub mod solve;
