//! The state of a session, from the first byte of the device to its last newton: one word for people.
//!
//! ```text
//! Disconnected -> Open -> FirmwareLoaded -> Unhomed -> Homed -> Armed -> Active
//!      ^            what the device says               ^  arm     ramp ends
//!      any fault -> SafeZero (latched)  -- reset --> Homed
//! ```
//!
//! Derived from what the device says and what the controller does; neither has to know of the other.

use super::TickRecord;
use crate::device::DeviceState;
use core::fmt;
use palpate_core::{Fault, Phase};

/// Where a session is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SessionState {
    /// No device, or not usable yet. No force.
    Device(DeviceState),
    /// Ready to be armed. No force.
    Homed,
    /// Armed a moment ago: the force ramps up.
    Armed,
    /// Rendering.
    Active,
    /// No force after a fault, until reset and armed.
    SafeZero(Fault),
}

impl SessionState {
    /// The state a tick was in.
    #[must_use]
    pub const fn of(record: &TickRecord) -> Self {
        match (record.phase, record.device) {
            (Phase::SafeZero(fault), _) => Self::SafeZero(fault),
            (Phase::Active, _) if record.ramp < 1.0 => Self::Armed,
            (Phase::Active, _) => Self::Active,
            (Phase::Disarmed, DeviceState::Homed) => Self::Homed,
            (Phase::Disarmed, device) => Self::Device(device),
        }
    }

    /// Whether a force may be given in it.
    #[must_use]
    pub const fn has_force(self) -> bool {
        matches!(self, Self::Armed | Self::Active)
    }
}

impl fmt::Display for SessionState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(device) => f.write_str(device.name()),
            Self::Homed => f.write_str("homed, not armed"),
            Self::Armed => f.write_str("armed"),
            Self::Active => f.write_str("active"),
            Self::SafeZero(fault) => write!(f, "safe zero: {}", fault.name()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_armed_session_has_force_and_a_fault_hides_all_else() {
        let record = |phase, device, ramp| TickRecord { phase, device, ramp, ..TickRecord::NOTHING };
        let of = |phase, device, ramp| SessionState::of(&record(phase, device, ramp));
        assert_eq!(of(Phase::Disarmed, DeviceState::Unhomed, 0.0).to_string(), "unhomed");
        assert_eq!(of(Phase::Disarmed, DeviceState::Homed, 0.0), SessionState::Homed);
        assert_eq!(of(Phase::Active, DeviceState::Homed, 0.3), SessionState::Armed);
        assert_eq!(of(Phase::Active, DeviceState::Homed, 1.0), SessionState::Active);
        let fault = of(Phase::SafeZero(Fault::NotReady), DeviceState::Unhomed, 0.0);
        assert_eq!(fault.to_string(), "safe zero: not-ready");
        for state in [SessionState::Homed, SessionState::Device(DeviceState::Open), fault] {
            assert!(!state.has_force());
        }
    }
}
