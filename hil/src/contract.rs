//! One contract for every device on every transport: what a driver promises the loop, checked on a rig.
//!
//! A check makes its own rig, so that the checks know nothing of each other. It runs in virtual time where the rig can; a rig over a real
//! transport goes in step, so that no check depends on how busy the machine is.

use crate::rig::{Kind, OpenError, Rig, Traits};
use crate::session::Session;
use core::fmt;
use palpate_core::{Sample, Vec3, vec3};
use palpate_host::device::workspace::Workspace;
use palpate_host::{DeviceError, DeviceErrorKind};

macro_rules! ensure {
    ($holds:expr, $($why:tt)+) => {
        let holds: bool = $holds;
        if !holds {
            return Err(Broken(format!($($why)+)));
        }
    };
}

mod force;
mod in_the_loop;
mod samples;

/// What was promised and not kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broken(String);

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for Broken {}

impl From<OpenError> for Broken {
    fn from(error: OpenError) -> Self {
        Self(format!("cannot be opened: {error}"))
    }
}

impl From<DeviceError> for Broken {
    fn from(error: DeviceError) -> Self {
        Self(format!("exchange: {error}"))
    }
}

/// One point of the contract.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// What is promised.
    pub name: &'static str,
    run: fn(Kind) -> Result<(), Broken>,
}

impl Check {
    /// Holds a rig to it.
    pub fn run(&self, kind: Kind) -> Result<(), Broken> {
        (self.run)(kind)
    }
}

/// All of it.
pub const CHECKS: [Check; 16] = [
    Check { name: "it says what it is and never arms itself", run: force::says_what_it_is },
    Check { name: "forces arrive with their size, axis and sign", run: force::forces_arrive },
    Check { name: "no force and no sample before it is homed", run: force::nothing_before_homing },
    Check { name: "no force before it is armed", run: in_the_loop::nothing_before_arming },
    Check {
        name: "no force beyond the profile's limit, whatever is asked",
        run: force::never_beyond_the_limit,
    },
    Check { name: "positions are right within a count", run: samples::positions_are_right },
    Check { name: "stamps are never younger than the truth", run: samples::stamps_are_not_too_young },
    Check { name: "a late reply never passes for a fresh one", run: samples::late_is_not_fresh },
    Check { name: "silence is reported and brings no samples", run: samples::silence_is_reported },
    Check { name: "an exchange does not wait, whatever the link does", run: samples::exchanges_do_not_wait },
    Check {
        name: "zero goes out at once, also while the link is in disorder",
        run: force::zero_goes_at_once,
    },
    Check { name: "zero after stop, second handle and drop", run: force::zero_after_stop },
    Check {
        name: "zero after disarming, the end of the loop and a panic in it",
        run: in_the_loop::zero_after_the_loop,
    },
    Check { name: "homing that is lost takes force and samples away", run: in_the_loop::lost_homing },
    Check {
        name: "a latched fault stays, on a sound link and pressed anew",
        run: in_the_loop::latched_stays,
    },
    Check {
        name: "unplugged is gone for good; nothing resumes by itself",
        run: in_the_loop::unplugged_is_gone,
    },
];

/// Model x is device y, y is z, z is x; the model's origin is the middle of the workspace.
fn turned(traits: &Traits) -> Workspace {
    Workspace {
        axes: [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        scale: 1.0,
        device_origin_m: traits.middle_m,
        model_origin_m: vec3::ZERO,
    }
}

/// The same, written out once more.
const fn in_device([x, y, z]: Vec3) -> Vec3 {
    [z, x, y]
}

fn in_model(traits: &Traits, device_m: Vec3) -> Vec3 {
    let [x, y, z] = vec3::sub(device_m, traits.middle_m);
    [y, z, x]
}

fn made(kind: Kind) -> (Box<dyn Rig>, Traits) {
    let rig = (kind.make)(7);
    let traits = rig.traits();
    (rig, traits)
}

fn kind_of(exchanged: Result<Option<Sample>, DeviceError>) -> Option<DeviceErrorKind> {
    exchanged.err().map(|error| error.kind())
}

/// Asks for a force for some ticks; what breaks in passing is the link's affair.
fn ask(session: &mut Session<'_>, force_n: Vec3, ticks: u32) -> Result<(), Broken> {
    for _ in 0..ticks {
        match session.tick(force_n) {
            Err(error) if !error.kind().is_transient() => return Err(error.into()),
            _ => {}
        }
    }
    Ok(())
}
