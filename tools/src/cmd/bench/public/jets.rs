//! The jets of a live solver as the field of a controller, for one contact and in simulated time.

use std::time::Duration;

use nalgebra::Vector3;
use palpate_core::{Field, ForceSample, Touch, Vec3};
use palpate_precompute::live::LiveSolver;

use crate::cmd::bench::live::simulation::Beside;

/// A solver beside the loop, which answers for the one contact that is touched.
pub(super) struct Jets<'s> {
    beside: Beside<'s>,
    contact: u16,
    period_s: f64,
}

impl<'s> Jets<'s> {
    /// Those of a solver that has solved what a tool that comes near finds solved; the loop has this period.
    pub(super) fn new(solver: &'s mut LiveSolver, contact: u16, period_s: f64) -> Self {
        Self { beside: Beside::new(solver, contact, Vector3::zeros(), 1.0), contact, period_s }
    }

    /// The time of the solver since the last call, which in a session passes in another process.
    pub(super) fn take_solving(&mut self) -> Duration {
        self.beside.take_solving()
    }
}

impl Field for Jets<'_> {
    fn force(&mut self, touch: &Touch) -> Option<ForceSample> {
        Some(self.beside.force(touch, self.period_s))
    }

    fn energy_j(&self, _: u16, displacement_m: Vec3) -> Option<f32> {
        self.beside.memory().energy_j(self.contact, displacement_m)
    }

    fn released(&mut self, now_us: u64) {
        self.beside.memory_mut().released(now_us);
    }
}
