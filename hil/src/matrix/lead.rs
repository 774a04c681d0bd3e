//! Before the fault: the hand presses into the organ, and must be pushed back out of it, as hard as the organ pushes.
//!
//! A wrong sign or scale of the force breaks no limit that is on its size, because the clamp is behind it: so the force at the motors is held each
//! tick against a controller of its own, which knows from the rig where the grip really is. What driver and link say of the place is not asked.

use crate::rig::{OpenError, Rig};
use crate::session::{Bench, on_organ, settings};
use crate::shadow::Shadow;
use palpate_core::{Method, Organ, Phase, vec3};
use palpate_host::device::workspace::Workspace;

/// How far the force at the motors may be from the organ's: N, and of the organ's. Two ticks of a hand that presses, a step of the encoders and one of
/// the motors come to 0.05 N (the worst of 400 runs, and of each device).
const TOLERANCE_N: f32 = 0.1;
const TOLERANCE: f32 = 0.1;
/// Least that a press must push back at its end, N.
const FELT_N: f32 = 0.2;

/// A press, with the organ beside it.
pub(super) struct Lead<'o> {
    organ: Shadow<'o>,
    workspace: Workspace,
}

/// What came of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Led {
    /// Furthest that the force at the motors was from the organ's, N.
    pub(super) off_n: f32,
    /// When the newest sample was taken, as the driver says.
    pub(super) newest_us: Option<u64>,
    flaw: Option<&'static str>,
}

impl<'o> Lead<'o> {
    pub(super) fn of(rig: &dyn Rig, organ: &'o Organ<'o>) -> Result<Self, OpenError> {
        let workspace = on_organ(organ, rig.profile());
        let config = settings(organ, rig.profile(), workspace, Method::Energy);
        Ok(Self { organ: Shadow::new(organ, config)?, workspace })
    }

    /// So many ticks of a loop that is armed and a hand that presses.
    pub(super) fn run(mut self, bench: &mut Bench<'_, '_>, ticks: u64) -> Result<Led, OpenError> {
        let mut led = Led { off_n: 0.0, newest_us: None, flaw: None };
        let mut last = (Phase::Disarmed, 0.0);
        for _ in 0..ticks {
            let (device_m, felt_n) = (bench.rig.position_m(), bench.rig.felt().force_n);
            let (organ_n, _) = self.organ.at(bench.now_us(), &self.workspace, device_m);
            let off_n = vec3::distance(felt_n, organ_n);
            led.off_n = led.off_n.max(off_n);
            if off_n > TOLERANCE_N + TOLERANCE * vec3::norm(organ_n) {
                let pulls = vec3::dot(felt_n, organ_n) < 0.0;
                led.flaw.get_or_insert(if pulls {
                    "the organ pulls"
                } else {
                    "the force is not the organ's"
                });
            }
            let record = bench.step()?;
            led.newest_us = record.sample.map(|sample| sample.t_us).max(led.newest_us);
            last = (record.phase, vec3::norm(organ_n));
        }
        if last.0 != Phase::Active {
            led.flaw.get_or_insert("a fault before there was one");
        } else if last.1 < FELT_N {
            led.flaw.get_or_insert("nothing was felt where the organ is");
        }
        Ok(led)
    }
}

impl Led {
    /// What of a press it was not.
    pub(super) const fn broken(&self) -> Option<&'static str> {
        self.flaw
    }
}
