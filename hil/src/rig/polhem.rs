//! The Polhem on a serial line.

use super::serial::{SerialDevice, WAKE_TIMEOUT, held_in_the_middle};
use super::{OpenError, Traits};
use crate::mechanism::Handle;
use crate::polhem::EmulatedPolhem;
use crate::transport::Transport;
use palpate_core::{Vec3, vec3};
use palpate_host::Device;
use palpate_host::device::nonblocking_port::Port;
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use std::io;

/// Assumed offset of the arm at rest without power from the middle of the workspace, m.
const REST_OFFSET_M: Vec3 = [0.05, -0.04, -0.06];

impl SerialDevice for EmulatedPolhem {
    const NAME: &'static str = "Polhem";

    fn new(profile: &Profile) -> Self {
        let step_m = profile.mechanism.encoder_quantum_m.unwrap_or(0.0);
        let power_up_m = vec3::add(profile.workspace.device_origin_m, REST_OFFSET_M);
        Self::new(held_in_the_middle(profile)).with_step_m(step_m).with_power_up_position(power_up_m)
    }

    fn profile() -> &'static str {
        "polhem"
    }

    fn traits(profile: &Profile) -> Traits {
        Traits {
            homes: false,
            virtual_time: true,
            middle_m: profile.workspace.device_origin_m,
            // Half a step on each of three axes.
            count_m: 0.87 * profile.mechanism.encoder_quantum_m.unwrap_or(1e-6) + 1e-6,
            motor_step_n: profile.mechanism.motor_quantum_n.unwrap_or(1e-3),
            checked_requests: false,
            numbered_replies: false,
            has_watchdog: false,
            behind_library: false,
        }
    }

    fn open(
        port: Box<dyn Port>,
        profile: &Profile,
        workspace: Workspace,
    ) -> Result<Box<dyn Device>, OpenError> {
        let config = PolhemConfig {
            workspace,
            max_force_n: profile.max_force_n,
            max_stiffness_n_m: profile.cap().n_m,
            wake_timeout: WAKE_TIMEOUT,
        };
        Ok(Box::new(Polhem::with_port(port, config)?))
    }

    fn poll(&mut self, now_us: u64, link: &mut dyn Transport) -> io::Result<()> {
        Self::poll(self, now_us, link)
    }

    fn handle(&self) -> &Handle {
        Self::handle(self)
    }

    fn handle_mut(&mut self) -> &mut Handle {
        Self::handle_mut(self)
    }

    fn reported_m(&self) -> Vec3 {
        Self::reported_m(self)
    }

    fn press(&mut self, buttons: u8) {
        self.set_info(i16::from(buttons));
    }

    fn jump(&mut self, axis: usize, by_m: f32) {
        let mut jump_m = vec3::ZERO;
        if let Some(along) = jump_m.get_mut(axis) {
            *along = by_m;
        }
        Self::jump(self, jump_m);
    }

    fn power_cycle(&mut self) {
        Self::power_cycle(self);
    }

    /// It has no homing.
    fn lose_homing(&mut self) -> bool {
        false
    }
}
