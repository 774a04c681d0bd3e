//! Driver for the device link: postcard, COBS and CRC-32 over a serial port (docs/formats.md, section 7). The
//! mechanism has three axes.
//!
//! ```text
//! open      Hello -> HelloAck: session, limits            blocks, before the loop
//! exchange  not homed -> Home; force requested -> Enable; then Command        State -> sample
//! fault     reported by the device, unexpected disable, silence -> latched until reset(): Hello, new session
//! ```
//!
//! An exchange never waits. It reads what has arrived, and sends the next request after the last one was
//! answered or timed out. Replies have sequence numbers: the time stamp of a sample is the send time of its
//! own request.
//!
//! A force is requested only after the user has armed, so the first force of a session sends Enable. If a
//! device was enabled and no longer is (it restarted, or another process sent Disable), this is a fault.
//! [`Device::reset`], by the user, starts a new session.

mod counter;
mod opening;
mod slew;
mod stopping;

pub use opening::LinkError;

use super::capstan::Capstan;
use super::fence::{Fence, GuardPath};
use super::in_flight::{InFlight, Numbered, REPLY_TIMEOUT_US};
use super::nonblocking_port::Port;
use super::profile::Profile;
use super::serial::{MAX_READS, read_waiting};
use super::workspace::Workspace;
use super::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState};
use core::fmt;
use core::sync::atomic::AtomicBool;
use counter::Counter;
use palpate_core::{Sample, Vec3, clamp_force, vec3};
use palpate_link::message::{ENABLED, HOMED, HOMING, REFUSED};
use palpate_link::{DeviceFault, DeviceInfo as LinkInfo, DeviceMessage, FrameReader, HostMessage, VERSION};
use slew::SlewLimiter;
use std::time::Duration;
use stopping::write;

/// Validity of a torque without another command, us; limited by the watchdog's time.
///
/// While samples are missing the loop holds its force for three ticks, so the last request with this force is
/// sent 5 ms after the last one that arrived. If the torque ended before that, it would return in one step.
const VALID_FOR_US: u16 = 7_000;
/// Silence after which a device that is not enabled counts as restarted, us. An enabled device latches its
/// watchdog sooner.
const SILENCE_LIMIT_US: u64 = 250_000;
/// Pause between two Hello messages, us.
const HELLO_PAUSE_US: u64 = 10_000;

/// Settings of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkConfig {
    /// Placement of the device's workspace in the model.
    pub workspace: Workspace,
    /// The mechanism.
    pub capstan: Capstan,
    /// Largest force, N; the device's torque limits may reduce it.
    pub max_force_n: f32,
    /// Largest stiffness that may be rendered, N/m in device metres: the cap of its profile.
    pub max_stiffness_n_m: f32,
    /// Timeout for opening a session.
    pub open_timeout: Duration,
}

impl LinkConfig {
    /// The configuration from a profile; `None` if the profile states no mechanism.
    #[must_use]
    pub fn of(profile: &Profile, open_timeout: Duration) -> Option<Self> {
        Some(Self {
            workspace: profile.workspace,
            capstan: profile.capstan?,
            max_force_n: profile.max_force_n,
            max_stiffness_n_m: profile.cap().n_m,
            open_timeout,
        })
    }
}

/// Reason why the session is ended until a reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkFault {
    /// The device reported a fault.
    Device(DeviceFault),
    /// The device was enabled and no longer is.
    Disabled,
    /// No reply in this session for twice the watchdog's time while enabled, or for a quarter of a second:
    /// the device may have restarted.
    Silent,
}

impl fmt::Display for LinkFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(fault) => write!(f, "the device has latched `{}`", fault.name()),
            Self::Disabled => {
                f.write_str("the device is no longer enabled: it was disabled or has restarted")
            }
            Self::Silent => f.write_str("no reply in this session: the device may have restarted"),
        }
    }
}

/// State of the homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    Unknown,
    /// Not homed, and not homing.
    Unhomed,
    Searching,
    Homed,
}

/// The device behind an open port.
pub struct Link {
    port: Box<dyn Port>,
    config: LinkConfig,
    /// Description of the device, from its HelloAck.
    device: LinkInfo,
    reader: FrameReader<DeviceMessage>,
    /// The last session; the guard sends Disable for it.
    session: u32,
    /// Whether a new session is being requested, with this nonce.
    opening_session: bool,
    nonce: u32,
    hello_sent_us: Option<u64>,
    requests: Numbered,
    homing: Homing,
    enabled: bool,
    latched: Option<LinkFault>,
    /// Whether the latched fault has not yet been reported to the loop.
    unreported: bool,
    counter: Counter,
    slew: SlewLimiter,
    /// Whether the motors may have a torque.
    rendering: bool,
    lost: bool,
    fence: Fence,
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Link")
            .field("config", &self.config)
            .field("device", &self.device)
            .finish_non_exhaustive()
    }
}

/// Result of reading the port.
#[derive(Debug, Clone, Copy, Default)]
struct Received {
    sample: Option<Sample>,
    damaged: bool,
}

impl Link {
    /// The device's description of itself.
    #[must_use]
    pub const fn device(&self) -> &LinkInfo {
        &self.device
    }

    /// The fault that ended the session, until a reset.
    #[must_use]
    pub const fn fault(&self) -> Option<LinkFault> {
        self.latched
    }

    /// Reads the bytes that have arrived.
    fn receive(&mut self, now_us: u64) -> Result<Received, DeviceError> {
        let mut received = Received::default();
        let mut chunk = [0; 256];
        for _ in 0..MAX_READS {
            let count = read_waiting(&mut *self.port, &mut chunk)?;
            if count == 0 {
                break;
            }
            let mut bytes = &chunk[..count];
            while let Some(outcome) = self.reader.read(&mut bytes) {
                match outcome {
                    Ok(message) => received.sample = self.process(now_us, &message)?.or(received.sample),
                    Err(_) => received.damaged = true,
                }
            }
        }
        Ok(received)
    }

    /// Processes one message of the device and returns its sample, if it has one.
    fn process(&mut self, now_us: u64, message: &DeviceMessage) -> Result<Option<Sample>, DeviceError> {
        match *message {
            DeviceMessage::HelloAck { version, nonce, session, info } => {
                if self.opening_session && nonce == self.nonce {
                    if info != self.device || version != VERSION || session == 0 {
                        // Another device on the same port: its limits were not checked.
                        return Err(DeviceError::new(DeviceErrorKind::Disconnected));
                    }
                    self.begin(session);
                }
                Ok(None)
            }
            // A message before the reply to Hello belongs to an ended session.
            _ if self.opening_session || self.latched.is_some() => Ok(None),
            DeviceMessage::Fault { code } => {
                if code == DeviceFault::HomeLost {
                    self.homing = Homing::Unhomed;
                }
                self.latch(LinkFault::Device(code));
                Ok(None)
            }
            DeviceMessage::State { seq_echo, encoders, buttons, flags, .. } => {
                // The first reply with the enabled flag answers Enable, which had no torque. Out-of-order
                // replies count as well.
                if let (true, 0, Some(sent_us)) =
                    (self.enabled, flags & REFUSED, self.requests.sent_us(seq_echo))
                {
                    self.slew.acknowledged(sent_us);
                }
                let Some(t_us) = self.requests.answered(now_us, seq_echo) else { return Ok(None) };
                self.update_flags(flags);
                if self.homing != Homing::Homed || self.latched.is_some() {
                    return Ok(None);
                }
                let counts = self.counter.update(encoders);
                let device_m = self.config.capstan.position_m(counts, self.device.counts_per_turn);
                let position_m = self.config.workspace.to_model_m(device_m);
                Ok(Some(Sample { t_us, position_m, buttons: u32::from(buttons), ..Sample::default() }))
            }
        }
    }

    /// Begins a session in which the motors are disabled.
    fn begin(&mut self, session: u32) {
        self.session = session;
        self.renew_zero_message();
        self.opening_session = false;
        self.requests = self.requests.next_session();
        self.slew = SlewLimiter::default();
        (self.enabled, self.rendering) = (false, false);
    }

    /// Validity of a torque without another command, us.
    fn valid_for_us(&self) -> u16 {
        VALID_FOR_US.min(self.device.watchdog_us)
    }

    /// Longest silence allowed, us. An enabled device that receives no request for its watchdog's time
    /// latches a fault; a device whose replies are lost must be disabled.
    fn silence_limit_us(&self) -> u64 {
        if self.enabled { 2 * u64::from(self.device.watchdog_us) } else { SILENCE_LIMIT_US }
    }

    /// Processes the device's flags.
    fn update_flags(&mut self, flags: u8) {
        let homing = match (flags & HOMED != 0, flags & HOMING != 0) {
            (_, true) => Homing::Searching,
            (true, false) => Homing::Homed,
            (false, false) => Homing::Unhomed,
        };
        if homing != self.homing {
            // Homing resets the counts.
            self.homing = homing;
            self.counter.restart();
        }
        let enabled = flags & ENABLED != 0;
        if self.enabled && !enabled {
            self.latch(LinkFault::Disabled);
        }
        self.enabled = enabled;
    }

    /// Ends the session with Disable. If the message is lost, the device's watchdog stops it.
    fn latch(&mut self, fault: LinkFault) {
        if self.latched.is_none() {
            (self.latched, self.unreported) = (Some(fault), true);
            self.disable();
        }
    }

    /// Sends the next request, if it is due.
    fn send_request(&mut self, now_us: u64, device_n: Vec3) -> Result<(), DeviceError> {
        if self.latched.is_some() {
            return Ok(());
        }
        if self.opening_session {
            if self.hello_sent_us.is_none_or(|us| now_us.saturating_sub(us) >= HELLO_PAUSE_US) {
                self.hello_sent_us = Some(now_us);
                self.nonce = self.nonce.wrapping_add(1);
                return write(&mut *self.port, &HostMessage::Hello { version: VERSION, nonce: self.nonce });
            }
            return Ok(());
        }
        // The last look before the write: this process may have been stopped since the tick began.
        let forced = device_n != vec3::ZERO && self.homing == Homing::Homed && !self.fence.is_closed();
        // A release never waits for a reply: a fault ends in zero force, whatever the state of the link.
        let release = self.rendering && !forced;
        if !release && !self.requests.may_send(now_us) {
            return Ok(());
        }
        let (session, seq) = (self.session, self.requests.number(now_us));
        let mut torque_unm = [0; 3];
        let message = match self.homing {
            Homing::Unhomed => HostMessage::Home { session, seq },
            Homing::Homed if forced && !self.enabled => HostMessage::Enable { session, seq },
            _ => {
                if forced {
                    let device_n = self.slew.limit(now_us, device_n, self.valid_for_us());
                    torque_unm = self.config.capstan.torque_unm(device_n, self.device.torque_limit_unm);
                }
                HostMessage::Command {
                    session,
                    seq,
                    t_host_us: now_us as u32,
                    torque_unm,
                    valid_for_us: self.valid_for_us(),
                }
            }
        };
        let sent = write(&mut *self.port, &message);
        // A failed write may have transmitted a torque, so the flag stays set.
        self.rendering = torque_unm != [0; 3] || (self.rendering && sent.is_err());
        sent
    }

    fn exchange_frames(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let received = self.receive(now_us)?;
        if !self.opening_session
            && self.latched.is_none()
            && self.requests.silent_us(now_us) >= self.silence_limit_us()
        {
            self.latch(LinkFault::Silent);
        }
        let overdue = if self.opening_session {
            self.hello_sent_us.is_some_and(|us| now_us.saturating_sub(us) >= REPLY_TIMEOUT_US)
        } else {
            self.requests.is_overdue(now_us)
        };
        // Clamp the vector. A value that is not finite gives zero.
        let device_n = self.config.workspace.to_device_n(hand_force_n);
        let (device_n, _) = clamp_force(device_n, self.config.max_force_n);
        self.send_request(now_us, device_n)?;
        match (received.sample, self.latched) {
            (Some(sample), _) => Ok(Some(sample)),
            (None, Some(LinkFault::Device(code))) => Err(DeviceError::new(DeviceErrorKind::Faulted(code))),
            (None, Some(LinkFault::Disabled | LinkFault::Silent)) => {
                Err(DeviceError::new(DeviceErrorKind::Timeout))
            }
            (None, None) if received.damaged => Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            (None, None) if overdue => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            (None, None) => Ok(None),
        }
    }
}

impl Device for Link {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        if self.lost {
            return Err(DeviceError::new(DeviceErrorKind::Disconnected));
        }
        let result = self.exchange_frames(now_us, hand_force_n).map_err(|error| match error.kind() {
            // The crate does not pass on the OS code. On an open port an unnamed error means that the device
            // is disconnected.
            DeviceErrorKind::Io => DeviceError { kind: DeviceErrorKind::Disconnected, ..error },
            _ => error,
        });
        self.lost = result.is_err_and(|error| !error.kind().is_transient());
        result
    }

    fn stop(&mut self) {
        self.disable_twice();
    }

    fn info(&self) -> DeviceInfo {
        let LinkInfo { serial, firmware, torque_limit_unm, counts_per_turn, .. } = self.device;
        let port = self.port.name().unwrap_or_else(|| "a serial port".into());
        let LinkConfig { capstan, workspace, max_force_n, max_stiffness_n_m, .. } = self.config;
        DeviceInfo {
            name: format!("device link {serial}, firmware {firmware}, on {port}"),
            self_arming: false,
            max_force_n: max_force_n.min(capstan.max_force_n(torque_limit_unm)),
            max_stiffness_n_m: max_stiffness_n_m / workspace.scale,
            resolution_m: capstan.resolution_m(counts_per_turn) * workspace.scale,
        }
    }

    fn state(&self) -> DeviceState {
        match self.homing {
            _ if self.lost => DeviceState::Disconnected,
            Homing::Unknown => DeviceState::FirmwareLoaded,
            Homing::Unhomed | Homing::Searching => DeviceState::Unhomed,
            Homing::Homed => DeviceState::Homed,
        }
    }

    fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        self.wait_homed(stop)
    }

    fn guard_path(&mut self, fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        self.guarded_by(fence)
    }

    fn was_zeroed(&mut self) -> bool {
        core::mem::take(&mut self.unreported)
    }

    fn reset(&mut self) -> bool {
        self.latched = None;
        self.opening_session = true;
        true
    }
}
