//! The phase before the fault: the hand presses into the organ, and the organ must push it back with the
//! right force.

use super::reference::ReferenceController;
use crate::rig::OpenError;
use crate::session::Bench;
use palpate_core::{Phase, vec3};

/// Smallest force on the hand at the end of the press, N.
const MIN_FORCE_N: f32 = 0.2;

/// Result of the press.
#[derive(Debug, Clone, Copy)]
pub(super) struct Approach {
    /// Largest error of the force at the motors relative to the organ's force, N.
    pub(super) error_n: f32,
    /// Time stamp of the newest sample.
    pub(super) newest_us: Option<u64>,
    /// The first violation.
    pub(super) violation: Option<&'static str>,
}

/// Presses with the armed loop for some ticks.
pub(super) fn approach(
    bench: &mut Bench<'_, '_>,
    organ: &mut ReferenceController<'_>,
    ticks: u64,
) -> Result<Approach, OpenError> {
    let mut approach = Approach { error_n: 0.0, newest_us: None, violation: None };
    let mut last = (Phase::Disarmed, 0.0);
    for _ in 0..ticks {
        let forces = organ.compare(bench);
        approach.error_n = approach.error_n.max(forces.error_n());
        approach.violation = approach.violation.or(forces.violation());
        let record = bench.step()?;
        approach.newest_us = record.sample.map(|sample| sample.t_us).max(approach.newest_us);
        last = (record.phase, vec3::norm(forces.organ_n));
    }
    if last.0 != Phase::Active {
        approach.violation = approach.violation.or(Some("a latched fault before the injection"));
    } else if last.1 < MIN_FORCE_N {
        approach.violation = approach.violation.or(Some("no contact force at the organ"));
    }
    Ok(approach)
}
