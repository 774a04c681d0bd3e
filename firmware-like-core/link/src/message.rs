//! The messages of the device link, version 1.
//!
//! ```text
//! host                            device
//! Hello{version, nonce}        -> HelloAck{version, nonce, session, info}
//! Home, Enable, Disable        -> State{seq_echo, encoders, flags}, or Fault{code}
//! Command{seq, torque}         -> State{seq_echo, encoders, flags}, or Fault{code}
//! ```
//!
//! The host sends requests, and the device answers each one once. [`crate::Device`] defines the transitions
//! of the device.
//!
//! Every message after the handshake has the session and an increasing sequence number, so that neither a
//! repeated frame nor one of an earlier session has an effect. The answer repeats the number, so that the
//! host can match it.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::fixed;

/// Version of the protocol. `Hello` and the first two fields of `HelloAck` are the same in all versions, so
/// that two ends with different versions can detect the difference.
pub const VERSION: u16 = 1;

/// Shortest watchdog of a device, microseconds: the jitter of an ordinary PC would trip a shorter one.
pub const MIN_WATCHDOG_US: u16 = 5_000;
/// Longest watchdog of a device, microseconds: a longer one would keep the force of a host that has stopped.
pub const MAX_WATCHDOG_US: u16 = 20_000;

/// Length in bytes of the longest message, a `HelloAck`.
pub const MAX_MESSAGE: usize = 46;

/// [`DeviceMessage::State`] flag: the mechanism is homed.
pub const HOMED: u8 = 1;
/// [`DeviceMessage::State`] flag: the mechanism is homing.
pub const HOMING: u8 = 2;
/// [`DeviceMessage::State`] flag: commands have an effect.
pub const ENABLED: u8 = 4;
/// [`DeviceMessage::State`] flag: the request had no effect: not enabled, not homed, an old number, or too
/// late.
pub const REFUSED: u8 = 8;
/// [`DeviceMessage::State`] flag: the torque exceeded a limit and was reduced.
pub const CLAMPED: u8 = 16;

/// A message of one direction.
pub trait Message: Serialize + DeserializeOwned {
    /// Length in postcard, bytes; the same for all messages of a kind.
    ///
    /// A reader requires this length. The tags of kinds and faults are varints, of which postcard also
    /// accepts longer encodings (`80 00` for `00`); a frame with such an encoding is refused.
    fn encoded_len(&self) -> usize;
}

/// A request of the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum HostMessage {
    /// Opens a session and ends the previous one. Clears a latched fault, but does not enable the device.
    Hello {
        /// [`VERSION`] of the host.
        #[serde(with = "fixed")]
        version: u16,
        /// Any number, a different one in each handshake: the answer repeats it.
        #[serde(with = "fixed")]
        nonce: u32,
    },
    /// Enables commands. The host sends it only after a deliberate action of its user.
    Enable {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Sequence number of this request.
        #[serde(with = "fixed")]
        seq: u32,
    },
    /// Sets the torque to zero, also with an old sequence number.
    Disable {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Sequence number of this request.
        #[serde(with = "fixed")]
        seq: u32,
    },
    /// Sets the torque to zero and starts the homing procedure.
    Home {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Sequence number of this request.
        #[serde(with = "fixed")]
        seq: u32,
    },
    /// Sets the torque. While the device is not enabled, a request for its state.
    Command {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Sequence number of this request.
        #[serde(with = "fixed")]
        seq: u32,
        /// Time of sending on any clock of the host, microseconds; may wrap.
        #[serde(with = "fixed")]
        t_host_us: u32,
        /// Torque of each axis, micro-newton-metres.
        #[serde(with = "fixed")]
        torque_unm: [i32; 3],
        /// Largest duration of its effect, microseconds; 0 for no effect. No torque lasts longer than the
        /// watchdog.
        #[serde(with = "fixed")]
        valid_for_us: u16,
    },
}

impl Message for HostMessage {
    fn encoded_len(&self) -> usize {
        match self {
            Self::Hello { .. } => 7,
            Self::Enable { .. } | Self::Disable { .. } | Self::Home { .. } => 9,
            Self::Command { .. } => 27,
        }
    }
}

/// An answer of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceMessage {
    /// To `Hello`: the session and the properties of the device.
    HelloAck {
        /// [`VERSION`] of the device.
        #[serde(with = "fixed")]
        version: u16,
        /// The nonce of the `Hello`.
        #[serde(with = "fixed")]
        nonce: u32,
        /// The new session, or 0 if the versions differ.
        #[serde(with = "fixed")]
        session: u32,
        /// The properties of the device.
        info: DeviceInfo,
    },
    /// State of the device.
    State {
        /// Newest sequence number of this session that the device has received, or 0.
        #[serde(with = "fixed")]
        seq_echo: u32,
        /// Time of the encoder reading on the clock of the device, microseconds; may wrap.
        #[serde(with = "fixed")]
        t_dev_us: u32,
        /// Encoder counts of each axis; they may wrap.
        #[serde(with = "fixed")]
        encoders: [i32; 3],
        /// One bit per button, 1 while pressed.
        buttons: u8,
        /// [`HOMED`], [`HOMING`], [`ENABLED`], [`REFUSED`], [`CLAMPED`].
        flags: u8,
    },
    /// The torque is zero until the next `Hello` and `Enable`.
    Fault {
        /// The first fault since the last handshake.
        code: DeviceFault,
    },
}

impl Message for DeviceMessage {
    fn encoded_len(&self) -> usize {
        match self {
            Self::HelloAck { .. } => MAX_MESSAGE,
            Self::State { .. } => 23,
            Self::Fault { .. } => 2,
        }
    }
}

/// Why a device has latched zero torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DeviceFault {
    /// Enabled, but no valid command for the time of the watchdog.
    Watchdog,
    /// The clock of the device ran backwards.
    Clock,
    /// An axis moved faster than its profile allows, or its encoder jumped.
    Overspeed,
    /// Enabled, but the mechanism is no longer homed.
    HomeLost,
    /// The hardware reports a fault: driver temperature, emergency stop.
    Hardware,
}

impl DeviceFault {
    /// Every fault, in the order of the codes on the wire.
    pub const ALL: [Self; 5] = [Self::Watchdog, Self::Clock, Self::Overspeed, Self::HomeLost, Self::Hardware];

    /// The name used in logs and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Watchdog => "watchdog",
            Self::Clock => "clock",
            Self::Overspeed => "overspeed",
            Self::HomeLost => "home-lost",
            Self::Hardware => "hardware",
        }
    }
}

/// Properties of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceInfo {
    /// Number of axes, 1 to 3; the numbers of further axes have no meaning.
    pub dof: u8,
    /// Encoder counts per turn of each axis.
    #[serde(with = "fixed")]
    pub counts_per_turn: [u32; 3],
    /// Largest torque of each axis, micro-newton-metres.
    #[serde(with = "fixed")]
    pub torque_limit_unm: [u32; 3],
    /// Time without a command that is a fault while enabled, microseconds.
    #[serde(with = "fixed")]
    pub watchdog_us: u16,
    /// Serial number.
    #[serde(with = "fixed")]
    pub serial: u32,
    /// Version of the firmware, in the maker's numbering.
    #[serde(with = "fixed")]
    pub firmware: u32,
}

impl DeviceInfo {
    /// Checks the range of the numbers. A device does not start, and a host does not enable a device, if it
    /// fails.
    pub fn check(&self) -> Result<(), InfoError> {
        if !(1..=3).contains(&self.dof) {
            return Err(InfoError::Dof { dof: self.dof });
        }
        if !(MIN_WATCHDOG_US..=MAX_WATCHDOG_US).contains(&self.watchdog_us) {
            return Err(InfoError::Watchdog { watchdog_us: self.watchdog_us });
        }
        for (axis, counts, limit_unm) in self.axes() {
            if counts == 0 {
                return Err(InfoError::Counts { axis });
            }
            if limit_unm == 0 || i32::try_from(limit_unm).is_err() {
                return Err(InfoError::TorqueLimit { axis, limit_unm });
            }
        }
        Ok(())
    }

    /// Number, counts and torque limit of each existing axis.
    fn axes(&self) -> impl Iterator<Item = (u8, u32, u32)> {
        let axes = (0..self.dof).zip(self.counts_per_turn).zip(self.torque_limit_unm);
        axes.map(|((axis, counts), limit_unm)| (axis, counts, limit_unm))
    }
}

/// What is wrong with a [`DeviceInfo`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InfoError {
    /// Not 1, 2 or 3 axes.
    #[error("a device has 1 to 3 axes, this one has {dof}")]
    Dof {
        /// The number of axes.
        dof: u8,
    },
    /// Not between [`MIN_WATCHDOG_US`] and [`MAX_WATCHDOG_US`].
    #[error(
        "the watchdog of a device is {} to {} us, this one has {watchdog_us} us",
        MIN_WATCHDOG_US,
        MAX_WATCHDOG_US
    )]
    Watchdog {
        /// The time, microseconds.
        watchdog_us: u16,
    },
    /// No counts per turn.
    #[error("axis {axis} has no encoder counts per turn")]
    Counts {
        /// The axis.
        axis: u8,
    },
    /// Zero, or larger than a torque can be.
    #[error("the torque limit of axis {axis} is {limit_unm} uN m, it must be 1 to {} uN m", i32::MAX)]
    TorqueLimit {
        /// The axis.
        axis: u8,
        /// The limit, micro-newton-metres.
        limit_unm: u32,
    },
}
