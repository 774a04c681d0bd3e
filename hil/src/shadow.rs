//! A controller beside the loop: what the organ would do to the hand at a place that neither driver nor link has told.

use crate::rig::OpenError;
use palpate_core::{Config, Controller, Organ, Sample, State, Vec3};
use palpate_host::device::workspace::Workspace;

/// A controller beside the loop, armed from the beginning and given a place each tick.
pub(crate) struct Shadow<'o> {
    controller: Controller<'o, 'o>,
    state: State,
}

impl<'o> Shadow<'o> {
    pub(crate) fn new(organ: &'o Organ<'o>, config: Config) -> Result<Self, OpenError> {
        let mut shadow = Self { controller: Controller::new(organ, config)?, state: State::new() };
        shadow.arm();
        Ok(shadow)
    }

    /// Armed anew: what it knew of the hand is forgotten, and its force grows as one does after arming.
    pub(crate) fn arm(&mut self) {
        self.state = State::new();
        self.state.arm();
    }

    /// Force for the hand in the device's frame, and whether it touches.
    pub(crate) fn at(&mut self, t_us: u64, workspace: &Workspace, device_m: Vec3) -> (Vec3, bool) {
        let sample = Sample { t_us, position_m: workspace.to_model_m(device_m), buttons: 0 };
        let command = self.controller.tick(&mut self.state, t_us, Some(&sample));
        (workspace.to_device_n(command.hand_force_n), command.engaged.is_some())
    }

    /// What the cap on the stiffness scales every force by.
    pub(crate) const fn share(&self) -> f32 {
        self.controller.force_share()
    }
}
