//! The organ blob, the only thing that crosses from offline to on-line: layout, reader and what can be wrong with one.

mod error;
pub mod format;
mod reader;

pub use error::{BlobError, PlaneProblem};
pub use reader::{Organ, Surface};
