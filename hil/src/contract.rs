//! The contract that every driver keeps towards the loop, on every device and transport.
//!
//! Each check makes its own rig, so the checks are independent. A check runs on virtual time where the rig
//! supports it. A rig on a real transport runs in lockstep, so that no check depends on the load of the
//! machine.

use crate::rig::{OpenError, Rig, RigKind, Traits};
use crate::session::Session;
use core::fmt;
use palpate_core::{Sample, Vec3, vec3};
use palpate_host::device::workspace::Workspace;
use palpate_host::{DeviceError, DeviceErrorKind};

macro_rules! ensure {
    ($holds:expr, $($why:tt)+) => {
        let holds: bool = $holds;
        if !holds {
            return Err(Violation(format!($($why)+)));
        }
    };
}

mod force;
mod in_the_loop;
mod samples;

/// A violated check and its reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation(String);

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for Violation {}

impl From<OpenError> for Violation {
    fn from(error: OpenError) -> Self {
        Self(format!("opening failed: {error}"))
    }
}

impl From<DeviceError> for Violation {
    fn from(error: DeviceError) -> Self {
        Self(format!("exchange: {error}"))
    }
}

/// One check of the contract.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// What the driver guarantees.
    pub name: &'static str,
    run: fn(RigKind) -> Result<(), Violation>,
}

impl Check {
    /// Runs the check on a rig.
    pub fn run(&self, kind: RigKind) -> Result<(), Violation> {
        (self.run)(kind)
    }
}

/// All checks.
pub const CHECKS: [Check; 16] = [
    Check { name: "the device describes itself and never arms itself", run: force::says_what_it_is },
    Check { name: "forces arrive with their size, axis and sign", run: force::forces_arrive },
    Check { name: "no force and no sample before homing", run: force::nothing_before_homing },
    Check { name: "no force before arming", run: in_the_loop::nothing_before_arming },
    Check { name: "no force beyond the profile's limit for any command", run: force::never_beyond_the_limit },
    Check { name: "positions are correct to one encoder count", run: samples::positions_are_right },
    Check {
        name: "time stamps are never later than the measurement",
        run: samples::stamps_are_not_too_young,
    },
    Check { name: "a late reply is never taken for a fresh one", run: samples::late_is_not_fresh },
    Check { name: "silence is reported and gives no samples", run: samples::silence_is_reported },
    Check { name: "an exchange does not block under any link fault", run: samples::exchanges_do_not_wait },
    Check { name: "zero is sent at once, also under link faults", run: force::zero_goes_at_once },
    Check { name: "zero after stop, emergency handle and drop", run: force::zero_after_stop },
    Check {
        name: "zero after disarming, the end of the loop and a panic",
        run: in_the_loop::zero_after_the_loop,
    },
    Check { name: "a loss of homing removes force and samples", run: in_the_loop::lost_homing },
    Check {
        name: "a latched fault stays latched on a fault-free link and in a new press",
        run: in_the_loop::latched_stays,
    },
    Check {
        name: "an unplugged device stays lost and nothing resumes by itself",
        run: in_the_loop::unplugged_is_gone,
    },
];

/// Model x is device y, model y is device z, model z is device x. The model's origin is the middle of the
/// workspace.
fn permuted(traits: &Traits) -> Workspace {
    Workspace {
        axes: [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        scale: 1.0,
        device_origin_m: traits.middle_m,
        model_origin_m: vec3::ZERO,
    }
}

/// The same mapping, written independently.
const fn in_device([x, y, z]: Vec3) -> Vec3 {
    [z, x, y]
}

fn in_model(traits: &Traits, device_m: Vec3) -> Vec3 {
    let [x, y, z] = vec3::sub(device_m, traits.middle_m);
    [y, z, x]
}

fn new_rig(kind: RigKind) -> (Box<dyn Rig>, Traits) {
    let rig = (kind.make)(7);
    let traits = rig.traits();
    (rig, traits)
}

fn error_kind(exchanged: Result<Option<Sample>, DeviceError>) -> Option<DeviceErrorKind> {
    exchanged.err().map(|error| error.kind())
}

/// Requests a force for some ticks; ignores transient errors of the link.
fn hold_force(session: &mut Session<'_>, force_n: Vec3, ticks: u32) -> Result<(), Violation> {
    for _ in 0..ticks {
        match session.tick(force_n) {
            Err(error) if !error.kind().is_transient() => return Err(error.into()),
            _ => {}
        }
    }
    Ok(())
}
