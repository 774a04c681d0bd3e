//! Configuration of a Falcon, and its errors.

use super::loader::LoadError;
use super::motor::MotorConfig;
use super::reply_reader::Mode;
use super::usb::UsbError;
use crate::device::DeviceError;
use crate::device::profile::{DEFAULT_CAP_N_M, Profile};
use crate::device::workspace::Workspace;
use core::fmt;

/// Settings of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FalconConfig {
    /// Placement of the device's workspace in the model.
    pub workspace: Workspace,
    /// Largest force of the mechanism, N.
    pub max_force_n: f32,
    /// Largest stiffness that is rendered stably, N/m in device metres: the profile's cap.
    pub max_stiffness_n_m: f32,
    /// Motor counts per N m at the crank, with sign (`MotorConfig`).
    pub counts_per_n_m: [f64; 3],
    /// How replies are read.
    pub mode: Mode,
}

impl Default for FalconConfig {
    fn default() -> Self {
        let MotorConfig { counts_per_n_m, max_force_n } = MotorConfig::default();
        Self {
            workspace: Workspace::default(),
            max_force_n: max_force_n as f32,
            max_stiffness_n_m: DEFAULT_CAP_N_M,
            counts_per_n_m,
            mode: Mode::Threaded { fifo_priority: None },
        }
    }
}

impl FalconConfig {
    /// The configuration from a profile.
    #[must_use]
    pub fn of(profile: &Profile, mode: Mode) -> Self {
        Self {
            workspace: profile.workspace,
            max_force_n: profile.max_force_n,
            max_stiffness_n_m: profile.cap().n_m,
            counts_per_n_m: profile.calibration.counts_per_n_m.map(f64::from),
            mode,
        }
    }

    pub(super) fn motor(&self) -> MotorConfig {
        MotorConfig { counts_per_n_m: self.counts_per_n_m, max_force_n: self.max_force_n.into() }
    }
}

/// Reason why the device cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FalconError {
    /// The USB chip cannot be opened.
    Usb(UsbError),
    /// The link failed.
    Device(DeviceError),
    /// The device does not reply, and no firmware was given.
    NeedsFirmware,
    /// The device was homed before it was opened, and no firmware was given or loading it did not clear the
    /// homing.
    HomedBefore,
    /// The firmware could not be loaded.
    Load(LoadError),
}

impl fmt::Display for FalconError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usb(error) => error.fmt(f),
            Self::Device(error) => write!(f, "{error}; check the cable and connect the device again"),
            Self::NeedsFirmware => f.write_str(
                "the Falcon does not reply, so its firmware is not loaded; give the file with falcon:FIRMWARE (docs/devices.md)",
            ),
            Self::HomedBefore => f.write_str(
                "the Falcon was homed in an earlier session, so its coordinates are not reliable; give the file of \
                 its firmware with falcon:FIRMWARE, which clears the homing, or disconnect its power for a moment",
            ),
            Self::Load(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for FalconError {}

impl From<DeviceError> for FalconError {
    fn from(error: DeviceError) -> Self {
        Self::Device(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceErrorKind;

    #[test]
    fn errors_are_one_line_and_name_the_fix() {
        let disconnected = DeviceError::new(DeviceErrorKind::Disconnected);
        for error in [
            FalconError::Device(disconnected),
            FalconError::NeedsFirmware,
            FalconError::HomedBefore,
            FalconError::Usb(UsbError::NotFound),
        ] {
            let text = error.to_string();
            assert!(!text.contains('\n') && text.contains("; "), "{text}");
        }
    }
}
