//! A rig: one emulated device at the far end of one transport, with the real driver on this side of it.
//!
//! ```text
//! contract, matrix, closed loop -> Device (the real driver) -> transport, faults -> emulated device -> hand
//!            |------------------------------- Rig: time, hand, mishaps, what was felt ---------------|
//! ```
//!
//! What is asked of every device is asked of a [`Rig`]: the contract suite ([`crate::contract`]), the fault matrix ([`crate::matrix`]) and the
//! closed loop ([`crate::closed_loop`]). A new device on a serial line is one [`SerialDevice`] and comes with two rigs, in memory and over a
//! pseudo terminal; any other is one `Rig`. [`all`] lists what there is; the Falcon on QEMU's bus is a rig of the guest's
//! (`bin/falcon-guest/far.rs`).

mod falcon;
mod link;
mod polhem;
mod serial;

pub use falcon::FalconRig;
pub use link::on_a_gantry;
pub use serial::{SerialDevice, SerialRig, Wire};

use crate::fault::{FaultCounts, Faults};
use crate::felt::Felt;
use crate::handed::Holder;
use crate::link::EmulatedLink;
use crate::mechanism::Waypoint;
use crate::polhem::EmulatedPolhem;
use core::error::Error;
use palpate_core::Vec3;
use palpate_host::Device;
use palpate_host::device::hand::Drag;
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;

/// What the mechanism of a device does to the hand on it, as its profile knows it, or else assumes it.
fn drag(profile: &Profile) -> Drag {
    let (known, assumed) = (&profile.mechanism, profile.assumed);
    Drag {
        mass_kg: known.mass_kg.unwrap_or(assumed.mass_kg),
        damping_n_s_m: known.damping.map_or(assumed.damping_n_s_m, |damping| damping.n_s_m),
        coulomb_n: known.coulomb_n.unwrap_or(assumed.coulomb_n),
    }
}

/// What a device needs and how exact it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Traits {
    /// It must be homed before it knows where it is.
    pub homes: bool,
    /// Time is the rig's: a call that waits moves it, and nothing else does.
    pub virtual_time: bool,
    /// Middle of where the hand can go, device frame, m. A new rig's hand ends up there once it is homed.
    pub middle_m: Vec3,
    /// How far from the truth a position may be that is right to a count of every encoder, m.
    pub count_m: f32,
    /// How far from what was asked a force may be that is right to a step of every motor, N.
    pub motor_step_n: f32,
    /// Requests carry a checksum, or the bus under them does all the way to the motors: a damaged one is never taken for another.
    pub checked_requests: bool,
    /// Replies say which request they answer.
    pub numbered_replies: bool,
    /// It takes the force away itself when its host is gone; any other has a supervisor in the product.
    pub has_watchdog: bool,
}

impl Traits {
    /// Who holds it in the product.
    #[must_use]
    pub const fn holder(&self) -> Holder {
        if self.has_watchdog { Holder::Loop } else { Holder::Supervisor }
    }
}

/// What may happen to a device beside its link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mishap {
    /// One encoder miscounts: the position is about so far off from now on, m.
    EncoderJump {
        /// Axis of the device, or motor.
        axis: usize,
        /// By how much at the handle, m.
        by_m: f32,
    },
    /// It forgets where it was homed.
    LoseHoming,
    /// Its power goes and comes back; the cable stays in.
    PowerCycle,
}

/// Where in the traffic the cable is pulled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cut {
    /// Between two requests.
    Between,
    /// In the middle of the request that is on its way.
    MidFrame,
}

/// Why a driver could not be opened.
pub type OpenError = Box<dyn Error + Send + Sync>;

/// An emulated device on a transport, and the way to the real driver for it.
///
/// Times are the driver's: us since it was opened. The device's own clock goes on through all openings.
pub trait Rig {
    /// Device and transport, for people.
    fn name(&self) -> String;

    /// The profile that the driver is opened with.
    fn profile(&self) -> &Profile;

    /// What it needs and how exact it is.
    fn traits(&self) -> Traits;

    /// Opens the real driver, as a program does. Its clock begins at 0 when this returns. An earlier one may still be alive.
    fn open(&mut self, workspace: Workspace) -> Result<Box<dyn Device>, OpenError>;

    /// The device's turn: everything up to a time of the driver's.
    fn advance(&mut self, now_us: u64);

    /// As [`Rig::advance`] from one time to a later one; writes down where the grip really is at the first, and then every so many us.
    fn advance_noting(&mut self, from_us: u64, until_us: u64, every_us: u64, truth: &mut Vec<(u64, Vec3)>) {
        let mut now_us = from_us;
        while now_us < until_us {
            truth.push((now_us, self.position_m()));
            now_us = (now_us + every_us).min(until_us);
            self.advance(now_us);
        }
    }

    /// The device's time on the driver's clock, us. Ahead of the last [`Rig::advance`] by what calls of the driver have waited, where
    /// time is virtual.
    fn now_us(&self) -> u64;

    /// What the hand felt; its times are on the driver's clock.
    fn felt(&self) -> Felt;

    /// Begins the record of what the hand felt anew.
    fn forget(&mut self);

    /// Where the grip really is, device frame, m.
    fn position_m(&self) -> Vec3;

    /// Where its encoders say that it is, now, device frame, m.
    fn reported_m(&self) -> Vec3;

    /// The hand leaves what it does for another path; device frame, times from now.
    fn follow(&mut self, path: Vec<Waypoint>);

    /// The hand holds these buttons.
    fn press(&mut self, buttons: u8);

    /// What goes wrong on the way to the device and back, from here on.
    fn set_faults(&mut self, to_device: Faults, to_host: Faults);

    /// What went wrong since the driver was opened, both ways.
    fn counts(&self) -> FaultCounts;

    /// The same on the way to the device and on the way back; nothing where the rig cannot tell.
    fn counts_each(&self) -> Option<[FaultCounts; 2]> {
        None
    }

    /// When the device had sent the newest of what has come through to the driver, on the driver's clock, us: no sample is younger. Nothing
    /// if nothing has come, or where the rig cannot tell.
    fn heard_us(&self) -> Option<u64> {
        None
    }

    /// Pulls the cable.
    fn unplug(&mut self, cut: Cut);

    /// Puts it in again.
    fn replug(&mut self);

    /// Something happens to the device. False if it cannot happen to this one.
    fn strike(&mut self, mishap: Mishap) -> bool;
}

/// A rig, made anew with a seed for its faults.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// Name on the command line and in tables.
    pub name: &'static str,
    /// Whether it runs on virtual time, and as fast as it computes.
    pub in_memory: bool,
    /// Makes one.
    pub make: fn(u64) -> Box<dyn Rig>,
}

/// Every rig there is.
#[must_use]
pub fn all() -> Vec<Kind> {
    vec![
        Kind { name: "falcon-memory", in_memory: true, make: |seed| Box::new(FalconRig::new(seed)) },
        Kind {
            name: "falcon-threads",
            in_memory: true,
            make: |seed| Box::new(FalconRig::with_threads(seed)),
        },
        Kind {
            name: "link-memory",
            in_memory: true,
            make: |seed| Box::new(SerialRig::<EmulatedLink>::new(Wire::Memory, seed)),
        },
        Kind {
            name: "link-pty",
            in_memory: false,
            make: |seed| Box::new(SerialRig::<EmulatedLink>::new(Wire::Pty, seed)),
        },
        Kind {
            name: "polhem-memory",
            in_memory: true,
            make: |seed| Box::new(SerialRig::<EmulatedPolhem>::new(Wire::Memory, seed)),
        },
        Kind {
            name: "polhem-pty",
            in_memory: false,
            make: |seed| Box::new(SerialRig::<EmulatedPolhem>::new(Wire::Pty, seed)),
        },
    ]
}
