//! Driver for the device link: postcard, COBS and CRC-32 over a serial port (docs/formats.md, section 7), for a mechanism of three axes.
//!
//! ```text
//! open      Hello -> HelloAck: session, limits            blocks, before the loop
//! exchange  not homed -> Home; a force is asked for -> Enable; then Command        State -> sample
//! fault     the device's, or it no longer obeys, or silence -> latched, nothing but reset() goes on: Hello, a new session, disabled
//! ```
//!
//! An exchange never waits. It reads what has come, and sends the next request once the last one was answered or given up. Answers have
//! numbers: a sample is stamped with the time its own request was sent.
//!
//! A force is asked for only after the user has armed, so the first force of a session is what sends Enable. A device that obeyed and no
//! longer does (it started anew, or somebody sent Disable) is a fault. [`Device::reset`], the user's, begins a new session.

mod capstan;
mod opening;
mod requests;
mod rise;
mod stopping;

pub use capstan::Capstan;
pub use opening::LinkError;

use super::profile::Profile;
use super::serial::{MOST_READS, read_waiting};
use super::workspace::Workspace;
use super::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState, EmergencyStop};
use capstan::Counter;
use core::fmt;
use core::sync::atomic::{AtomicU32, Ordering};
use palpate_core::link::message::{ENABLED, HOMED, HOMING, REFUSED};
use palpate_core::link::{self, DeviceFault, DeviceMessage, FrameReader, HostMessage, VERSION};
use palpate_core::{Sample, Vec3, limit, vec3};
use requests::{REPLY_TIMEOUT_US, Requests};
use rise::Rise;
use serialport::SerialPort;
use std::sync::Arc;
use std::time::Duration;
use stopping::{SecondHandle, write};

/// How long a torque acts without another command, us, where the watchdog waits as long.
///
/// While requests are lost the loop holds its force for three ticks, and the last request with it goes 5 ms after the last one that came through. A
/// torque that had ended by then would come back with it in one step.
const VALID_FOR_US: u16 = 7_000;
/// Silence after which a device that does not obey is taken to have started anew, us. One that obeys has latched its watchdog sooner.
const LOST_US: u64 = 250_000;
/// Pause between two Hello, us.
const HELLO_PAUSE_US: u64 = 10_000;

/// How to use the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkConfig {
    /// Where the device's workspace lies in the model.
    pub workspace: Workspace,
    /// The mechanism.
    pub capstan: Capstan,
    /// Largest force, N; the device's torque limits may make it less.
    pub max_force_n: f32,
    /// Largest stiffness that may be rendered, N/m of the device: the cap of its profile.
    pub max_stiffness_n_m: f32,
    /// How long to try to open a session.
    pub patience: Duration,
}

impl LinkConfig {
    /// As a profile states it; `None` if it states no mechanism.
    #[must_use]
    pub fn of(profile: &Profile, patience: Duration) -> Option<Self> {
        Some(Self {
            workspace: profile.workspace,
            capstan: profile.capstan?,
            max_force_n: profile.max_force_n,
            max_stiffness_n_m: profile.cap().n_m,
            patience,
        })
    }
}

/// Why the driver has given up a session until it is reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkFault {
    /// The device says so.
    Device(DeviceFault),
    /// It obeyed, and does not any more.
    Disabled,
    /// No answer in this session for twice the watchdog's time while it obeyed, or for a quarter of a second: it may have started anew.
    Silent,
}

impl fmt::Display for LinkFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(fault) => write!(f, "the device has latched `{}`", fault.name()),
            Self::Disabled => f.write_str("the device no longer obeys: it was disabled or started anew"),
            Self::Silent => f.write_str("no answer in this session: the device may have started anew"),
        }
    }
}

/// What is known of the axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    Unknown,
    /// It is not looking for home either.
    Unhomed,
    Searching,
    Homed,
}

/// The device behind an open port.
pub struct Link {
    port: Box<dyn SerialPort>,
    config: LinkConfig,
    /// What the device is.
    device: link::DeviceInfo,
    reader: FrameReader<DeviceMessage>,
    /// The last session; the second handle disables it.
    session: Arc<AtomicU32>,
    /// A new one is asked for with this nonce.
    greeting: bool,
    nonce: u32,
    greeted_us: Option<u64>,
    requests: Requests,
    homing: Homing,
    enabled: bool,
    latched: Option<LinkFault>,
    /// The loop has not been told of it.
    untold: bool,
    counter: Counter,
    rise: Rise,
    /// The motors may have a torque of ours.
    rendering: bool,
    lost: bool,
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Link")
            .field("config", &self.config)
            .field("device", &self.device)
            .finish_non_exhaustive()
    }
}

/// What one look at the port brought.
#[derive(Debug, Clone, Copy, Default)]
struct Received {
    sample: Option<Sample>,
    damaged: bool,
}

impl Link {
    /// What the device says it is.
    #[must_use]
    pub const fn device(&self) -> &link::DeviceInfo {
        &self.device
    }

    /// What has ended the session, until it is reset.
    #[must_use]
    pub const fn fault(&self) -> Option<LinkFault> {
        self.latched
    }

    fn session(&self) -> u32 {
        self.session.load(Ordering::Acquire)
    }

    /// Reads what is there.
    fn receive(&mut self, now_us: u64) -> Result<Received, DeviceError> {
        let mut received = Received::default();
        let mut chunk = [0; 256];
        for _ in 0..MOST_READS {
            let count = read_waiting(&mut *self.port, &mut chunk)?;
            if count == 0 {
                break;
            }
            let mut bytes = &chunk[..count];
            while let Some(outcome) = self.reader.read(&mut bytes) {
                match outcome {
                    Ok(message) => received.sample = self.take(now_us, &message)?.or(received.sample),
                    Err(_) => received.damaged = true,
                }
            }
        }
        Ok(received)
    }

    /// One message of the device; the sample that is in it.
    fn take(&mut self, now_us: u64, message: &DeviceMessage) -> Result<Option<Sample>, DeviceError> {
        match *message {
            DeviceMessage::HelloAck { version, nonce, session, info } => {
                if self.greeting && nonce == self.nonce {
                    if info != self.device || version != VERSION || session == 0 {
                        // Another one on the same port: its limits were never looked at.
                        return Err(DeviceError::new(DeviceErrorKind::Disconnected));
                    }
                    self.begin(session);
                }
                Ok(None)
            }
            // What comes before the answer to Hello belongs to a session that is over.
            _ if self.greeting || self.latched.is_some() => Ok(None),
            DeviceMessage::Fault { code } => {
                if code == DeviceFault::HomeLost {
                    self.homing = Homing::Unhomed;
                }
                self.latch(LinkFault::Device(code));
                Ok(None)
            }
            DeviceMessage::State { seq_echo, encoders, buttons, flags, .. } => {
                // The answer to Enable is the first that says so, and was no torque. One that was overtaken tells as well.
                if let (true, 0, Some(sent_us)) =
                    (self.enabled, flags & REFUSED, self.requests.sent_us(seq_echo))
                {
                    self.rise.acted(sent_us);
                }
                let Some(t_us) = self.requests.answered(now_us, seq_echo) else { return Ok(None) };
                self.note(flags);
                if self.homing != Homing::Homed || self.latched.is_some() {
                    return Ok(None);
                }
                let counts = self.counter.take(encoders);
                let device_m = self.config.capstan.position_m(counts, self.device.counts_per_turn);
                let position_m = self.config.workspace.to_model_m(device_m);
                Ok(Some(Sample { t_us, position_m, buttons: u32::from(buttons) }))
            }
        }
    }

    /// A session, in which nothing is enabled.
    fn begin(&mut self, session: u32) {
        self.session.store(session, Ordering::Release);
        self.greeting = false;
        self.requests = self.requests.next_session();
        self.rise = Rise::default();
        (self.enabled, self.rendering) = (false, false);
    }

    /// How long a torque acts without another command, us.
    fn valid_for_us(&self) -> u16 {
        VALID_FOR_US.min(self.device.watchdog_us)
    }

    /// How long nothing may come, us. A device that obeys and had no request for the time of its watchdog has latched that; one whose answers
    /// are lost is to be disabled.
    fn patience_us(&self) -> u64 {
        if self.enabled { 2 * u64::from(self.device.watchdog_us) } else { LOST_US }
    }

    /// What the device says of itself.
    fn note(&mut self, flags: u8) {
        let homing = match (flags & HOMED != 0, flags & HOMING != 0) {
            (_, true) => Homing::Searching,
            (true, false) => Homing::Homed,
            (false, false) => Homing::Unhomed,
        };
        if homing != self.homing {
            // Homing sets the counts anew.
            self.homing = homing;
            self.counter.restart();
        }
        let enabled = flags & ENABLED != 0;
        if self.enabled && !enabled {
            self.latch(LinkFault::Disabled);
        }
        self.enabled = enabled;
    }

    /// Gives the session up. What the device may still do ends with a Disable, and with its watchdog if that is lost.
    fn latch(&mut self, fault: LinkFault) {
        if self.latched.is_none() {
            (self.latched, self.untold) = (Some(fault), true);
            self.disable();
        }
    }

    /// The next request, if it is time for one.
    fn speak(&mut self, now_us: u64, device_n: Vec3) -> Result<(), DeviceError> {
        if self.latched.is_some() {
            return Ok(());
        }
        if self.greeting {
            if self.greeted_us.is_none_or(|us| now_us.saturating_sub(us) >= HELLO_PAUSE_US) {
                self.greeted_us = Some(now_us);
                self.nonce = self.nonce.wrapping_add(1);
                return write(&mut *self.port, &HostMessage::Hello { version: VERSION, nonce: self.nonce });
            }
            return Ok(());
        }
        let forced = device_n != vec3::ZERO && self.homing == Homing::Homed;
        // Taking a force away never waits for an answer: a fault ends in zero whatever the link does.
        let release = self.rendering && !forced;
        if !release && !self.requests.may_send(now_us) {
            return Ok(());
        }
        let (session, seq) = (self.session(), self.requests.number(now_us));
        let mut torque_unm = [0; 3];
        let message = match self.homing {
            Homing::Unhomed => HostMessage::Home { session, seq },
            Homing::Homed if forced && !self.enabled => HostMessage::Enable { session, seq },
            _ => {
                if forced {
                    let device_n = self.rise.limit(now_us, device_n, self.valid_for_us());
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
        // What may have gone is taken away again.
        self.rendering = torque_unm != [0; 3] || (self.rendering && sent.is_err());
        sent
    }

    fn exchange_frames(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let received = self.receive(now_us)?;
        if !self.greeting && self.latched.is_none() && self.requests.silent_us(now_us) >= self.patience_us() {
            self.latch(LinkFault::Silent);
        }
        let overdue = if self.greeting {
            self.greeted_us.is_some_and(|us| now_us.saturating_sub(us) >= REPLY_TIMEOUT_US)
        } else {
            self.requests.is_overdue(now_us)
        };
        // On the vector, whoever asks. What is no number is no force.
        let device_n = self.config.workspace.to_device_n(hand_force_n);
        let (device_n, _) = limit::clamp_force(device_n, self.config.max_force_n);
        self.speak(now_us, device_n)?;
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
            // The crate does not pass the OS code on; on a port that was open an unnamed error means that it is gone.
            DeviceErrorKind::Io => DeviceError { kind: DeviceErrorKind::Disconnected, ..error },
            _ => error,
        });
        self.lost = result.is_err_and(|error| !error.kind().is_passing());
        result
    }

    fn stop(&mut self) {
        self.disable_twice();
    }

    fn info(&self) -> DeviceInfo {
        let link::DeviceInfo { serial, firmware, torque_limit_unm, counts_per_turn, .. } = self.device;
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

    fn emergency_stop(&mut self) -> Option<Box<dyn EmergencyStop>> {
        Some(Box::new(SecondHandle::of(self)?))
    }

    fn was_zeroed(&mut self) -> bool {
        core::mem::take(&mut self.untold)
    }

    fn reset(&mut self) {
        self.latched = None;
        self.greeting = true;
    }
}
