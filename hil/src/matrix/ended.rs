//! The ways in which a run ends, and those that each fault allows.

use crate::fault::FaultKind;
use palpate_core::Fault;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Ended {
    /// The loop recovered and renders on.
    #[default]
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

impl Ended {
    /// Name in tables and logs: that of the latched fault, or of the ending.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Recovered => "recovered",
            Self::Latched(fault) => fault.name(),
            Self::Lost => "loop ended",
            Self::Refused => "not opened",
            Self::Opened => "opened",
            Self::Guard => "guard",
            Self::Host => "host",
            Self::Watchdog => "device's watchdog",
            Self::TimedOut(what) => what,
        }
    }
}

impl Serialize for Ended {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// An event that did not happen has no name to read back.
impl<'de> Deserialize<'de> for Ended {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let others = [
            Self::Recovered,
            Self::Lost,
            Self::Refused,
            Self::Opened,
            Self::Guard,
            Self::Host,
            Self::Watchdog,
        ];
        let mut all = Fault::ALL.map(Self::Latched).into_iter().chain(others);
        all.find(|ended| ended.name() == name)
            .ok_or_else(|| D::Error::custom(format!("`{name}` ends no run")))
    }
}

impl FaultKind {
    /// Whether a run of the matrix may end like this. A latch with another reason is a different fault.
    pub(super) const fn allows(self, ended: Ended) -> bool {
        let is_stale = matches!(ended, Ended::Latched(Fault::Stale));
        let is_recovered = matches!(ended, Ended::Recovered);
        let is_not_ready = matches!(ended, Ended::Latched(Fault::NotReady));
        match self {
            Self::Duplicate | Self::Reorder => is_recovered,
            Self::Silence => is_stale,
            // A corrupted homing flag may report that the device is not homed.
            Self::CorruptReply | Self::Mixed => is_recovered || is_stale || is_not_ready,
            Self::EncoderJump => {
                is_recovered || is_not_ready || matches!(ended, Ended::Latched(Fault::Watchdog))
            }
            Self::HomingLost => is_not_ready,
            Self::ForceOff => matches!(ended, Ended::Latched(Fault::Watchdog)),
            Self::PowerCycle => is_stale || is_not_ready,
            Self::UnplugMidFrame | Self::Replug | Self::UnplugPower => matches!(ended, Ended::Lost),
            Self::WrongEcho => matches!(ended, Ended::Opened | Ended::Refused),
            Self::HostKilled | Self::HostPaused => matches!(ended, Ended::Guard | Ended::Watchdog),
            Self::GuardKilled | Self::GuardPaused => matches!(ended, Ended::Host),
            Self::Drop
            | Self::DropRequest
            | Self::DropReply
            | Self::Delay
            | Self::Truncate
            | Self::CorruptRequest
            | Self::Stall
            | Self::Refuse
            | Self::Noise
            | Self::StallIn
            | Self::StallOut
            | Self::RandomMix => is_recovered || is_stale,
        }
    }

    /// Whether a run of the QEMU bench may end like this. There the timing of a machine decides whether too
    /// many replies in a row are lost, and the driver clears a halted pipe.
    #[must_use]
    pub fn allows_on_bench(self, ended: Ended) -> bool {
        match self {
            Self::WrongEcho | Self::DropRequest | Self::DropReply => ended == Ended::Recovered,
            Self::PowerCycle => ended == Ended::Latched(Fault::Stale),
            Self::EncoderJump => ended == Ended::Latched(Fault::NotReady),
            // The flipped bit may be the homing flag of an axis.
            Self::RandomMix => Self::CorruptReply.allows(ended),
            Self::Duplicate | Self::Reorder => Self::Drop.allows(ended),
            _ => self.allows(ended),
        }
    }
}
