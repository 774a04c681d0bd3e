//! Nonlinear finite elements. Elements and laws define a body, boundary conditions define its unknowns, and
//! the solver computes its equilibria.

pub(crate) mod assembly;
pub(crate) mod body;
pub(crate) mod boundary;
pub(crate) mod constant;
mod counterpart;
pub(crate) mod elastic;
pub(crate) mod element;
pub(crate) mod kinematics;
pub mod material;
mod ordering;
pub(crate) mod pad;
pub(crate) mod pressure;
pub(crate) mod solvability;
pub(crate) mod solve;
pub(crate) mod sphere;

pub use assembly::volume_ratios;
pub use body::{Body, Model, Region};
pub use boundary::{Constraints, Contact, Handle, Pose};
pub use element::Order;
pub use pad::{Fingertip, Pad, PadProfile};
pub use pressure::PressurePair;
pub use solvability::PressureFault;
pub use solve::{
    Configuration, Coupling, DESCENT_STEPS, FailureReason, FollowCount, FollowOptions, Followed, FreeBody,
    IterationProfile, NewtonOptions, Pressed, Problem, Renewal, Second, Seed, SolveFailure, Solver,
    SphereSolver, solve_body_force,
};
pub(crate) use sphere::Posture;
pub use sphere::{Capsule, CoatedSphere, Layer, Sphere};
