//! Haptic devices behind one small trait: the loop gives a force, the device gives back where the hand is.
//!
//! A device is owned by the haptic thread. [`Device::exchange`] never waits for a reply and never allocates; what can
//! block (opening, homing, waking) happens before the loop, in the constructor.

mod around;
mod buttons;
pub mod falcon;
pub mod hand;
pub mod impedance;
pub mod link;
mod motion;
pub mod motors_off;
pub mod mouse;
pub mod palpation;
mod pending;
pub mod polhem;
pub mod profile;
#[cfg(unix)]
pub mod prompt;
pub mod replay;
pub mod script;
pub mod serial;
pub mod simulated;
pub mod workspace;

pub use around::Around;

use core::fmt;
use palpate_core::link::DeviceFault;
use palpate_core::{Sample, Vec3};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// What went wrong, as far as the caller's decision goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceErrorKind {
    /// No reply in time.
    Timeout,
    /// A reply that is no frame; the driver has resynchronised.
    BadFrame,
    /// The device or its port is gone: open it again.
    Disconnected,
    /// Not permitted, or in use by another process.
    Denied,
    /// Not a device of this kind, or a setting it cannot do.
    Unsupported,
    /// The device has latched a fault: nothing moves before [`Device::reset`].
    Faulted(DeviceFault),
    /// Anything else the operating system says.
    Io,
}

impl DeviceErrorKind {
    /// Whether the next exchange may well succeed.
    #[must_use]
    pub const fn is_passing(self) -> bool {
        matches!(self, Self::Timeout | Self::BadFrame | Self::Faulted(_))
    }

    const fn text(self) -> &'static str {
        match self {
            Self::Timeout => "no reply in time",
            Self::BadFrame => "a damaged frame",
            Self::Disconnected => "the device is gone",
            Self::Denied => "not permitted or in use",
            Self::Unsupported => "not supported by this device",
            Self::Faulted(DeviceFault::Watchdog) => "the device has latched `watchdog`",
            Self::Faulted(DeviceFault::Clock) => "the device has latched `clock`",
            Self::Faulted(DeviceFault::Overspeed) => "the device has latched `overspeed`",
            Self::Faulted(DeviceFault::HomeLost) => "the device has latched `home-lost`",
            Self::Faulted(DeviceFault::Hardware) => "the device has latched `hardware`",
            Self::Io => "input/output error",
        }
    }
}

/// Error of a device: its kind for the decision, the OS code for the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceError {
    kind: DeviceErrorKind,
    os_code: Option<i32>,
}

impl DeviceError {
    /// An error without an OS code.
    #[must_use]
    pub const fn new(kind: DeviceErrorKind) -> Self {
        Self { kind, os_code: None }
    }

    /// An error with the OS code that came with it, if one did.
    pub(crate) const fn with_os_code(kind: DeviceErrorKind, os_code: Option<i32>) -> Self {
        Self { kind, os_code }
    }

    /// What the caller should decide by.
    #[must_use]
    pub const fn kind(&self) -> DeviceErrorKind {
        self.kind
    }

    /// `errno`, where the operating system gave one.
    #[must_use]
    pub const fn os_code(&self) -> Option<i32> {
        self.os_code
    }
}

impl From<std::io::Error> for DeviceError {
    fn from(error: std::io::Error) -> Self {
        use std::io::ErrorKind;
        let kind = match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted => DeviceErrorKind::Timeout,
            ErrorKind::NotFound
            | ErrorKind::BrokenPipe
            | ErrorKind::UnexpectedEof
            | ErrorKind::NotConnected
            | ErrorKind::ConnectionAborted => DeviceErrorKind::Disconnected,
            ErrorKind::PermissionDenied | ErrorKind::ResourceBusy => DeviceErrorKind::Denied,
            ErrorKind::Unsupported | ErrorKind::InvalidInput => DeviceErrorKind::Unsupported,
            // EIO and ENXIO are what a tty says after its cable was pulled.
            _ if matches!(error.raw_os_error(), Some(5 | 6 | 19)) => DeviceErrorKind::Disconnected,
            _ => DeviceErrorKind::Io,
        };
        Self { kind, os_code: error.raw_os_error() }
    }
}

impl fmt::Display for DeviceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.text())?;
        match self.os_code {
            Some(code) => write!(f, " ({})", std::io::Error::from_raw_os_error(code)),
            None => Ok(()),
        }
    }
}

impl core::error::Error for DeviceError {}

/// How far a device is from being usable (DEVICES: Disconnected -> Open -> FirmwareLoaded -> Unhomed -> Homed).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum DeviceState {
    /// Not there.
    Disconnected,
    /// There, but silent until its firmware is loaded.
    Open,
    /// Speaks, but nothing is known of its position.
    FirmwareLoaded,
    /// Waits to be moved to where its coordinates begin.
    Unhomed,
    /// Its position means something: it may be armed. The state of every device that needs none of the others.
    Homed,
}

impl DeviceState {
    /// All of them, in order.
    pub const ALL: [Self; 5] =
        [Self::Disconnected, Self::Open, Self::FirmwareLoaded, Self::Unhomed, Self::Homed];

    /// The name used in logs and recordings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::Open => "open",
            Self::FirmwareLoaded => "firmware-loaded",
            Self::Unhomed => "unhomed",
            Self::Homed => "homed",
        }
    }
}

/// What a device is and can do.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceInfo {
    /// Name for people.
    pub name: String,
    /// Whether it arms itself: only where no real motor can move.
    pub self_arming: bool,
    /// Largest force it renders, N.
    pub max_force_n: f32,
    /// Largest stiffness of the model that it renders stably, N/m: its own, divided by the workspace's scale.
    pub max_stiffness_n_m: f32,
    /// Smallest step of its position, m.
    pub resolution_m: f32,
}

/// A haptic device of the impedance kind: position out, force in.
pub trait Device: Send {
    /// Sends the force for the hand (model frame) and returns the newest sample if one came since the last call.
    ///
    /// Does not wait for a reply: a late one is returned by a later call, and the controller's stale-sample policy
    /// judges the gap. `now_us` is the time of this tick, and what the sample is stamped with.
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError>;

    /// Takes the force away, now. Called on every way out of the loop, also while a panic unwinds: must not panic.
    fn stop(&mut self);

    /// What this device is.
    fn info(&self) -> DeviceInfo;

    /// How far it is. The loop arms nothing before it is homed, and takes the force away when it no longer is.
    fn state(&self) -> DeviceState {
        DeviceState::Homed
    }

    /// A second way to the motors, for the watchdog. Asked for once, before the loop begins.
    ///
    /// `None` for what has no motors, and for a device that cannot be reached past an exchange that hangs.
    fn emergency_stop(&mut self) -> Option<Box<dyn EmergencyStop>> {
        None
    }

    /// Whether something beside the loop (a supervisor, the device itself) has taken the force away since the last call, and will obey no force
    /// before [`Device::reset`]. Asked after every exchange.
    fn was_zeroed(&mut self) -> bool {
        false
    }

    /// The user has reset what was latched, or there was nothing to latch because nothing was armed: forces are meant again.
    fn reset(&mut self) {}
}

/// Takes the force away from another thread than the one that exchanges, and whatever that one is doing.
pub trait EmergencyStop: Send {
    /// Sends zero force, now, without waiting for the device or for its owner.
    fn zero(&mut self) -> Result<(), DeviceError>;
}

/// Between two exchanges while a device is homed.
const HOMING_PAUSE: Duration = Duration::from_millis(1);

/// Exchanges without a force until the user has homed the device, or until `stop`. Before the loop: may block.
fn wait_homed(device: &mut impl Device, stop: &AtomicBool) -> Result<(), DeviceError> {
    let begun = Instant::now();
    while device.state() != DeviceState::Homed && !stop.load(Ordering::Relaxed) {
        match device.exchange(begun.elapsed().as_micros() as u64, [0.0; 3]) {
            Err(error) if !error.kind().is_passing() => return Err(error),
            _ => std::thread::sleep(HOMING_PAUSE),
        }
        if device.was_zeroed() {
            // Nothing is armed yet: there is no force that could come back.
            device.reset();
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn os_errors_keep_their_code_and_find_their_kind() {
        for (code, kind) in [
            (5, DeviceErrorKind::Disconnected),
            (13, DeviceErrorKind::Denied),
            (16, DeviceErrorKind::Denied),
            (19, DeviceErrorKind::Disconnected),
            (28, DeviceErrorKind::Io),
        ] {
            let error = DeviceError::from(std::io::Error::from_raw_os_error(code));
            assert_eq!((error.kind(), error.os_code()), (kind, Some(code)));
        }
        assert!(DeviceErrorKind::Timeout.is_passing() && !DeviceErrorKind::Disconnected.is_passing());
    }
}
