//! An emulated Inverse Service of Haply with an Inverse3 and a grip, on sockets of this machine.
//!
//! Written from the documentation of the service. Like it, it sends one inventory unasked and then one state per message, and
//! ignores keys that it does not know. A force acts until the next message or the end of the connection: how long a real
//! device holds it is not known, so this is the worst case.

mod service;
mod split;
mod world;

pub use service::Service;
pub use world::{Flags, Held, Reply, World};

use std::time::Duration;

/// Time of all processes, ns.
#[must_use]
pub fn now_ns() -> u64 {
    palpate_host::sys::monotonic_ns()
}

/// How often a thread of the emulator looks whether it is to end.
const LOOK: Duration = Duration::from_millis(20);
