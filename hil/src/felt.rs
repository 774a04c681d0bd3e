//! What the hand on an emulated device felt: the same record for every device, so that one contract and one matrix can judge them all.

use crate::session::TICK_US;
use palpate_core::{Vec3, vec3};

/// By how much less than it should two commands may be apart, us: half a tick.
const JITTER_US: u64 = 500;

/// What the hand felt since it was last asked to forget.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Felt {
    /// Force of the motors on the hand now, device frame, N.
    pub force_n: Vec3,
    /// Largest force, N.
    pub largest_force_n: f32,
    /// Largest force while the device was not homed, N.
    pub largest_unhomed_n: f32,
    /// Largest change of the force between two commands, the second not zero, N.
    pub largest_step_n: f32,
    /// Fastest change of the force from one command to the next, the second not zero, N/s.
    pub steepest_n_per_s: f32,
    /// Largest change of the force by a command of zero, N.
    pub largest_drop_n: f32,
    /// Largest number in a command, as the device counts: motor counts, mN.
    pub largest_motor: u16,
    /// Commands.
    pub commands: u64,
    /// When the last one came, us.
    pub last_command_us: Option<u64>,
    /// Since when the motors have been without a command, us; nothing while they have one.
    pub off_since_us: Option<u64>,
    /// Work of the motors on the hand, J: above 0, it was given energy.
    pub work_j: f64,
    /// What the friction of the mechanism took of it, J: never below 0.
    pub drag_j: f64,
}

impl Felt {
    /// Nothing yet, motors off.
    pub(crate) const fn nothing(now_us: u64) -> Self {
        Self {
            force_n: vec3::ZERO,
            largest_force_n: 0.0,
            largest_unhomed_n: 0.0,
            largest_step_n: 0.0,
            steepest_n_per_s: 0.0,
            largest_drop_n: 0.0,
            largest_motor: 0,
            commands: 0,
            last_command_us: None,
            off_since_us: Some(now_us),
            work_j: 0.0,
            drag_j: 0.0,
        }
    }

    /// A command came: the force is another one, and motors without a command are off.
    pub(crate) fn command(&mut self, at_us: u64, force_n: Vec3, motors: [i16; 3], homed: bool) {
        let off = motors == [0; 3];
        let changed_n = vec3::distance(force_n, self.force_n);
        if let Some(before_us) = self.last_command_us.filter(|_| !off) {
            // A force that had ended by itself has to rise anew, however long nobody asked for one.
            let expired = self.off_since_us.is_some_and(|off_us| off_us > before_us);
            let since_us = if expired { TICK_US } else { at_us.saturating_sub(before_us) };
            let seconds = 1e-6 * (since_us + JITTER_US) as f32;
            self.steepest_n_per_s = self.steepest_n_per_s.max(changed_n / seconds);
        }
        self.commands += 1;
        self.last_command_us = Some(at_us);
        self.switch(at_us, off);
        self.feel(force_n);
        let change = if off { &mut self.largest_drop_n } else { &mut self.largest_step_n };
        *change = change.max(changed_n);
        let largest = motors.map(i16::unsigned_abs).into_iter().max().unwrap_or(0);
        self.largest_motor = self.largest_motor.max(largest);
        if !homed {
            self.largest_unhomed_n = self.largest_unhomed_n.max(vec3::norm(force_n));
        }
    }

    /// The motors have a command, or none.
    pub(crate) fn switch(&mut self, at_us: u64, off: bool) {
        if off {
            self.off_since_us.get_or_insert(at_us);
        } else {
            self.off_since_us = None;
        }
    }

    /// The same command is another force where the hand is now.
    pub(crate) fn feel(&mut self, force_n: Vec3) {
        self.force_n = force_n;
        self.largest_force_n = self.largest_force_n.max(vec3::norm(force_n));
    }

    /// The hand moved under the force, and the mechanism took its part.
    pub(crate) fn moved(&mut self, by_m: Vec3, drag_j: f32) {
        self.work_j += f64::from(vec3::dot(self.force_n, by_m));
        self.drag_j += f64::from(drag_j);
    }

    /// Begins anew; what acts now goes on to act.
    pub(crate) fn forget(&mut self) {
        let Self { force_n, last_command_us, off_since_us, .. } = *self;
        *self = Self { force_n, last_command_us, off_since_us, ..Self::nothing(0) };
        self.largest_force_n = vec3::norm(force_n);
    }

    /// The same with its times on a clock that began at `begun_us`.
    #[must_use]
    pub(crate) fn on_clock(self, begun_us: u64) -> Self {
        let on_clock = |us: Option<u64>| us.map(|us| us.saturating_sub(begun_us));
        let (last_command_us, off_since_us) = (on_clock(self.last_command_us), on_clock(self.off_since_us));
        Self { last_command_us, off_since_us, ..self }
    }

    /// Energy that the hand got out of motors and mechanism together, J: below 0 for what takes more than it gives.
    #[must_use]
    pub const fn given_j(&self) -> f64 {
        self.work_j - self.drag_j
    }
}
