//! A supervisor between loop and device, on virtual time: what it costs.
//!
//! ```text
//! tick k of the loop -- force k --> supervisor -- force k --> device        within the tick
//!          <-- what the exchange of tick k-1 brought -- supervisor          a tick later than without
//! ```
//!
//! The real one ([`palpate_host::supervisor`]) exchanges when an order comes, and reports what the exchange brought; the loop reads the report
//! with its next tick. So forces are as early as without it, and samples, errors and states a tick late. That this is so for the real one, counted in
//! exchanges, a test of the host shows (`a_supervisor_delays_samples_by_exactly_one_tick`). Its watch on silence is not in here: a loop on virtual
//! time is never silent.

use palpate_core::{Sample, Vec3};
use palpate_host::device::profile::Profile;
use palpate_host::device::{DeviceState, DeviceWrapper};
use palpate_host::{Device, DeviceError};

/// Who holds the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holder {
    /// The process of the loop.
    Loop,
    /// A supervisor.
    Supervisor,
}

impl Holder {
    /// The profile as it is on this side of the holder, as `palpate run` takes it for its cap on the stiffness.
    #[must_use]
    pub fn seen_from_here(self, profile: &Profile) -> Profile {
        let mut profile = profile.clone();
        if self == Self::Supervisor {
            profile.position_delay_us += profile.period_us();
        }
        profile
    }

    /// The device as the loop has it, from some exchanges on that were made without the holder.
    #[must_use]
    pub fn hold(self, device: Box<dyn Device>) -> Box<dyn Device> {
        match self {
            Self::Loop => device,
            Self::Supervisor => Box::new(Handed { state: device.state(), brought: Ok(None), device }),
        }
    }
}

/// A device that is in other hands.
struct Handed {
    device: Box<dyn Device>,
    /// What the last exchange brought, and the loop does not know yet.
    brought: Result<Option<Sample>, DeviceError>,
    /// As the loop knows it.
    state: DeviceState,
}

impl DeviceWrapper for Handed {
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
    use crate::session::{Session, TICK_US};
    use palpate_core::vec3;

    /// Ages of the samples, in ticks, and of the forces that the hand feels after each tick.
    fn ages(holder: Holder) -> (Vec<u64>, Vec<bool>) {
        let mut rig = FalconRig::new(3);
        let workspace = rig.profile().workspace;
        let (device, begun_us) = Session::homed(&mut rig, workspace).expect("it homes").into_device();
        let mut device = holder.hold(device);
        let (mut samples, mut felt) = (Vec::new(), Vec::new());
        for tick in 0..20 {
            let now_us = begun_us + tick * TICK_US;
            let force_n = [0.0, 0.0, 0.1 * (1 + tick % 5) as f32];
            if let Some(sample) = device.exchange(now_us, force_n).expect("a sound link") {
                samples.push((now_us - sample.t_us) / TICK_US);
            }
            rig.advance(now_us + TICK_US);
            felt.push(vec3::distance(rig.felt().force_n, force_n) < 0.02);
        }
        (samples, felt)
    }

    #[test]
    fn samples_are_a_tick_late_and_forces_are_not() {
        assert_eq!(ages(Holder::Loop), (vec![1; 20], vec![true; 20]));
        assert_eq!(ages(Holder::Supervisor), (vec![2; 19], vec![true; 20]));
    }
}
