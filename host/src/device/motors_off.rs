//! A device whose motors get no force: positions are real, forces are computed and go nowhere.

use super::{Around, Device, DeviceError, DeviceInfo};
use palpate_core::{Sample, Vec3, vec3};

/// For the first power-up: whatever the loop asks for, zero is what leaves.
#[derive(Debug)]
pub struct MotorsOff<D: Device>(D);

impl<D: Device> MotorsOff<D> {
    /// Keeps every force from a device.
    pub const fn new(device: D) -> Self {
        Self(device)
    }
}

impl<D: Device> Around for MotorsOff<D> {
    type Inner = D;

    fn inner(&self) -> &D {
        &self.0
    }

    fn inner_mut(&mut self) -> &mut D {
        &mut self.0
    }

    fn exchange_around(&mut self, now_us: u64, _: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.0.exchange(now_us, vec3::ZERO)
    }

    fn info_around(&self) -> DeviceInfo {
        let info = self.0.info();
        DeviceInfo { name: format!("{}, motors off", info.name), ..info }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{DeviceErrorKind, DeviceState};

    /// Remembers what it was asked for.
    struct Asked {
        forces: Vec<Vec3>,
        stops: u32,
    }

    impl Device for Asked {
        fn exchange(&mut self, t_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
            self.forces.push(force_n);
            if t_us > 1 {
                return Err(DeviceError::new(DeviceErrorKind::Disconnected));
            }
            Ok(Some(Sample { t_us, position_m: [1.0, 2.0, 3.0], buttons: 5 }))
        }

        fn stop(&mut self) {
            self.stops += 1;
        }

        fn info(&self) -> DeviceInfo {
            DeviceInfo {
                name: "asked".into(),
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
    fn nothing_but_zero_leaves_and_all_else_passes() {
        let mut device = MotorsOff::new(Asked { forces: Vec::new(), stops: 0 });
        let sample = device.exchange(1, [1.0, f32::NAN, -9.0]).expect("a link").expect("a sample");
        assert_eq!((sample.position_m, sample.buttons), ([1.0, 2.0, 3.0], 5));
        assert!(device.exchange(2, [8.0; 3]).is_err_and(|error| !error.kind().is_passing()));
        device.stop();
        assert_eq!((device.state(), device.info().max_force_n), (DeviceState::Unhomed, 3.0));
        assert_eq!(device.info().name, "asked, motors off");
        let Asked { forces, stops } = device.0;
        assert_eq!((forces, stops), (vec![vec3::ZERO; 2], 1));
    }
}
