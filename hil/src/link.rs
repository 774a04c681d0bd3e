//! Emulated controller of the device link: the core's state machine as the firmware links it, on a gantry
//! with a hand.
//!
//! Unlike the other emulators it has a watchdog, as every device of the link does. The mechanism (counts from
//! the position, force from the torques) is implemented from the profile and independently of the driver, so
//! that an error in one shows against the other.

use crate::mechanism::Handle;
use crate::transport::Transport;
use core::f64::consts::TAU;
use palpate_core::Vec3;
use palpate_host::device::profile::Profile;
use palpate_link::{
    Device, DeviceInfo, DeviceProfile, FrameReader, HostMessage, Inputs, MAX_FRAME, Phase, encode,
};
use std::io;

/// Encoder counts per turn.
pub const COUNTS_PER_TURN: u32 = 2_000;
/// Largest force of each motor at its drum, relative to the profile's limit: the host's clamp must act first.
const MOTOR_MARGIN: f64 = 1.4;
/// Silence that trips the watchdog, us.
pub const WATCHDOG_US: u16 = 10_000;
/// Largest speed of an axis at its drum, m/s.
const MAX_SPEED_M_S: f64 = 3.0;
/// Time the user takes to home the handle, us.
const HOMING_US: u64 = 100_000;

/// The device with its handle.
#[derive(Debug)]
pub struct EmulatedLink {
    handle: Handle,
    core: Device,
    profile: DeviceProfile,
    reader: FrameReader<HostMessage>,
    metres_per_turn: [f64; 3],
    origin_m: [f64; 3],
    /// Offset of the counters: their value at power-up, and miscounts.
    count_offset: [i32; 3],
    homed: bool,
    /// Start of the homing motion.
    homing_us: Option<u64>,
    buttons: u8,
    torque_unm: [i32; 3],
    boot_count: u32,
}

impl EmulatedLink {
    /// A device that is powered up now.
    ///
    /// # Panics
    ///
    /// If the profile has no capstan.
    #[must_use]
    pub fn new(handle: Handle, profile: &Profile) -> Self {
        let capstan = profile.capstan.expect("the profile of a device link has a [capstan]");
        let device_profile = firmware(profile.max_force_n.into(), capstan.metres_per_turn);
        let mut device = Self {
            handle,
            core: core(&device_profile, 1),
            profile: device_profile,
            reader: FrameReader::new(),
            metres_per_turn: capstan.metres_per_turn,
            origin_m: capstan.origin_m,
            count_offset: [0; 3],
            homed: false,
            homing_us: None,
            buttons: 0,
            torque_unm: [0; 3],
            boot_count: 1,
        };
        device.power_up();
        device
    }

    /// Power cycle: no torque, no session, no homing, and counters at zero at the present position.
    pub fn power_cycle(&mut self) {
        self.boot_count += 1;
        self.core = core(&self.profile, self.boot_count);
        self.reader = FrameReader::new();
        self.power_up();
    }

    fn power_up(&mut self) {
        (self.homed, self.homing_us, self.torque_unm) = (false, None, [0; 3]);
        self.handle.release();
        self.count_offset = self.true_counts().map(i32::wrapping_neg);
    }

    /// Loses its homing.
    pub const fn lose_homing(&mut self) {
        self.homed = false;
    }

    /// Adds a miscount of about `by_m` at the handle to an encoder.
    pub fn jump(&mut self, axis: usize, by_m: f32) {
        let turns = f64::from(by_m) / self.metres_per_turn[axis];
        self.count_offset[axis] += (turns * f64::from(COUNTS_PER_TURN)).round() as i32;
    }

    /// Presses these buttons.
    pub const fn press(&mut self, buttons: u8) {
        self.buttons = buttons;
    }

    /// The handle with the hand on it.
    #[must_use]
    pub const fn handle(&self) -> &Handle {
        &self.handle
    }

    /// The handle with the hand on it.
    pub const fn handle_mut(&mut self) -> &mut Handle {
        &mut self.handle
    }

    /// Phase of the controller.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.core.phase()
    }

    /// Force on the hand now, N.
    #[must_use]
    pub const fn force_n(&self) -> Vec3 {
        self.handle.force_record().force_n
    }

    /// Counts of correct encoders.
    fn true_counts(&self) -> [i32; 3] {
        let at_m = self.handle.position_m();
        core::array::from_fn(|axis| {
            let turns = (f64::from(at_m[axis]) - self.origin_m[axis]) / self.metres_per_turn[axis];
            (turns * f64::from(COUNTS_PER_TURN)).round() as i32
        })
    }

    fn encoders(&self) -> [i32; 3] {
        let counts = self.true_counts();
        core::array::from_fn(|axis| counts[axis].wrapping_add(self.count_offset[axis]))
    }

    /// Position reported by the encoders, m.
    #[must_use]
    pub fn reported_m(&self) -> Vec3 {
        let counts = self.encoders();
        core::array::from_fn(|axis| {
            let turns = f64::from(counts[axis]) / f64::from(COUNTS_PER_TURN);
            (self.origin_m[axis] + turns * self.metres_per_turn[axis]) as f32
        })
    }

    /// Serves all input up to `now_us`, with a cycle of the control loop before and after.
    pub fn poll(&mut self, now_us: u64, link: &mut (impl Transport + ?Sized)) -> io::Result<()> {
        self.handle.advance(now_us);
        self.cycle(now_us, false);
        let mut buffer = [0; 256];
        let mut commanded = false;
        loop {
            let count = link.receive(now_us, &mut buffer)?;
            if count == 0 {
                break;
            }
            let mut bytes = &buffer[..count];
            while let Some(outcome) = self.reader.read(&mut bytes) {
                let Ok(message) = outcome else { continue };
                commanded |= matches!(message, HostMessage::Command { .. });
                if let Some(answer) = self.core.receive(now_us, &message) {
                    let mut frame = [0; MAX_FRAME];
                    // No message is longer than a frame.
                    let frame = encode(&answer, &mut frame).map_err(|_| io::ErrorKind::InvalidData)?;
                    link.send(now_us, frame)?;
                }
            }
        }
        self.cycle(now_us, commanded);
        Ok(())
    }

    /// One cycle of the firmware's control loop: encoders in, torques out.
    fn cycle(&mut self, now_us: u64, commanded: bool) {
        let inputs =
            Inputs { encoders: self.encoders(), buttons: self.buttons, homed: self.homed, fault: false };
        let outputs = self.core.step(now_us, &inputs);
        if outputs.home {
            let since_us = *self.homing_us.get_or_insert_with(|| {
                self.homed = false;
                now_us
            });
            if now_us.saturating_sub(since_us) >= HOMING_US {
                (self.homed, self.count_offset) = (true, [0; 3]);
            }
        } else {
            self.homing_us = None;
        }
        if commanded {
            let force_n: Vec3 = core::array::from_fn(|axis| {
                (1e-6 * f64::from(outputs.torque_unm[axis]) * TAU / self.metres_per_turn[axis]) as f32
            });
            // In units of 10 micro-newton-metres, rounded away from zero: 0 is no torque.
            let motors = outputs.torque_unm.map(|torque| {
                let tens = torque / 10 + torque.signum();
                tens.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
            });
            self.handle.drive(force_n, motors, self.homed);
        } else if outputs.torque_unm == [0; 3] && self.torque_unm != [0; 3] {
            // The torque ended by its validity or by the watchdog, and not by a command.
            self.handle.release();
        }
        self.torque_unm = outputs.torque_unm;
    }
}

/// The firmware's figures of the mechanism.
fn firmware(max_force_n: f64, metres_per_turn: [f64; 3]) -> DeviceProfile {
    let torque_unm = |metres: f64| (1e6 * MOTOR_MARGIN * max_force_n * metres.abs() / TAU).round() as u32;
    let counts_per_m = metres_per_turn.map(|metres| f64::from(COUNTS_PER_TURN) / metres.abs());
    let info = DeviceInfo {
        dof: 3,
        counts_per_turn: [COUNTS_PER_TURN; 3],
        torque_limit_unm: metres_per_turn.map(torque_unm),
        watchdog_us: WATCHDOG_US,
        serial: 7,
        firmware: 1,
    };
    let fastest = counts_per_m.iter().fold(0.0f64, |max, counts| max.max(counts * MAX_SPEED_M_S));
    DeviceProfile { info, max_speed_counts_per_s: fastest.round() as u32, boot: 1 }
}

/// A controller that has just started.
fn core(profile: &DeviceProfile, boot: u32) -> Device {
    Device::new(DeviceProfile { boot, ..*profile }).expect("the figures are valid")
}
