//! The simulated handle: a mass in a hand that moves along waypoints, under the force of the device.

use crate::force_record::ForceRecord;
use palpate_core::{Vec3, vec3};
use palpate_host::device::hand::{Drag, Hand, HandConfig};

/// Target position of the hand at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Time since the start, us.
    pub t_us: u64,
    /// Position, device frame, m.
    pub position_m: Vec3,
}

/// A path through waypoints.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    waypoints: Vec<Waypoint>,
}

impl Path {
    /// A path through waypoints in order of time.
    #[must_use]
    pub const fn new(waypoints: Vec<Waypoint>) -> Self {
        Self { waypoints }
    }

    /// Position at a time: a smooth step between two waypoints, the last waypoint after the end; `None`
    /// without waypoints.
    #[must_use]
    pub fn at(&self, t_us: u64) -> Option<Vec3> {
        let after = self.waypoints.partition_point(|waypoint| waypoint.t_us <= t_us);
        let (before, next) =
            (after.checked_sub(1).and_then(|i| self.waypoints.get(i)), self.waypoints.get(after));
        match (before, next) {
            (Some(from), Some(to)) => {
                let t = (t_us - from.t_us) as f32 / (to.t_us - from.t_us) as f32;
                let share = t * t * (3.0 - 2.0 * t);
                Some(vec3::add(
                    from.position_m,
                    vec3::scale(vec3::sub(to.position_m, from.position_m), share),
                ))
            }
            (Some(only), None) | (None, Some(only)) => Some(only.position_m),
            (None, None) => None,
        }
    }
}

/// A handle in the host's hand model, under the last force of the device.
#[derive(Debug, Clone)]
pub struct Handle {
    hand: Hand,
    drag: Drag,
    path: Path,
    /// Start of the path, us.
    start_us: u64,
    now_us: Option<u64>,
    record: ForceRecord,
}

/// Longest integration step, us.
const STEP_US: u64 = 250;
/// Longest time advanced in one call, us: the handle does not jump after a pause of the emulator.
const MAX_CATCH_UP_US: u64 = 50_000;

impl Handle {
    /// A handle without a mechanism at its first waypoint, in a hand of 0.2 kg on 400 N/m with critical
    /// damping. The waypoints must be in order of time. Without any the handle rests at the origin.
    #[must_use]
    pub fn new(waypoints: Vec<Waypoint>) -> Self {
        let hand =
            HandConfig { stiffness_n_m: 400.0, persistence: 0.0, tremor_m: 0.0, ..HandConfig::default() };
        Self::held(hand, Drag::default(), waypoints)
    }

    /// A handle with a mechanism in a hand.
    #[must_use]
    pub fn held(hand: HandConfig, drag: Drag, waypoints: Vec<Waypoint>) -> Self {
        let path = Path::new(waypoints);
        let hand = Hand::new(hand, path.at(0).unwrap_or(vec3::ZERO));
        Self { hand, drag, path, start_us: 0, now_us: None, record: ForceRecord::empty(0) }
    }

    /// Position of the handle, device frame, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.hand.position_m()
    }

    /// Record of the force on the hand.
    #[must_use]
    pub const fn force_record(&self) -> &ForceRecord {
        &self.record
    }

    /// Resets the record of the force on the hand.
    pub fn reset_record(&mut self) {
        self.record.reset_record();
    }

    /// Gives the hand another path; its times count from now.
    pub fn follow(&mut self, waypoints: Vec<Waypoint>) {
        (self.path, self.start_us) = (Path::new(waypoints), self.now_us.unwrap_or(0));
    }

    /// Sets the force of the motors, N; `motors` is the command in the device's units.
    pub fn command(&mut self, force_n: Vec3, motors: [i16; 3]) {
        self.drive(force_n, motors, true);
    }

    /// The same for a device that must be homed.
    pub fn drive(&mut self, force_n: Vec3, motors: [i16; 3], homed: bool) {
        self.record.command(self.now_us.unwrap_or(0), force_n, motors, homed);
    }

    /// Removes the force without a command, as a watchdog or a power loss does.
    pub fn release(&mut self) {
        self.record.set_off(self.now_us.unwrap_or(0), true);
        self.record.set_force(vec3::ZERO);
    }

    /// Advances to `now_us` under the force of the device.
    pub fn advance(&mut self, now_us: u64) {
        let mut t_us = self.now_us.unwrap_or(now_us).max(now_us.saturating_sub(MAX_CATCH_UP_US));
        while t_us < now_us {
            let step_us = STEP_US.min(now_us - t_us);
            let (from_m, before_m) = (self.target_m(t_us), self.hand.position_m());
            t_us += step_us;
            let to_m = self.target_m(t_us);
            let drag_j =
                self.hand.integrate(from_m, to_m, self.record.force_n, &self.drag, step_us as f32 * 1e-6);
            self.record.add_motion(vec3::sub(self.hand.position_m(), before_m), drag_j);
        }
        self.now_us = Some(now_us);
    }

    fn target_m(&self, t_us: u64) -> Vec3 {
        self.path.at(t_us.saturating_sub(self.start_us)).unwrap_or(vec3::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn there_and_back() -> Handle {
        let at = |t_us, x| Waypoint { t_us, position_m: [x, 0.0, 0.0] };
        Handle::new(vec![at(0, 0.0), at(500_000, 0.02), at(1_500_000, 0.02)])
    }

    #[test]
    fn a_force_moves_the_handle_by_the_compliance_of_the_hand() {
        let mut handle = there_and_back();
        for t_us in (0..=1_500_000).step_by(1_000) {
            handle.advance(t_us);
        }
        assert!((handle.position_m()[0] - 0.02).abs() < 1e-4);
        handle.command([-4.0, 0.0, 0.0], [-4_000, 0, 0]);
        for t_us in (1_500_000..=2_500_000).step_by(1_000) {
            handle.advance(t_us);
        }
        assert!((handle.position_m()[0] - 0.01).abs() < 1e-4, "4 N on 400 N/m");
    }

    #[test]
    fn a_long_pause_is_bounded_in_time_and_motion() {
        let mut handle = there_and_back();
        handle.advance(0);
        handle.command([8.0, 0.0, 0.0], [8_000, 0, 0]);
        handle.advance(u64::MAX / 2);
        assert!(vec3::is_finite(handle.position_m()) && handle.position_m()[0].abs() < 0.1);
    }
}
