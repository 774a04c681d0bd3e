//! A reference controller in parallel with the loop: the force that the motors must apply to the hand, in
//! each tick before and after the fault.
//!
//! A wrong sign or scale of the force violates no limit on its size, because the clamp follows it. So the
//! force at the motors is compared with that of a second controller, which receives the true position of the
//! grip from the rig instead of the position from driver and link.

use crate::rig::OpenError;
use crate::session::Bench;
use crate::shadow::Shadow;
use palpate_core::{Organ, Vec3, vec3};
use palpate_host::device::workspace::Workspace;

/// Largest error of the force at the motors: absolute in N, and relative to the organ's force. Two ticks of a
/// pressing hand, an encoder step and a motor step amount to 0.05 N (the worst of 400 runs, and of each
/// device).
const TOLERANCE_N: f32 = 0.1;
const TOLERANCE_SHARE: f32 = 0.1;

/// A controller on the true position of the grip.
pub(super) struct ReferenceController<'o> {
    organ: Shadow<'o>,
    workspace: Workspace,
    /// It uses the reported position, because an encoder miscounts.
    by_encoders: bool,
}

/// The force of the motors on the hand, and the reference force.
#[derive(Debug, Clone, Copy)]
pub(super) struct ForcePair {
    felt_n: Vec3,
    pub(super) organ_n: Vec3,
}

impl<'o> ReferenceController<'o> {
    /// With the settings of the loop.
    pub(super) fn of(bench: &Bench<'_, '_>, organ: &'o Organ<'o>) -> Result<Self, OpenError> {
        let organ = Shadow::new(organ, bench.config())?;
        Ok(Self { organ, workspace: bench.workspace(), by_encoders: false })
    }

    /// From now on uses the reported position, because the loop cannot detect a small miscount.
    pub(super) const fn use_encoders(&mut self) {
        self.by_encoders = true;
    }

    /// The loop was armed again.
    pub(super) fn arm(&mut self) {
        self.organ.arm();
    }

    /// The forces of this tick. Must be called in each tick, because the controller has a state.
    pub(super) fn compare(&mut self, bench: &Bench<'_, '_>) -> ForcePair {
        let device_m = if self.by_encoders { bench.rig.reported_m() } else { bench.rig.position_m() };
        let (organ_n, _) = self.organ.at(bench.now_us(), &self.workspace, device_m);
        ForcePair { felt_n: bench.rig.force_record().force_n, organ_n }
    }
}

impl ForcePair {
    pub(super) fn error_n(&self) -> f32 {
        vec3::distance(self.felt_n, self.organ_n)
    }

    pub(super) fn violation(&self) -> Option<&'static str> {
        let Self { felt_n, organ_n } = *self;
        let exceeds = self.error_n() > TOLERANCE_N + TOLERANCE_SHARE * vec3::norm(organ_n);
        let pulls = vec3::dot(felt_n, organ_n) < 0.0;
        exceeds.then_some(if pulls { "the organ pulls" } else { "the force is not the organ's" })
    }
}
