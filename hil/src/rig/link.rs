//! The device link on a serial line.

use super::serial::{SerialDevice, SerialRig, WAKE_TIMEOUT, Wire, held_in_the_middle};
use super::{OpenError, Traits};
use crate::link::{COUNTS_PER_TURN, EmulatedLink};
use crate::mechanism::Handle;
use crate::transport::Transport;
use palpate_core::Vec3;
use palpate_host::Device;
use palpate_host::device::capstan::Capstan;
use palpate_host::device::link::{Link, LinkConfig};
use palpate_host::device::nonblocking_port::Port;
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_link::{DeviceFault, Phase};
use std::io;

/// Any device on a gantry: force, friction, mass, encoder steps and mapping come from its profile; mechanism
/// and link are those of the device link. For profiles without an emulator.
#[must_use]
pub fn on_gantry(mut profile: Profile) -> SerialRig<EmulatedLink> {
    let step_m = f64::from(*profile.mechanism.encoder_quantum_m.get_or_insert(DEFAULT_STEP_M));
    profile.capstan.get_or_insert_with(|| Capstan {
        metres_per_turn: [step_m * f64::from(COUNTS_PER_TURN); 3],
        origin_m: profile.workspace.device_origin_m.map(f64::from),
    });
    SerialRig::of(profile, Wire::Memory, 1)
}

/// Encoder step of a profile that states none, m.
const DEFAULT_STEP_M: f32 = 10e-6;

impl SerialDevice for EmulatedLink {
    const NAME: &'static str = "device link";

    fn new(profile: &Profile) -> Self {
        Self::new(held_in_the_middle(profile), profile)
    }

    fn profile() -> &'static str {
        "link"
    }

    fn traits(profile: &Profile) -> Traits {
        Traits {
            homes: true,
            virtual_time: true,
            middle_m: profile.workspace.device_origin_m,
            // Half a count on each of three axes.
            count_m: 0.87 * profile.mechanism.encoder_quantum_m.unwrap_or(30e-6) + 1e-6,
            // One micro-newton-metre on each of three drums.
            motor_step_n: 2e-4,
            checked_requests: true,
            numbered_replies: true,
            has_watchdog: true,
            behind_library: false,
        }
    }

    fn open(
        port: Box<dyn Port>,
        profile: &Profile,
        workspace: Workspace,
    ) -> Result<Box<dyn Device>, OpenError> {
        let config = LinkConfig::of(profile, WAKE_TIMEOUT).ok_or("the profile has no [capstan]")?;
        Ok(Box::new(Link::with_port(port, LinkConfig { workspace, ..config })?))
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
        Self::press(self, buttons);
    }

    fn jump(&mut self, axis: usize, by_m: f32) {
        Self::jump(self, axis, by_m);
    }

    fn power_cycle(&mut self) {
        Self::power_cycle(self);
    }

    fn lose_homing(&mut self) -> bool {
        Self::lose_homing(self);
        true
    }

    fn has_latched(&self) -> bool {
        self.phase() == Phase::Faulted(DeviceFault::Watchdog)
    }
}
