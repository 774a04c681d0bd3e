//! Limits between the force of the model and the hand, and detection of states that require zero force.

pub(crate) mod fade;
pub(crate) mod limit;
pub(crate) mod passivity;
mod recent;
pub(crate) mod speed;
pub(crate) mod stiffness;
pub(crate) mod velocity;

pub use limit::{LimitConfig, clamp_force};
pub use passivity::PassivityConfig;
