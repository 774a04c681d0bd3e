//! The messages of the device link, version 1.
//!
//! ```text
//! host                            device
//! Hello{version, nonce}        -> HelloAck{version, nonce, session, info}
//! Home, Enable, Disable        -> State{seq_echo, encoders, flags}, or Fault{code}
//! Command{seq, torque}         -> State{seq_echo, encoders, flags}, or Fault{code}
//! ```
//!
//! The host asks, the device answers, once for each request. What moves the device from one state to another is in
//! [`super::device`].
//!
//! Every message after the handshake has the session and a number that only grows, so that nothing acts twice: not a repeated
//! frame, not one of an earlier session. The answer names the number, so that the host knows what it answers.

use core::fmt;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::fixed;

/// Version of the protocol. `Hello` and the first two fields of `HelloAck` are the same in all versions, so that two ends of
/// different age can tell each other.
pub const VERSION: u16 = 1;

/// Shortest watchdog a device may have, microseconds: below, the jitter of an ordinary PC trips it.
pub const MIN_WATCHDOG_US: u16 = 5_000;
/// Longest watchdog a device may have, microseconds: longer, and a hand feels a dead host push.
pub const MAX_WATCHDOG_US: u16 = 20_000;

/// Bytes of the longest message, a `HelloAck`.
pub const MAX_MESSAGE: usize = 46;

/// [`DeviceMessage::State`] flag: the mechanism knows where it is.
pub const HOMED: u8 = 1;
/// [`DeviceMessage::State`] flag: looking for home.
pub const HOMING: u8 = 2;
/// [`DeviceMessage::State`] flag: commands act.
pub const ENABLED: u8 = 4;
/// [`DeviceMessage::State`] flag: what was asked for was not done: not enabled, not homed, an old number, or too late.
pub const REFUSED: u8 = 8;
/// [`DeviceMessage::State`] flag: the torque was beyond a limit and has been shortened.
pub const CLAMPED: u8 = 16;

/// What one end says to the other.
pub trait Message: Serialize + DeserializeOwned {
    /// Bytes in postcard; a kind has always the same number.
    ///
    /// Whoever reads it holds the frame to that. The tags of kinds and faults are varints, and postcard reads those with zeros
    /// behind them as well (`80 00` for `00`); a frame that is longer than its message says is none.
    fn encoded_len(&self) -> usize;
}

/// What a host says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum HostMessage {
    /// Opens a session; ends the one before. Clears a latched fault, but enables nothing.
    Hello {
        /// [`VERSION`] of the host.
        #[serde(with = "fixed")]
        version: u16,
        /// Any number, another one each time: the answer repeats it.
        #[serde(with = "fixed")]
        nonce: u32,
    },
    /// Lets commands act. The host sends it for a deliberate act of its user only.
    Enable {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Number of this request.
        #[serde(with = "fixed")]
        seq: u32,
    },
    /// Takes the torque away. Obeyed even with an old number.
    Disable {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Number of this request.
        #[serde(with = "fixed")]
        seq: u32,
    },
    /// Starts the homing procedure. Takes the torque away.
    Home {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Number of this request.
        #[serde(with = "fixed")]
        seq: u32,
    },
    /// The torque from now on. Where the device is not enabled, a question for its state.
    Command {
        /// Session of the `HelloAck`.
        #[serde(with = "fixed")]
        session: u32,
        /// Number of this request.
        #[serde(with = "fixed")]
        seq: u32,
        /// When it was sent, on any clock of the host, microseconds; wraps round.
        #[serde(with = "fixed")]
        t_host_us: u32,
        /// Torque of each axis, micro-newton-metres.
        #[serde(with = "fixed")]
        torque_unm: [i32; 3],
        /// How long it acts at most; 0 is not at all. Two bytes: no torque lasts longer than a watchdog anyway.
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

/// What a device answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceMessage {
    /// To `Hello`: the session, and what the device is.
    HelloAck {
        /// [`VERSION`] of the device.
        #[serde(with = "fixed")]
        version: u16,
        /// That of the `Hello`.
        #[serde(with = "fixed")]
        nonce: u32,
        /// The new session; 0: none, the versions differ.
        #[serde(with = "fixed")]
        session: u32,
        /// What the device is.
        info: DeviceInfo,
    },
    /// Where the device is.
    State {
        /// Newest number of this session that the device has seen; 0: none yet.
        #[serde(with = "fixed")]
        seq_echo: u32,
        /// When the encoders were read, on the device's clock, microseconds; wraps round.
        #[serde(with = "fixed")]
        t_dev_us: u32,
        /// Encoder counts of each axis; they wrap round.
        #[serde(with = "fixed")]
        encoders: [i32; 3],
        /// One bit per button, 1 while pressed.
        buttons: u8,
        /// [`HOMED`], [`HOMING`], [`ENABLED`], [`REFUSED`], [`CLAMPED`].
        flags: u8,
    },
    /// Torque zero until the next `Hello` and `Enable`.
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

/// Why a device took the torque away for good.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DeviceFault {
    /// Enabled, and no command that may act for as long as the watchdog waits.
    Watchdog,
    /// The device's clock ran backwards.
    Clock,
    /// An axis moved faster than its profile allows, or its encoder jumped.
    Overspeed,
    /// Enabled, and the mechanism no longer knows where it is.
    HomeLost,
    /// The hardware reports a fault of its own: driver too hot, emergency stop.
    Hardware,
}

impl DeviceFault {
    /// All of them, by their code on the wire.
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

/// What a device tells of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceInfo {
    /// Axes, 1 to 3; what is said of further ones means nothing.
    pub dof: u8,
    /// Encoder counts for one turn of each axis.
    #[serde(with = "fixed")]
    pub counts_per_turn: [u32; 3],
    /// Largest torque of each axis, micro-newton-metres.
    #[serde(with = "fixed")]
    pub torque_limit_unm: [u32; 3],
    /// Silence that is a fault while enabled, microseconds.
    #[serde(with = "fixed")]
    pub watchdog_us: u16,
    /// Which device.
    #[serde(with = "fixed")]
    pub serial: u32,
    /// Which firmware; the maker's own count.
    #[serde(with = "fixed")]
    pub firmware: u32,
}

impl DeviceInfo {
    /// Whether these numbers can be worked with. A device does not start with others, a host does not enable one that has them.
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

    /// Number, counts and torque limit of each axis that there is.
    fn axes(&self) -> impl Iterator<Item = (u8, u32, u32)> {
        let axes = (0..self.dof).zip(self.counts_per_turn).zip(self.torque_limit_unm);
        axes.map(|((axis, counts), limit_unm)| (axis, counts, limit_unm))
    }
}

/// What is wrong with a [`DeviceInfo`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InfoError {
    /// Neither 1, 2 nor 3 axes.
    Dof {
        /// How many.
        dof: u8,
    },
    /// Not between [`MIN_WATCHDOG_US`] and [`MAX_WATCHDOG_US`].
    Watchdog {
        /// How long.
        watchdog_us: u16,
    },
    /// No counts in a turn.
    Counts {
        /// Of which axis.
        axis: u8,
    },
    /// Zero, or more than a torque can be.
    TorqueLimit {
        /// Of which axis.
        axis: u8,
        /// The limit.
        limit_unm: u32,
    },
}

impl fmt::Display for InfoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Dof { dof } => write!(f, "a device has 1 to 3 axes, this one has {dof}"),
            Self::Watchdog { watchdog_us } => write!(
                f,
                "the watchdog of a device is {MIN_WATCHDOG_US} to {MAX_WATCHDOG_US} us, this one has {watchdog_us} us"
            ),
            Self::Counts { axis } => write!(f, "axis {axis} has no encoder counts in a turn"),
            Self::TorqueLimit { axis, limit_unm } => {
                write!(
                    f,
                    "the torque limit of axis {axis} is {limit_unm} uN m, it must be 1 to {} uN m",
                    i32::MAX
                )
            }
        }
    }
}

impl core::error::Error for InfoError {}
