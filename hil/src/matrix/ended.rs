//! The ways in which a run ends.

use palpate_core::Fault;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// The loop recovered and renders on.
    Recovered,
    /// The loop latched a fault.
    Latched(Fault),
    /// The device is lost and the loop ended.
    Lost,
    /// The driver refused to open.
    Refused,
    /// The driver opened, without a force.
    Opened,
    /// The guard set zero force.
    Guard,
    /// The host set zero force after its guard was lost.
    Host,
    /// The device's own watchdog set zero force and latched.
    Watchdog,
    /// An expected event did not happen.
    TimedOut(&'static str),
}
