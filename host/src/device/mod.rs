//! Haptic devices behind one small trait: the loop sends a force, the device returns the position of the
//! hand.
//!
//! The haptic thread owns the device. [`Device::exchange`] never waits for a reply and never allocates. Steps
//! that can block (opening, homing, waking) run in the constructor, before the loop.

mod buttons;
pub mod capstan;
pub mod falcon;
pub mod fence;
pub mod hand;
pub mod impedance;
mod in_flight;
pub mod link;
pub mod maker;
pub mod motors_off;
pub mod mouse;
pub mod nonblocking_port;
pub mod palpation;
mod places;
pub mod polhem;
mod position_check;
pub mod profile;
pub mod script;
pub mod serial;
pub mod simulated;
pub mod way;
pub mod workspace;
mod wrapper;

pub use wrapper::DeviceWrapper;

use core::fmt;
use fence::{Fence, GuardPath};
use nix::errno::Errno;
use palpate_core::{Sample, Vec3};
use palpate_link::DeviceFault;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Kind of an error, for the decision of the caller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceErrorKind {
    /// No reply in time.
    Timeout,
    /// A reply that is not a valid frame; the driver has resynchronised.
    BadFrame,
    /// The device or its port is disconnected: open it again.
    Disconnected,
    /// Not permitted.
    Denied,
    /// In use by another program.
    InUse,
    /// Not a device of this kind, or a setting that it does not support.
    Unsupported,
    /// The device has latched a fault: it renders no force before [`Device::reset`].
    Faulted(DeviceFault),
    /// Requests are no longer written, a zero included. The guard writes past the driver.
    Stalled,
    /// The guard of the device has ended: nothing would zero the force if this process were lost.
    GuardLost,
    /// Any other error of the operating system.
    Io,
}

impl DeviceErrorKind {
    /// Whether the error is transient: the next exchange may succeed.
    #[must_use]
    pub const fn is_transient(self) -> bool {
        matches!(self, Self::Timeout | Self::BadFrame | Self::Stalled | Self::Faulted(_))
    }

    const fn text(self) -> &'static str {
        match self {
            Self::Timeout => "no reply in time",
            Self::BadFrame => "a damaged frame",
            Self::Disconnected => "the device is disconnected",
            Self::Denied => "not permitted",
            Self::InUse => "in use by another program",
            Self::Unsupported => "not supported by this device",
            Self::Faulted(DeviceFault::Watchdog) => "the device has latched `watchdog`",
            Self::Faulted(DeviceFault::Clock) => "the device has latched `clock`",
            Self::Faulted(DeviceFault::Overspeed) => "the device has latched `overspeed`",
            Self::Faulted(DeviceFault::HomeLost) => "the device has latched `home-lost`",
            Self::Faulted(DeviceFault::Hardware) => "the device has latched `hardware`",
            Self::Stalled => "requests are no longer written",
            Self::GuardLost => "the guard process has ended",
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

    /// The kind, for the decision of the caller.
    #[must_use]
    pub const fn kind(&self) -> DeviceErrorKind {
        self.kind
    }

    /// `errno`, if the operating system gave one.
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
            ErrorKind::PermissionDenied => DeviceErrorKind::Denied,
            ErrorKind::ResourceBusy => DeviceErrorKind::InUse,
            ErrorKind::Unsupported | ErrorKind::InvalidInput => DeviceErrorKind::Unsupported,
            // A tty reports EIO or ENXIO after its cable was pulled.
            _ if matches!(
                error.raw_os_error().map(Errno::from_raw),
                Some(Errno::EIO | Errno::ENXIO | Errno::ENODEV)
            ) =>
            {
                DeviceErrorKind::Disconnected
            }
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

/// Readiness of a device (Disconnected -> Open -> FirmwareLoaded -> Unhomed -> Homed).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum DeviceState {
    /// Not connected.
    Disconnected,
    /// Connected, but silent until its firmware is loaded.
    Open,
    /// Replies, but its position is unknown.
    FirmwareLoaded,
    /// Waits to be moved to its reference position.
    Unhomed,
    /// Its position is valid and it may be armed. Devices without homing are always in this state.
    Homed,
}

impl DeviceState {
    /// All states, in order.
    pub const ALL: [Self; 5] =
        [Self::Disconnected, Self::Open, Self::FirmwareLoaded, Self::Unhomed, Self::Homed];

    /// Name in logs and recordings.
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

/// Identity and limits of a device.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceInfo {
    /// Name for the user.
    pub name: String,
    /// Whether it arms itself: only if it has no real motors.
    pub self_arming: bool,
    /// Largest force it renders, N.
    pub max_force_n: f32,
    /// Largest stiffness of the model that it renders stably, N/m: its own limit divided by the workspace
    /// scale.
    pub max_stiffness_n_m: f32,
    /// Resolution of its position, m.
    pub resolution_m: f32,
}

/// A haptic device of impedance type: it measures position and renders force.
pub trait Device: Send {
    /// Sends the force for the hand (model frame) and returns the newest sample if one arrived since the last
    /// call.
    ///
    /// Does not wait for a reply: a later call returns a late reply, and the controller's stale-sample policy
    /// handles the gap. `now_us` is the time of this tick and the clock of the sample's time stamp.
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError>;

    /// Sets the force to zero immediately. Called on every exit from the loop, also while a panic unwinds:
    /// must not panic.
    fn stop(&mut self);

    /// Identity and limits.
    fn info(&self) -> DeviceInfo;

    /// Its readiness. The loop arms only a homed device, and sets the force to zero when the device is no
    /// longer homed.
    fn state(&self) -> DeviceState {
        DeviceState::Homed
    }

    /// Waits until the user has homed the device, or until `stop`; true if it is homed. It may block: it runs
    /// before the loop, whose clock starts at zero again.
    fn home(&mut self, _stop: &AtomicBool) -> Result<bool, DeviceError> {
        Ok(self.state() == DeviceState::Homed)
    }

    /// A path by which a guard zeroes the force past this driver, while an exchange hangs or this process is
    /// stopped. The driver puts the message of its device into the fence and from now on sends no force while
    /// the fence is closed. Called once, before the loop.
    ///
    /// `None` for a device without motors, and for one in memory that no other process can reach.
    fn guard_path(&mut self, _fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        Ok(None)
    }

    /// Whether something other than the loop (the guard, the device itself) has zeroed the force since the
    /// last call and ignores forces before [`Device::reset`]. Called after every exchange.
    fn was_zeroed(&mut self) -> bool {
        false
    }

    /// Whether the loop is armed, for the force of the next exchange. A device whose motors were off until then switches them on.
    fn set_armed(&mut self, _is_armed: bool) {}

    /// The force that the device said it rendered with the newest sample, model frame, N; `None` if it says nothing.
    fn reported_n(&self) -> Option<Vec3> {
        None
    }

    /// Clears such a latch: after the user's reset, or while the controller is disarmed. False if it cannot be
    /// cleared now, because its cause lasts.
    fn reset(&mut self) -> bool {
        true
    }
}

/// Pause between two exchanges during homing.
const HOMING_PAUSE: Duration = Duration::from_millis(1);

/// Exchanges without a force until the user has homed the device, or until `stop`. It may block, so it runs
/// before the loop.
fn wait_homed(device: &mut impl Device, stop: &AtomicBool) -> Result<(), DeviceError> {
    let started = Instant::now();
    while device.state() != DeviceState::Homed && !stop.load(Ordering::Relaxed) {
        match device.exchange(started.elapsed().as_micros() as u64, [0.0; 3]) {
            Err(error) if !error.kind().is_transient() => return Err(error),
            _ => std::thread::sleep(HOMING_PAUSE),
        }
        if device.was_zeroed() {
            // The controller is disarmed: a reset cannot restore a force.
            device.reset();
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn os_errors_keep_their_code_and_map_to_a_kind() {
        for (code, kind) in [
            (Errno::EIO, DeviceErrorKind::Disconnected),
            (Errno::EACCES, DeviceErrorKind::Denied),
            (Errno::EBUSY, DeviceErrorKind::InUse),
            (Errno::ENODEV, DeviceErrorKind::Disconnected),
            (Errno::ENOSPC, DeviceErrorKind::Io),
        ] {
            let error = DeviceError::from(std::io::Error::from(code));
            assert_eq!((error.kind(), error.os_code()), (kind, Some(code as i32)));
        }
        assert!(DeviceErrorKind::Timeout.is_transient() && !DeviceErrorKind::Disconnected.is_transient());
    }
}
