//! A rig: one emulated device on one transport, with the real driver.
//!
//! ```text
//! contract, matrix, closed loop -> Device (the real driver) -> transport, faults -> emulated device -> hand
//!            |------------------------------- Rig: time, hand, faults, force record ----------------|
//! ```
//!
//! The tests of all devices use a [`Rig`]: the contract suite ([`crate::contract`]), the fault matrix
//! ([`crate::matrix`]) and the closed loop ([`crate::closed_loop`]). A new device on a serial line implements
//! [`SerialDevice`] and has two rigs, in memory and over a pseudo terminal. Any other device implements
//! `Rig`. [`all`] lists the rigs; the rig of the Falcon on QEMU's USB is in the guest
//! (`bin/falcon-guest/remote_rig.rs`).

mod falcon;
mod link;
mod maker;
mod makers;
mod polhem;
mod serial;

pub use falcon::FalconRig;
pub use link::on_gantry;
pub use maker::{MakerDevice, MakerRig};
pub use makers::{InverseDevice, OmegaDevice, TouchDevice};
pub use serial::{SerialDevice, SerialRig, Wire};

use crate::fault::{FaultCounts, FaultKind, Faults};
use crate::force_record::ForceRecord;
use crate::link::EmulatedLink;
use crate::mechanism::Waypoint;
use crate::polhem::EmulatedPolhem;
use core::error::Error;
use palpate_core::Vec3;
use palpate_host::Device;
use palpate_host::device::hand::Drag;
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;

/// Mass and friction of a device's mechanism from its profile, or the assumed values.
fn drag(profile: &Profile) -> Drag {
    let (known, assumed) = (&profile.mechanism, profile.assumed);
    Drag {
        mass_kg: known.mass_kg.unwrap_or(assumed.mass_kg),
        damping_n_s_m: known.damping.map_or(assumed.damping_n_s_m, |damping| damping.n_s_m),
        coulomb_n: known.coulomb_n.unwrap_or(assumed.coulomb_n),
    }
}

/// Properties of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Traits {
    /// It must be homed before it gives positions.
    pub homes: bool,
    /// Time is virtual, and only blocking calls and the rig advance it.
    pub virtual_time: bool,
    /// Middle of the workspace, device frame, m. The hand is there after homing.
    pub middle_m: Vec3,
    /// Largest error of a position with correct encoder counts, m.
    pub count_m: f32,
    /// Largest error of a force with correct motor steps, N.
    pub motor_step_n: f32,
    /// Requests are protected by a checksum up to the motors, so a corrupted one is never executed.
    pub checked_requests: bool,
    /// Replies carry the number of their request.
    pub numbered_replies: bool,
    /// It has a watchdog of its own.
    pub has_watchdog: bool,
    /// Its maker's library hides the frames of its link, and the process that holds the library is its guard.
    pub behind_library: bool,
}

/// Why a driver could not be opened.
pub type OpenError = Box<dyn Error + Send + Sync>;

/// An emulated device on a transport, and its real driver.
///
/// Times are the driver's: us since it was opened. The device's own clock runs across openings.
pub trait Rig {
    /// Device and transport, for display.
    fn name(&self) -> String;

    /// The profile of the driver.
    fn profile(&self) -> &Profile;

    /// Properties of the device.
    fn traits(&self) -> Traits;

    /// Opens the real driver as a program does. Its clock starts at 0 on return. An earlier driver may still
    /// exist.
    fn open(&mut self, workspace: Workspace) -> Result<Box<dyn Device>, OpenError>;

    /// Advances the device to a time of the driver's clock.
    fn advance(&mut self, now_us: u64);

    /// As [`Rig::advance`], and records the true position of the grip every `every_us`, starting at
    /// `from_us`.
    fn advance_noting(&mut self, from_us: u64, until_us: u64, every_us: u64, truth: &mut Vec<(u64, Vec3)>) {
        let mut now_us = from_us;
        while now_us < until_us {
            truth.push((now_us, self.position_m()));
            now_us = (now_us + every_us).min(until_us);
            self.advance(now_us);
        }
    }

    /// The device's time on the driver's clock, us. On virtual time it is ahead of the last [`Rig::advance`]
    /// by the waits of the driver's calls.
    fn now_us(&self) -> u64;

    /// Record of the force on the hand; its times are on the driver's clock.
    fn force_record(&self) -> ForceRecord;

    /// Resets the record of the force on the hand.
    fn reset_record(&mut self);

    /// True position of the grip, device frame, m.
    fn position_m(&self) -> Vec3;

    /// Position reported by the encoders, device frame, m.
    fn reported_m(&self) -> Vec3;

    /// Gives the hand another path; device frame, times from now.
    fn follow(&mut self, path: Vec<Waypoint>);

    /// Presses these buttons.
    fn press(&mut self, buttons: u8);

    /// Sets the faults of the link to the device and to the host from now on.
    fn set_faults(&mut self, to_device: Faults, to_host: Faults);

    /// Counts of link faults since the driver was opened, both directions together.
    fn counts(&self) -> FaultCounts;

    /// Counts of link faults to the device and to the host; `None` if the rig does not know.
    fn counts_each(&self) -> Option<[FaultCounts; 2]> {
        None
    }

    /// Time at which the device sent the newest data that the driver has received, on the driver's clock, us.
    /// No sample is newer. `None` without data, or if the rig does not know.
    fn last_received_us(&self) -> Option<u64> {
        None
    }

    /// Plugs the cable in again.
    fn replug(&mut self);

    /// Writes the guard's message to the latest driver's end of a link in memory, to which a guard has no path.
    fn write_past_driver(&mut self, _message: &[u8]) -> Result<(), OpenError> {
        Err("a guard has its own path to this device".into())
    }

    /// Injects a fault of the cable or the device: [`FaultKind::Replug`] and [`FaultKind::UnplugMidFrame`] pull
    /// the cable, until [`Rig::replug`]. Returns false if the device does not support it or the fault is another.
    fn inject(&mut self, fault: FaultKind) -> bool;

    /// Lets the encoder of an axis or motor miscount from now on, by about `by_m` at the handle.
    fn jump_encoder(&mut self, axis: usize, by_m: f32);
}

/// A kind of rig, which is created with a seed for its faults.
#[derive(Debug, Clone, Copy)]
pub struct RigKind {
    /// Name on the command line and in tables.
    pub name: &'static str,
    /// Whether it runs on virtual time, without waiting.
    pub in_memory: bool,
    /// Creates a rig.
    pub make: fn(u64) -> Box<dyn Rig>,
}

/// All kinds of rig.
#[must_use]
pub fn all() -> Vec<RigKind> {
    vec![
        RigKind { name: "falcon-memory", in_memory: true, make: |seed| Box::new(FalconRig::new(seed)) },
        RigKind {
            name: "falcon-threads",
            in_memory: true,
            make: |seed| Box::new(FalconRig::with_threads(seed)),
        },
        RigKind {
            name: "link-memory",
            in_memory: true,
            make: |seed| Box::new(SerialRig::<EmulatedLink>::new(Wire::Memory, seed)),
        },
        RigKind {
            name: "link-pty",
            in_memory: false,
            make: |seed| Box::new(SerialRig::<EmulatedLink>::new(Wire::Pty, seed)),
        },
        RigKind {
            name: "polhem-memory",
            in_memory: true,
            make: |seed| Box::new(SerialRig::<EmulatedPolhem>::new(Wire::Memory, seed)),
        },
        RigKind {
            name: "polhem-pty",
            in_memory: false,
            make: |seed| Box::new(SerialRig::<EmulatedPolhem>::new(Wire::Pty, seed)),
        },
        RigKind {
            name: "touch-library",
            in_memory: true,
            make: |seed| Box::new(MakerRig::<TouchDevice>::new(seed)),
        },
        RigKind {
            name: "omega-library",
            in_memory: true,
            make: |seed| Box::new(MakerRig::<OmegaDevice>::new(seed)),
        },
        RigKind {
            name: "haply-service",
            in_memory: false,
            make: |seed| Box::new(MakerRig::<InverseDevice>::new(seed)),
        },
    ]
}
