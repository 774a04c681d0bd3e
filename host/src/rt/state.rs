//! The state of a session as one word for the user, from opening the device to rendering.
//!
//! ```text
//! Disconnected -> Open -> FirmwareLoaded -> Unhomed -> Homed -> Armed -> Active
//!      ^            state of the device                ^  arm     ramp ends
//!      any fault -> SafeZero (latched)  -- reset --> Homed
//! ```
//!
//! It is derived from the state of the device and the phase of the controller; neither depends on the other.

use super::record::TickRecord;
use crate::device::DeviceState;
use core::fmt;
use palpate_core::{Fault, Phase};

/// State of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SessionState {
    /// No device, or a device that is not ready. No force.
    Device(DeviceState),
    /// Ready to be armed. No force.
    Homed,
    /// Just armed: the force ramps up.
    Armed,
    /// Rendering.
    Active,
    /// Fault: no force until reset and armed.
    SafeZero(Fault),
}

impl SessionState {
    /// The state of a tick.
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

    /// Whether the state permits a force.
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
    fn only_an_armed_session_has_force_and_a_fault_overrides_other_states() {
        let record = |phase, device, ramp| TickRecord { phase, device, ramp, ..TickRecord::EMPTY };
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
