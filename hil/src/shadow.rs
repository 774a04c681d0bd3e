//! A second controller in parallel with the loop. It gives the organ's force at a position that comes from
//! neither driver nor link.

use crate::rig::OpenError;
use palpate_core::{Config, Controller, Organ, Sample, State, Vec3};
use palpate_host::device::workspace::Workspace;

/// A second controller, armed at the start. It receives a position in every tick.
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

    /// Arms it again: the state is reset, and the force fades in.
    pub(crate) fn arm(&mut self) {
        self.state = State::new();
        self.state.arm();
    }

    /// Force on the hand in the device frame, and whether the tool is in contact.
    pub(crate) fn at(&mut self, t_us: u64, workspace: &Workspace, device_m: Vec3) -> (Vec3, bool) {
        let sample = Sample { t_us, position_m: workspace.to_model_m(device_m), ..Sample::default() };
        let command = self.controller.tick(&mut self.state, t_us, Some(&sample));
        (workspace.to_device_n(command.hand_force_n), command.engaged.is_some())
    }

    /// Factor of the stiffness cap on every force.
    pub(crate) const fn force_scale(&self) -> f32 {
        self.controller.hand_scale()
    }
}
