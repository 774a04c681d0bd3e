//! The organ beside the loop: what the motors must do to the hand, each tick, before the fault and after it.
//!
//! A wrong sign or scale of the force breaks no limit that is on its size, because the clamp is behind it: so the force at the motors is held
//! against a controller of its own, which knows from the rig where the grip really is. What driver and link say of the place is not asked.

use crate::rig::{OpenError, Rig};
use crate::session::{Bench, on_organ, settings};
use crate::shadow::Shadow;
use palpate_core::{Method, Organ, Vec3, vec3};
use palpate_host::device::workspace::Workspace;

/// How far the force at the motors may be from the organ's: N, and of the organ's. Two ticks of a hand that presses, a step of the encoders and one of
/// the motors come to 0.05 N (the worst of 400 runs, and of each device).
const TOLERANCE_N: f32 = 0.1;
const TOLERANCE: f32 = 0.1;

/// A controller that sees the hand itself.
pub(super) struct Beside<'o> {
    organ: Shadow<'o>,
    workspace: Workspace,
    /// It goes by the encoders, because one of them miscounts.
    by_encoders: bool,
}

/// What the motors do to the hand, and what the organ would.
#[derive(Debug, Clone, Copy)]
pub(super) struct Both {
    felt_n: Vec3,
    pub(super) organ_n: Vec3,
}

impl<'o> Beside<'o> {
    pub(super) fn of(rig: &dyn Rig, organ: &'o Organ<'o>) -> Result<Self, OpenError> {
        let workspace = on_organ(organ, rig.profile());
        let config = settings(organ, rig.profile(), workspace, Method::Energy);
        Ok(Self { organ: Shadow::new(organ, config)?, workspace, by_encoders: false })
    }

    /// From now on an encoder may say something else than where the hand is, and nobody can know.
    pub(super) const fn go_by_encoders(&mut self) {
        self.by_encoders = true;
    }

    /// The loop was armed anew.
    pub(super) fn arm(&mut self) {
        self.organ.arm();
    }

    /// Of now. Each tick, for it has a history as the loop has.
    pub(super) fn look(&mut self, bench: &Bench<'_, '_>) -> Both {
        let device_m = if self.by_encoders { bench.rig.reported_m() } else { bench.rig.position_m() };
        let (organ_n, _) = self.organ.at(bench.now_us(), &self.workspace, device_m);
        Both { felt_n: bench.rig.felt().force_n, organ_n }
    }
}

impl Both {
    pub(super) fn off_n(&self) -> f32 {
        vec3::distance(self.felt_n, self.organ_n)
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        let Self { felt_n, organ_n } = *self;
        let is_off = self.off_n() > TOLERANCE_N + TOLERANCE * vec3::norm(organ_n);
        let pulls = vec3::dot(felt_n, organ_n) < 0.0;
        is_off.then_some(if pulls { "the organ pulls" } else { "the force is not the organ's" })
    }
}
