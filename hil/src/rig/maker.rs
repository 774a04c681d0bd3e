//! Devices behind the libraries or services of their makers: a stand-in is loaded or connected as a user's is.
//!
//! A library hides the frames of its link. Here a fault of the link to the device lets a cycle be missing, and one of the link to the
//! host lets the measurement of a cycle be missing.

use super::serial::held_in_the_middle;
use super::{OpenError, Rig, Traits};
use crate::fault::{FaultCounts, FaultKind, Faults, split_mix};
use crate::force_record::ForceRecord;
use crate::mechanism::{Handle, Waypoint};
use core::sync::atomic::{AtomicU64, Ordering};
use palpate_core::{Vec3, vec3};
use palpate_host::Device;
use palpate_host::device::maker::{Clock, Opened, ProxyPart, beside};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use std::sync::Arc;

/// Time of a step, us.
const STEP_US: u64 = 250;
/// Time in which a driver becomes ready that needs no hand, us.
const READY_US: u64 = 10_000;

/// A maker's device on its library or service, and the driver that is open.
pub trait MakerDevice: Sized {
    /// Name of device and library, for display.
    const NAME: &'static str;
    /// Name of its bundled profile.
    const PROFILE: &'static str;
    /// Time between two cycles, and that of the first, us.
    const CYCLES_US: (u64, u64);
    /// It has to be homed by hand.
    const HOMES: bool;

    /// A device that was just plugged in.
    fn new() -> Result<Self, OpenError>;

    /// Opens its driver, as the process does that holds a user's library.
    fn open(&mut self, max_force_n: f32, part: ProxyPart, clock: Clock) -> Result<Opened, OpenError>;

    /// The process that held the driver has ended.
    fn close(&mut self);

    /// Sets the time and the position of the encoders.
    fn place(&mut self, now_ns: u64, position_m: Vec3);

    /// A cycle of library and driver. The measurement of one may be missing.
    fn cycle(&mut self, is_measured: bool);

    /// What the firmware does by itself.
    fn firmware(&mut self) {}

    /// Commands so far, and the force of the motors, N.
    fn felt(&self) -> (u64, Vec3);

    /// Presses these buttons.
    fn press(&mut self, buttons: u8);

    /// The device before it is homed, and after it.
    fn set_homed(&mut self, is_homed: bool);

    /// Ends the connection, or plugs it in.
    fn set_plugged(&mut self, is_plugged: bool);

    /// Lets the device switch its motors off by itself; `draw` chooses the cause.
    fn switch_off(&mut self, draw: u64);

    /// Loses its homing. Returns false if the driver cannot see it.
    fn lose_homing(&mut self) -> bool;
}

/// Faults of one direction, cycle by cycle.
#[derive(Debug, Default)]
struct Way {
    faults: Option<Faults>,
    blocked_until_us: u64,
    counts: FaultCounts,
}

impl Way {
    /// Whether this cycle is missing.
    fn is_missing(&mut self, now_us: u64, draw: u64) -> bool {
        let Some(faults) = self.faults else { return false };
        let share = |salt: u64| split_mix(draw, salt) as f32 / u64::MAX as f32;
        if share(1) < faults.stall && now_us >= self.blocked_until_us {
            self.blocked_until_us = now_us + faults.stall_us;
            self.counts.stalled += 1;
        }
        if share(2) < faults.delay && now_us >= self.blocked_until_us {
            self.blocked_until_us = now_us + faults.delay_us;
            self.counts.delayed += 1;
        }
        let is_dropped = share(3) < faults.drop;
        self.counts.dropped += u64::from(is_dropped);
        is_dropped || now_us < self.blocked_until_us
    }
}

/// The rig of such a device, on virtual time.
pub struct MakerRig<D> {
    device: D,
    is_open: bool,
    profile: Profile,
    handle: Handle,
    /// Time of the device, us.
    now_us: u64,
    clock_ns: Arc<AtomicU64>,
    opened_us: u64,
    cable_in: bool,
    is_homed: bool,
    /// Miscounts of the encoders, m.
    jump_m: Vec3,
    seed: u64,
    to_device: Way,
    to_host: Way,
    /// Cycles of the library so far.
    frames: u64,
}

impl<D: MakerDevice> MakerRig<D> {
    /// A device that was just plugged in.
    ///
    /// # Panics
    ///
    /// If the stand-in is not built, or the profile not bundled.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let profile = Profile::bundled(D::PROFILE).expect("an emulated device has a bundled profile");
        Self {
            device: D::new().expect("cargo builds the stand-in, and there are free ports"),
            is_open: false,
            handle: held_in_the_middle(&profile),
            profile,
            now_us: 0,
            clock_ns: Arc::default(),
            opened_us: 0,
            cable_in: true,
            is_homed: false,
            jump_m: vec3::ZERO,
            seed,
            to_device: Way::default(),
            to_host: Way::default(),
            frames: 0,
        }
    }

    fn step(&mut self) {
        self.now_us += STEP_US;
        let now_ns = 1_000 * self.now_us;
        self.clock_ns.store(now_ns, Ordering::Relaxed);
        self.handle.advance(self.now_us);
        self.device.place(now_ns, self.reported_m());
        let (period_us, first_us) = D::CYCLES_US;
        let draw = split_mix(self.seed, self.now_us);
        if self.now_us % period_us == first_us && !self.to_device.is_missing(self.now_us, draw) {
            let is_measured = !self.to_host.is_missing(self.now_us, split_mix(draw, 9));
            self.device.cycle(is_measured);
        }
        self.device.firmware();
        self.feel();
    }

    /// The force of the motors acts on the hand.
    fn feel(&mut self) {
        let (frames, force_n) = self.device.felt();
        let is_sent = core::mem::replace(&mut self.frames, frames) != frames;
        if !self.cable_in {
            return;
        }
        if is_sent {
            self.handle.drive(force_n, force_n.map(|n| (1e3 * n) as i16), self.is_homed);
        } else if force_n == vec3::ZERO && self.handle.force_record().force_n != vec3::ZERO {
            // The firmware has switched its motors off.
            self.handle.release();
        }
    }
}

impl<D: MakerDevice> Rig for MakerRig<D> {
    fn name(&self) -> String {
        D::NAME.into()
    }

    fn profile(&self) -> &Profile {
        &self.profile
    }

    fn traits(&self) -> Traits {
        Traits {
            homes: D::HOMES,
            virtual_time: true,
            middle_m: self.profile.workspace.device_origin_m,
            // Half a count on each of three axes.
            count_m: 0.87 * self.profile.mechanism.encoder_quantum_m.unwrap_or(1e-6) + 1e-6,
            motor_step_n: 1e-5,
            checked_requests: true,
            numbered_replies: true,
            has_watchdog: false,
            behind_library: true,
        }
    }

    fn open(&mut self, workspace: Workspace) -> Result<Box<dyn Device>, OpenError> {
        self.device.close();
        self.is_open = false;
        if !self.cable_in {
            return Err("the cable is out".into());
        }
        let profile = Profile { workspace, ..self.profile.clone() };
        let clock = |clock_ns: &Arc<AtomicU64>| -> Clock {
            let clock_ns = clock_ns.clone();
            Box::new(move || clock_ns.load(Ordering::Relaxed))
        };
        let (part, session) = beside(&profile, clock(&self.clock_ns));
        self.is_homed = !D::HOMES;
        self.device.set_homed(self.is_homed);
        let opened = self.device.open(profile.max_force_n, part, clock(&self.clock_ns))?;
        let device = session(opened);
        self.is_open = true;
        self.opened_us = self.now_us;
        self.advance(if self.is_homed { READY_US } else { D::CYCLES_US.0 });
        self.opened_us = self.now_us;
        Ok(Box::new(device))
    }

    fn advance(&mut self, now_us: u64) {
        while self.now_us < self.opened_us + now_us {
            self.step();
        }
        // The hand puts the stylus into the inkwell.
        if !self.is_homed && self.is_open && now_us > 50_000 {
            self.is_homed = true;
            self.device.set_homed(true);
        }
    }

    fn now_us(&self) -> u64 {
        self.now_us - self.opened_us
    }

    fn force_record(&self) -> ForceRecord {
        self.handle.force_record().on_clock(self.opened_us)
    }

    fn reset_record(&mut self) {
        self.handle.reset_record();
    }

    fn position_m(&self) -> Vec3 {
        self.handle.position_m()
    }

    fn reported_m(&self) -> Vec3 {
        let count_m = self.profile.mechanism.encoder_quantum_m.unwrap_or(1e-6);
        let true_m = vec3::add(self.handle.position_m(), self.jump_m);
        true_m.map(|m| (m / count_m).round() * count_m)
    }

    fn follow(&mut self, path: Vec<Waypoint>) {
        self.handle.follow(path);
    }

    fn press(&mut self, buttons: u8) {
        self.device.press(buttons);
    }

    fn set_faults(&mut self, to_device: Faults, to_host: Faults) {
        for (way, faults) in [(&mut self.to_device, to_device), (&mut self.to_host, to_host)] {
            way.faults = (faults != Faults::NONE).then_some(faults);
            if way.faults.is_none() {
                way.blocked_until_us = 0;
            }
        }
    }

    fn counts(&self) -> FaultCounts {
        self.to_device.counts + self.to_host.counts
    }

    fn counts_each(&self) -> Option<[FaultCounts; 2]> {
        Some([self.to_device.counts, self.to_host.counts])
    }

    fn replug(&mut self) {
        self.cable_in = true;
        self.device.set_plugged(true);
    }

    fn inject(&mut self, fault: FaultKind) -> bool {
        match fault {
            FaultKind::UnplugMidFrame | FaultKind::Replug => {
                self.cable_in = false;
                self.device.set_plugged(false);
                // Its maker's boards have no command from then on.
                self.handle.release();
            }
            FaultKind::HomingLost => return self.device.lose_homing(),
            FaultKind::ForceOff => self.device.switch_off(split_mix(self.seed, 77)),
            _ => return false,
        }
        true
    }

    fn jump_encoder(&mut self, axis: usize, by_m: f32) {
        if let Some(along) = self.jump_m.get_mut(axis) {
            *along += by_m;
        }
    }
}
