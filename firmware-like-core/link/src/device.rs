//! The device's side of the link: when a torque may act on the motors.
//!
//! ```text
//!     Idle     -- Hello ------------------> Linked
//!     Linked   -- Home -------------------> Homing
//!     Linked   -- Enable, while homed ----> Enabled
//!     Homing   -- homed, or Disable ------> Linked
//!     Enabled  -- Disable ----------------> Linked
//!     Enabled  -- Home -------------------> Homing
//!     any      -- fault ------------------> Faulted
//!     any      -- Hello ------------------> Linked, in a new session
//!     any but Faulted -- Hello of another version --> Idle
//! ```
//!
//! The torque is zero except in Enabled. There it is the torque of the newest command while that command is
//! valid. The rules:
//!
//! - A command has an effect if the device is enabled, the session is the current one, the sequence number is
//!   newer than all previous ones, and the lateness of the command is less than its validity.
//! - In Enabled it is a fault if no such command arrives within the watchdog time. A command without effect
//!   does not reset the watchdog.
//! - A fault is latched; later faults do not replace it. `Hello` clears it and leaves the device disabled, so
//!   nothing moves before a complete handshake and `Enable`. No message only clears a fault: a host that has
//!   not received the fault must not be able to continue.
//! - Messages of other sessions are not answered: their sender is gone, and the answer could be matched to
//!   another request.
//!
//! The firmware calls [`Device::step`] in its control loop, a few thousand times per second, and
//! [`Device::receive`] for each message. Both take the time of the firmware's clock. The emulated device of
//! the tests makes the same calls with a simulated clock.

use super::guard::{Delay, SpeedWatch, clamp_torque, is_newer};
use super::message::{
    CLAMPED, DeviceFault, DeviceInfo, DeviceMessage, ENABLED, HOMED, HOMING, HostMessage, InfoError, REFUSED,
    VERSION,
};

/// Constants of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceProfile {
    /// The properties that the host receives in the handshake.
    pub info: DeviceInfo,
    /// Speed of an axis above which an enabled device faults, counts per second; at least 1000.
    pub max_speed_counts_per_s: u32,
    /// A number that differs between starts of the firmware, if the hardware provides one, so that sessions
    /// do not repeat.
    pub boot: u32,
}

/// Why a profile was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ProfileError {
    /// The properties are out of range.
    #[error("{0}")]
    Info(InfoError),
    /// Less than one count per millisecond: every motion would be a fault.
    #[error("the largest speed is {max_speed_counts_per_s} counts/s, it must be at least 1000 counts/s")]
    MaxSpeed {
        /// Counts per second.
        max_speed_counts_per_s: u32,
    },
}

/// State of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Phase {
    /// No session.
    Idle,
    /// A session is open; torque zero.
    Linked,
    /// The mechanism is homing; torque zero.
    Homing,
    /// Commands have an effect.
    Enabled,
    /// Torque zero until the next `Hello` and `Enable`.
    Faulted(DeviceFault),
}

/// One reading of the hardware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Inputs {
    /// Counts of each axis; they may wrap.
    pub encoders: [i32; 3],
    /// One bit per button, 1 while pressed.
    pub buttons: u8,
    /// The mechanism is homed.
    pub homed: bool,
    /// The hardware reports a fault: driver temperature, emergency stop.
    pub fault: bool,
}

/// Outputs to the hardware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outputs {
    /// Torque of each axis, micro-newton-metres.
    pub torque_unm: [i32; 3],
    /// Perform the homing procedure, or wait until the user has moved the handle home. From the next reading
    /// on [`Inputs::homed`] refers to this procedure, not to an earlier one.
    pub home: bool,
}

/// A command in effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Held {
    torque_unm: [i32; 3],
    clamped: bool,
    taken_us: u64,
    valid_for_us: u64,
}

/// The state machine. It starts without a session and with zero torque.
#[derive(Debug, Clone, PartialEq)]
pub struct Device {
    profile: DeviceProfile,
    phase: Phase,
    /// The last session opened, or 0.
    session: u32,
    sessions: u32,
    /// Newest sequence number of the session.
    seq: u32,
    now_us: u64,
    inputs: Inputs,
    inputs_us: u64,
    /// The hardware was asked to home, so its next reading refers to this request.
    home_asked: bool,
    held: Option<Held>,
    /// Last reset of the watchdog.
    fed_us: u64,
    lateness: Delay,
    speed: SpeedWatch,
}

impl Device {
    /// A device with checked constants.
    ///
    /// Errors: [`ProfileError`] if a number is out of range.
    pub fn new(profile: DeviceProfile) -> Result<Self, ProfileError> {
        profile.info.check().map_err(ProfileError::Info)?;
        let max_speed_counts_per_s = profile.max_speed_counts_per_s;
        if max_speed_counts_per_s < 1000 {
            return Err(ProfileError::MaxSpeed { max_speed_counts_per_s });
        }
        Ok(Self {
            profile,
            phase: Phase::Idle,
            session: 0,
            sessions: 0,
            seq: 0,
            now_us: 0,
            inputs: Inputs::default(),
            inputs_us: 0,
            home_asked: false,
            held: None,
            fed_us: 0,
            lateness: Delay::new(),
            speed: SpeedWatch::new(),
        })
    }

    /// State of the device.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Processes one reading of the hardware; returns the outputs until the next one.
    pub fn step(&mut self, now_us: u64, inputs: &Inputs) -> Outputs {
        self.advance(now_us);
        self.inputs = *inputs;
        self.inputs_us = now_us;
        if inputs.fault {
            self.fault(DeviceFault::Hardware);
        }
        match self.phase {
            Phase::Enabled if !inputs.homed => self.fault(DeviceFault::HomeLost),
            Phase::Enabled => {
                let DeviceProfile { info, max_speed_counts_per_s, .. } = self.profile;
                if self.speed.is_too_fast(now_us, inputs.encoders, info.dof, max_speed_counts_per_s) {
                    self.fault(DeviceFault::Overspeed);
                }
            }
            // The first reading after the request may precede its effect.
            Phase::Homing if self.home_asked && inputs.homed => self.leave(Phase::Linked),
            Phase::Homing => self.home_asked = true,
            Phase::Idle | Phase::Linked | Phase::Faulted(_) => {}
        }
        if self.phase != Phase::Enabled {
            self.speed.restart(now_us, inputs.encoders);
        }
        let valid = |held: &Held| now_us.saturating_sub(held.taken_us) < held.valid_for_us;
        let torque_unm = self.held.filter(valid).map_or([0; 3], |held| held.torque_unm);
        Outputs { torque_unm, home: self.phase == Phase::Homing }
    }

    /// Processes one message; returns the answer. The torque changes with the next [`Device::step`].
    pub fn receive(&mut self, now_us: u64, message: &HostMessage) -> Option<DeviceMessage> {
        self.advance(now_us);
        let (session, seq) = match *message {
            HostMessage::Hello { version, nonce } => return Some(self.hello(version, nonce)),
            HostMessage::Enable { session, seq }
            | HostMessage::Disable { session, seq }
            | HostMessage::Home { session, seq }
            | HostMessage::Command { session, seq, .. } => (session, seq),
        };
        if self.phase == Phase::Idle || session == 0 || session != self.session {
            return None;
        }
        if let Phase::Faulted(code) = self.phase {
            return Some(DeviceMessage::Fault { code });
        }
        let newer = is_newer(seq, self.seq);
        if newer {
            self.seq = seq;
        }
        let done = match *message {
            // Zero torque is always safe.
            HostMessage::Disable { .. } => {
                self.leave(Phase::Linked);
                true
            }
            HostMessage::Enable { .. } => newer && self.enable(),
            HostMessage::Home { .. } if newer => {
                self.leave(Phase::Homing);
                true
            }
            HostMessage::Command { t_host_us, torque_unm, valid_for_us, .. } if newer => {
                self.command(t_host_us, torque_unm, valid_for_us)
            }
            HostMessage::Hello { .. } | HostMessage::Home { .. } | HostMessage::Command { .. } => false,
        };
        Some(self.state(done))
    }

    /// Advances the clock and checks it and the watchdog.
    fn advance(&mut self, now_us: u64) {
        let backwards = now_us < self.now_us;
        self.now_us = now_us;
        if backwards {
            self.fault(DeviceFault::Clock);
        }
        let silent_us = now_us.saturating_sub(self.fed_us);
        if self.phase == Phase::Enabled && silent_us >= u64::from(self.profile.info.watchdog_us) {
            self.fault(DeviceFault::Watchdog);
        }
    }

    /// Opens a session, or refuses a host of another version; both end the previous session.
    fn hello(&mut self, version: u16, nonce: u32) -> DeviceMessage {
        let mut session = 0;
        if version == VERSION {
            session = self.new_session(nonce);
            self.session = session;
            self.seq = 0;
            self.leave(Phase::Linked);
        } else if !matches!(self.phase, Phase::Faulted(_)) {
            self.leave(Phase::Idle);
        }
        DeviceMessage::HelloAck { version: VERSION, nonce, session, info: self.profile.info }
    }

    /// A session number other than 0 and the last one; it depends on the nonce and on the start of the
    /// firmware. It protects against stray frames, not against attackers.
    fn new_session(&mut self, nonce: u32) -> u32 {
        self.sessions = self.sessions.wrapping_add(1);
        let seed = nonce ^ self.profile.boot.rotate_left(16);
        // The finaliser of MurmurHash3: every bit of the seed affects every bit of the session.
        let mut hash = seed.wrapping_add(self.sessions.wrapping_mul(0x9e37_79b9));
        hash = (hash ^ (hash >> 16)).wrapping_mul(0x85eb_ca6b);
        hash = (hash ^ (hash >> 13)).wrapping_mul(0xc2b2_ae35);
        hash ^= hash >> 16;
        let candidates = [hash, hash.wrapping_add(1), hash.wrapping_add(2)];
        candidates.into_iter().find(|&session| session != 0 && session != self.session).unwrap_or(1)
    }

    /// Returns whether the device is enabled now. A repetition does not reset the watchdog.
    fn enable(&mut self) -> bool {
        if self.phase == Phase::Linked && self.inputs.homed && !self.inputs.fault {
            self.leave(Phase::Enabled);
            self.fed_us = self.now_us;
            self.lateness = Delay::new();
        }
        self.phase == Phase::Enabled
    }

    /// Returns whether the command has an effect.
    fn command(&mut self, t_host_us: u32, torque_unm: [i32; 3], valid_for_us: u16) -> bool {
        if self.phase != Phase::Enabled {
            return false;
        }
        let late_us = self.lateness.judge(self.now_us, t_host_us);
        let left_us = u32::from(valid_for_us).saturating_sub(late_us);
        if left_us == 0 {
            return false;
        }
        let DeviceInfo { dof, torque_limit_unm, .. } = self.profile.info;
        let mut limit_unm = [0; 3];
        for (limit, axis) in limit_unm.iter_mut().zip(torque_limit_unm).take(usize::from(dof)) {
            *limit = axis;
        }
        let (torque_unm, clamped) = clamp_torque(torque_unm, limit_unm);
        let (taken_us, valid_for_us) = (self.now_us, u64::from(left_us));
        self.held = Some(Held { torque_unm, clamped, taken_us, valid_for_us });
        self.fed_us = self.now_us;
        true
    }

    /// Latches a fault, unless one is latched.
    fn fault(&mut self, code: DeviceFault) {
        if !matches!(self.phase, Phase::Faulted(_)) {
            self.leave(Phase::Faulted(code));
        }
    }

    /// Enters a state with zero torque.
    fn leave(&mut self, phase: Phase) {
        self.phase = phase;
        self.held = None;
        self.home_asked = false;
    }

    /// The answer with the state of the device; `done` states whether the request had an effect.
    fn state(&self, done: bool) -> DeviceMessage {
        let flags = [
            (HOMED, self.inputs.homed),
            (HOMING, self.phase == Phase::Homing),
            (ENABLED, self.phase == Phase::Enabled),
            (REFUSED, !done),
            (CLAMPED, self.held.is_some_and(|held| held.clamped)),
        ];
        DeviceMessage::State {
            seq_echo: self.seq,
            t_dev_us: self.inputs_us as u32,
            encoders: self.inputs.encoders,
            buttons: self.inputs.buttons,
            flags: flags.iter().fold(0, |bits, &(flag, set)| if set { bits | flag } else { bits }),
        }
    }
}
