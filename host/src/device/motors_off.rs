//! A device without motor force: positions are real, computed forces are not sent.

use super::{Device, DeviceError, DeviceInfo, DeviceWrapper};
use palpate_core::{Sample, Vec3, vec3};

/// For the first power-up: every force is replaced by zero.
#[derive(Debug)]
pub struct MotorsOff<D: Device>(D);

impl<D: Device> MotorsOff<D> {
    /// Wraps a device.
    pub const fn new(device: D) -> Self {
        Self(device)
    }
}

impl<D: Device> DeviceWrapper for MotorsOff<D> {
    type Inner = D;

    fn inner(&self) -> &D {
        &self.0
    }

    fn inner_mut(&mut self) -> &mut D {
        &mut self.0
    }

    fn wrapped_exchange(&mut self, now_us: u64, _: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.0.exchange(now_us, vec3::ZERO)
    }

    /// Motors that are off until the loop is armed stay off.
    fn wrapped_set_armed(&mut self, _: bool) {}

    fn wrapped_info(&self) -> DeviceInfo {
        let info = self.0.info();
        DeviceInfo { name: format!("{}, motors off", info.name), ..info }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{DeviceErrorKind, DeviceState};

    /// Records the forces that it receives.
    struct ForceRecorder {
        forces: Vec<Vec3>,
        stops: u32,
    }

    impl Device for ForceRecorder {
        fn exchange(&mut self, t_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
            self.forces.push(force_n);
            if t_us > 1 {
                return Err(DeviceError::new(DeviceErrorKind::Disconnected));
            }
            Ok(Some(Sample { t_us, position_m: [1.0, 2.0, 3.0], buttons: 5, ..Sample::default() }))
        }

        fn stop(&mut self) {
            self.stops += 1;
        }

        fn info(&self) -> DeviceInfo {
            DeviceInfo {
                name: "recorder".into(),
                self_arming: false,
                max_force_n: 3.0,
                max_stiffness_n_m: 500.0,
                resolution_m: 1e-5,
            }
        }

        fn state(&self) -> DeviceState {
            DeviceState::Unhomed
        }
    }

    #[test]
    fn forces_are_replaced_by_zero_and_the_rest_is_passed_on() {
        let mut device = MotorsOff::new(ForceRecorder { forces: Vec::new(), stops: 0 });
        let sample = device.exchange(1, [1.0, f32::NAN, -9.0]).expect("a link").expect("a sample");
        assert_eq!((sample.position_m, sample.buttons), ([1.0, 2.0, 3.0], 5));
        assert!(device.exchange(2, [8.0; 3]).is_err_and(|error| !error.kind().is_transient()));
        device.stop();
        assert_eq!((device.state(), device.info().max_force_n), (DeviceState::Unhomed, 3.0));
        assert_eq!(device.info().name, "recorder, motors off");
        let ForceRecorder { forces, stops } = device.0;
        assert_eq!((forces, stops), (vec![vec3::ZERO; 2], 1));
    }
}
