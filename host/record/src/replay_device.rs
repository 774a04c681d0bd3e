//! A device that repeats recorded replies: one for each exchange.
//!
//! It has no motors and no clock. [`replay`](crate::replay()) supplies the replies and sets the clock.

use palpate_core::{Sample, Vec3};
use palpate_host::device::DeviceState;
use palpate_host::{Device, DeviceError, DeviceErrorKind, DeviceInfo};

/// Result of one recorded exchange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RecordedReply {
    /// Its sample, if there was one.
    pub(crate) sample: Option<Sample>,
    /// State of the device.
    pub(crate) state: DeviceState,
}

/// The device of a replay.
#[derive(Debug)]
pub(crate) struct ReplayDevice {
    replies: rtrb::Consumer<RecordedReply>,
    info: DeviceInfo,
    state: DeviceState,
}

impl ReplayDevice {
    /// A device that returns the replies from the queue, with the limits of the recorded device. It arms
    /// itself if that device did.
    pub(crate) const fn new(info: DeviceInfo, replies: rtrb::Consumer<RecordedReply>) -> Self {
        Self { replies, info, state: DeviceState::Disconnected }
    }
}

impl Device for ReplayDevice {
    /// The next reply, with its recorded time. Without one the device counts as disconnected.
    fn exchange(&mut self, _now_us: u64, _hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let reply = self.replies.pop().map_err(|_| DeviceError::new(DeviceErrorKind::Disconnected))?;
        self.state = reply.state;
        Ok(reply.sample)
    }

    fn stop(&mut self) {
        // There is no motor.
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
    fn it_repeats_each_recorded_reply_once() {
        let info = DeviceInfo {
            name: "a hand".into(),
            self_arming: true,
            max_force_n: 8.0,
            max_stiffness_n_m: 1e3,
            resolution_m: 0.0,
        };
        let (mut feed, replies) = rtrb::RingBuffer::new(2);
        let mut device = ReplayDevice::new(info, replies);
        let sample = Sample { t_us: 3, position_m: [1.0, 2.0, 3.0], buttons: 9, ..Sample::default() };
        feed.push(RecordedReply { sample: Some(sample), state: DeviceState::Homed }).expect("room");
        feed.push(RecordedReply { sample: None, state: DeviceState::Unhomed }).expect("room");
        assert_eq!(device.exchange(500, vec3::ZERO), Ok(Some(sample)));
        assert_eq!(device.state(), DeviceState::Homed);
        assert_eq!(device.exchange(501, vec3::ZERO), Ok(None));
        assert_eq!(device.state(), DeviceState::Unhomed);
        let disconnected = device.exchange(502, vec3::ZERO).expect_err("nothing left");
        assert_eq!(disconnected.kind(), DeviceErrorKind::Disconnected);
        assert!(device.info().self_arming && device.info().name == "replay of a hand");
    }
}
