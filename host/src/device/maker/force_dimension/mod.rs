//! Force Dimension omega, delta, sigma and lambda, and a Falcon, through libdhd.

pub mod api;
pub mod driver;
mod model;
mod opening;

pub use api::Dhd;
pub use driver::{Exchanging, ForceDimension};
pub use model::Family;
pub use opening::OpenError;
