//! 3D Systems Touch and Phantom through OpenHaptics HDAPI.

pub mod api;
pub mod driver;
mod running;
#[cfg(test)]
mod tests;

pub use api::Hd;
pub use driver::{Touch, TouchError};
