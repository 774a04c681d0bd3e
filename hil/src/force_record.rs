//! Record of the forces on the hand, the same for every emulated device, so that one contract and one matrix
//! can judge all of them.

use crate::tick::TICK_US;
use palpate_core::{Vec3, vec3};

/// Largest shortfall of the time between two commands, us: half a tick.
const JITTER_US: u64 = 500;

/// Extrema and integrals of the force on the hand since the last reset of the record.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ForceRecord {
    /// Present force of the motors on the hand, device frame, N.
    pub force_n: Vec3,
    /// Largest force, N.
    pub largest_force_n: f32,
    /// Largest force while the device was not homed, N.
    pub largest_unhomed_n: f32,
    /// Largest change of the force by one non-zero command, N.
    pub largest_step_n: f32,
    /// Largest rate of change of the force by one non-zero command, N/s.
    pub steepest_n_per_s: f32,
    /// Largest change of the force by a zero command, N.
    pub largest_drop_n: f32,
    /// Largest component of a command in the device's units: motor counts, mN.
    pub largest_motor: u16,
    /// Number of commands.
    pub commands: u64,
    /// Time of the last command, us.
    pub last_command_us: Option<u64>,
    /// Time since which the motors have had no command, us; `None` while they have one.
    pub off_since_us: Option<u64>,
    /// Work of the motors on the hand, J; positive if the hand receives energy.
    pub work_j: f64,
    /// Energy dissipated by the friction of the mechanism, J; never negative.
    pub drag_j: f64,
}

impl ForceRecord {
    /// An empty record with the motors off.
    pub(crate) const fn empty(now_us: u64) -> Self {
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

    /// Records a command and its force. A zero command turns the motors off.
    pub(crate) fn command(&mut self, at_us: u64, force_n: Vec3, motors: [i16; 3], homed: bool) {
        let off = motors == [0; 3];
        let changed_n = vec3::distance(force_n, self.force_n);
        if let Some(before_us) = self.last_command_us.filter(|_| !off) {
            // An expired force must rise again from zero at the slew limit, for any age of the last command.
            let expired = self.off_since_us.is_some_and(|off_us| off_us > before_us);
            let since_us = if expired { TICK_US } else { at_us.saturating_sub(before_us) };
            let seconds = 1e-6 * (since_us + JITTER_US) as f32;
            self.steepest_n_per_s = self.steepest_n_per_s.max(changed_n / seconds);
        }
        self.commands += 1;
        self.last_command_us = Some(at_us);
        self.set_off(at_us, off);
        self.set_force(force_n);
        let change = if off { &mut self.largest_drop_n } else { &mut self.largest_step_n };
        *change = change.max(changed_n);
        let largest = motors.map(i16::unsigned_abs).into_iter().max().unwrap_or(0);
        self.largest_motor = self.largest_motor.max(largest);
        if !homed {
            self.largest_unhomed_n = self.largest_unhomed_n.max(vec3::norm(force_n));
        }
    }

    /// Records whether the motors have a command.
    pub(crate) fn set_off(&mut self, at_us: u64, off: bool) {
        if off {
            self.off_since_us.get_or_insert(at_us);
        } else {
            self.off_since_us = None;
        }
    }

    /// Records the force of the present command at the present position of the hand.
    pub(crate) fn set_force(&mut self, force_n: Vec3) {
        self.force_n = force_n;
        self.largest_force_n = self.largest_force_n.max(vec3::norm(force_n));
    }

    /// Records a motion under the force, and the energy that the mechanism dissipated.
    pub(crate) fn add_motion(&mut self, by_m: Vec3, drag_j: f32) {
        self.work_j += f64::from(vec3::dot(self.force_n, by_m));
        self.drag_j += f64::from(drag_j);
    }

    /// Resets the record; the present force stays.
    pub(crate) fn reset_record(&mut self) {
        let Self { force_n, last_command_us, off_since_us, .. } = *self;
        *self = Self { force_n, last_command_us, off_since_us, ..Self::empty(0) };
        self.largest_force_n = vec3::norm(force_n);
    }

    /// The same record with its times relative to `start_us`.
    #[must_use]
    pub(crate) fn on_clock(self, start_us: u64) -> Self {
        let on_clock = |us: Option<u64>| us.map(|us| us.saturating_sub(start_us));
        let (last_command_us, off_since_us) = (on_clock(self.last_command_us), on_clock(self.off_since_us));
        Self { last_command_us, off_since_us, ..self }
    }

    /// Net energy from motors and mechanism to the hand, J; negative if they dissipate more than they give.
    #[must_use]
    pub const fn energy_out_j(&self) -> f64 {
        self.work_j - self.drag_j
    }
}
