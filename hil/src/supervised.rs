//! Model of a supervisor between loop and device on virtual time, to measure its cost.
//!
//! ```text
//! tick k of the loop -- force k --> supervisor -- force k --> device        in the same tick
//!          <-- result of the exchange of tick k-1 -- supervisor         one tick late
//! ```
//!
//! The real supervisor ([`palpate_host::supervisor`]) exchanges when a command arrives and reports the
//! result, which the loop reads in its next tick. So forces have no extra delay, and samples, errors and
//! states are one tick late. A test of the host shows this for the real one, counted in exchanges
//! (`a_supervisor_delays_samples_by_exactly_one_tick`). The silence limit is not modelled, because a loop on
//! virtual time is never silent.

use palpate_core::{Sample, Vec3};
use palpate_host::device::profile::Profile;
use palpate_host::device::{DeviceState, DeviceWrapper};
use palpate_host::{Device, DeviceError};

/// The process that owns the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceOwner {
    /// The process of the loop.
    Loop,
    /// A supervisor.
    Supervisor,
}

impl DeviceOwner {
    /// The profile as seen by the loop; `palpate run` uses it for the stiffness cap.
    #[must_use]
    pub fn loop_side_profile(self, profile: &Profile) -> Profile {
        let mut profile = profile.clone();
        if self == Self::Supervisor {
            profile.position_delay_us += profile.period_us();
        }
        profile
    }

    /// Wraps the device as the loop sees it. The device may already have exchanged without the owner.
    #[must_use]
    pub fn wrap(self, device: Box<dyn Device>) -> Box<dyn Device> {
        match self {
            Self::Loop => device,
            Self::Supervisor => {
                Box::new(SupervisedModel { state: device.state(), brought: Ok(None), device })
            }
        }
    }
}

/// A device behind the modelled supervisor.
struct SupervisedModel {
    device: Box<dyn Device>,
    /// Result of the last exchange, which the loop has not received yet.
    brought: Result<Option<Sample>, DeviceError>,
    /// State as known to the loop.
    state: DeviceState,
}

impl DeviceWrapper for SupervisedModel {
    type Inner = dyn Device;

    fn inner(&self) -> &(dyn Device + 'static) {
        &*self.device
    }

    fn inner_mut(&mut self) -> &mut (dyn Device + 'static) {
        &mut *self.device
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.state = self.device.state();
        let brought = self.device.exchange(now_us, hand_force_n);
        core::mem::replace(&mut self.brought, brought)
    }

    fn wrapped_state(&self) -> DeviceState {
        self.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{FalconRig, Rig};
    use crate::session::Session;
    use crate::tick::TICK_US;
    use palpate_core::vec3;

    /// Ages of the samples in ticks, and whether the hand has the commanded force after each tick.
    fn ages(owner: DeviceOwner) -> (Vec<u64>, Vec<bool>) {
        let mut rig = FalconRig::new(3);
        let workspace = rig.profile().workspace;
        let (device, start_us) = Session::homed(&mut rig, workspace).expect("homing succeeds").into_device();
        let mut device = owner.wrap(device);
        let (mut samples, mut felt) = (Vec::new(), Vec::new());
        for tick in 0..20 {
            let now_us = start_us + tick * TICK_US;
            let force_n = [0.0, 0.0, 0.1 * (1 + tick % 5) as f32];
            if let Some(sample) = device.exchange(now_us, force_n).expect("a fault-free link") {
                samples.push((now_us - sample.t_us) / TICK_US);
            }
            rig.advance(now_us + TICK_US);
            felt.push(vec3::distance(rig.force_record().force_n, force_n) < 0.02);
        }
        (samples, felt)
    }

    #[test]
    fn samples_are_one_tick_late_and_forces_are_not() {
        assert_eq!(ages(DeviceOwner::Loop), (vec![1; 20], vec![true; 20]));
        assert_eq!(ages(DeviceOwner::Supervisor), (vec![2; 19], vec![true; 20]));
    }
}
