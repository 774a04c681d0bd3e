//! Before the fault: the hand presses into the organ, and must be pushed back out of it, as hard as the organ pushes.

use super::beside::Beside;
use crate::rig::OpenError;
use crate::session::Bench;
use palpate_core::{Phase, vec3};

/// Least that a press must push back at its end, N.
const FELT_N: f32 = 0.2;

/// What came of a press.
#[derive(Debug, Clone, Copy)]
pub(super) struct Led {
    /// Furthest that the force at the motors was from the organ's, N.
    pub(super) off_n: f32,
    /// When the newest sample was taken, as the driver says.
    pub(super) newest_us: Option<u64>,
    /// What of a press it was not.
    pub(super) flaw: Option<&'static str>,
}

/// So many ticks of a loop that is armed and a hand that presses.
pub(super) fn lead(bench: &mut Bench<'_, '_>, organ: &mut Beside<'_>, ticks: u64) -> Result<Led, OpenError> {
    let mut led = Led { off_n: 0.0, newest_us: None, flaw: None };
    let mut last = (Phase::Disarmed, 0.0);
    for _ in 0..ticks {
        let both = organ.look(bench);
        led.off_n = led.off_n.max(both.off_n());
        led.flaw = led.flaw.or(both.flaw());
        let record = bench.step()?;
        led.newest_us = record.sample.map(|sample| sample.t_us).max(led.newest_us);
        last = (record.phase, vec3::norm(both.organ_n));
    }
    if last.0 != Phase::Active {
        led.flaw = led.flaw.or(Some("a fault before there was one"));
    } else if last.1 < FELT_N {
        led.flaw = led.flaw.or(Some("nothing was felt where the organ is"));
    }
    Ok(led)
}
