//! What `run` and `live` share: arguments, devices, and the report of a session.

mod args;
mod devices;
mod replay;
mod report;

pub(crate) use args::{Outputs, SessionArgs};
pub(crate) use devices::{Opener, profile};
pub(crate) use replay::Replay;
pub(crate) use report::{Figures, Watcher};
