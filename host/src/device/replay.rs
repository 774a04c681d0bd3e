//! A device that says again what a device said once: one recorded answer for each exchange.
//!
//! It moves nothing and follows no clock. [`replay`](crate::replay()) feeds it and turns the clock.

use super::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState};
use palpate_core::{Sample, Vec3};

/// What a device said in one exchange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Its sample, if there was one.
    pub sample: Option<Sample>,
    /// How far it was.
    pub state: DeviceState,
}

/// The device of a replay.
#[derive(Debug)]
pub struct ReplayDevice {
    answers: rtrb::Consumer<Answer>,
    info: DeviceInfo,
    state: DeviceState,
}

impl ReplayDevice {
    /// Gives what comes through `answers`, as the device of `info` once did: it arms itself if that one did.
    #[must_use]
    pub const fn new(info: DeviceInfo, answers: rtrb::Consumer<Answer>) -> Self {
        Self { answers, info, state: DeviceState::Disconnected }
    }
}

impl Device for ReplayDevice {
    /// The next answer, with the time it was recorded with. Without one the device counts as gone.
    fn exchange(&mut self, _now_us: u64, _hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let answer = self.answers.pop().map_err(|_| DeviceError::new(DeviceErrorKind::Disconnected))?;
        self.state = answer.state;
        Ok(answer.sample)
    }

    fn stop(&mut self) {
        // Nothing is driven.
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo { name: format!("replay of {}", self.info.name), ..self.info.clone() }
    }

    fn state(&self) -> DeviceState {
        self.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::vec3;

    #[test]
    fn it_answers_once_what_it_was_fed() {
        let info = DeviceInfo {
            name: "a hand".into(),
            self_arming: true,
            max_force_n: 8.0,
            max_stiffness_n_m: 1e3,
            resolution_m: 0.0,
        };
        let (mut feed, answers) = rtrb::RingBuffer::new(2);
        let mut device = ReplayDevice::new(info, answers);
        let sample = Sample { t_us: 3, position_m: [1.0, 2.0, 3.0], buttons: 9 };
        feed.push(Answer { sample: Some(sample), state: DeviceState::Homed }).expect("room");
        feed.push(Answer { sample: None, state: DeviceState::Unhomed }).expect("room");
        assert_eq!(device.exchange(500, vec3::ZERO), Ok(Some(sample)));
        assert_eq!(device.state(), DeviceState::Homed);
        assert_eq!(device.exchange(501, vec3::ZERO), Ok(None));
        assert_eq!(device.state(), DeviceState::Unhomed);
        let gone = device.exchange(502, vec3::ZERO).expect_err("nothing left");
        assert_eq!(gone.kind(), DeviceErrorKind::Disconnected);
        assert!(device.info().self_arming && device.info().name == "replay of a hand");
    }
}
