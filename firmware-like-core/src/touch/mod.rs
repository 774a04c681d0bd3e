//! Contact of the tool with the body: its surface, and which active nodes are held.

pub(crate) mod approach;
mod cells;
pub(crate) mod contact;
pub(crate) mod grip;
mod surface;

pub use contact::ContactConfig;
pub use surface::{Foot, NodeWeight, TouchSurface, nearest_on_triangle};
