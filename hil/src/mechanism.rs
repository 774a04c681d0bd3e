//! The simulated handle: a mass held by a hand that moves from waypoint to waypoint, pushed by the device's force.

use palpate_core::{Vec3, vec3};

/// Where the hand wants the handle to be at some time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Time since the start, us.
    pub t_us: u64,
    /// Position, device frame, m.
    pub position_m: Vec3,
}

/// The way from waypoint to waypoint.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    waypoints: Vec<Waypoint>,
}

impl Path {
    /// Waypoints in order of time.
    #[must_use]
    pub const fn new(waypoints: Vec<Waypoint>) -> Self {
        Self { waypoints }
    }

    /// Where it leads at a time: between two waypoints a smooth step, after the last the last; nowhere without any.
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

/// Handle and hand: m a = k (wanted - x) - c v + F.
#[derive(Debug, Clone, PartialEq)]
pub struct Handle {
    path: Path,
    position_m: Vec3,
    velocity_m_s: Vec3,
    now_us: Option<u64>,
}

/// Effective mass of handle and hand, kg.
const MASS_KG: f32 = 0.2;
/// Stiffness of the hand, N/m.
const STIFFNESS_N_M: f32 = 400.0;
/// Damping of hand and mechanism, N s/m: critical.
const DAMPING_N_S_M: f32 = 17.9;
/// Longest integration step, us.
const STEP_US: u64 = 250;
/// Longest time made up for in one call: after a pause of the emulator the handle does not jump, us.
const LONGEST_US: u64 = 50_000;

impl Handle {
    /// A handle at its first waypoint; waypoints in order of time. Without any it rests at the origin.
    #[must_use]
    pub fn new(waypoints: Vec<Waypoint>) -> Self {
        let path = Path::new(waypoints);
        let position_m = path.at(0).unwrap_or(vec3::ZERO);
        Self { path, position_m, velocity_m_s: vec3::ZERO, now_us: None }
    }

    /// Where the handle is, device frame, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.position_m
    }

    /// Moves on to `now_us` under a constant force of the device.
    pub fn advance(&mut self, now_us: u64, force_n: Vec3) {
        let mut t_us = self.now_us.unwrap_or(now_us).max(now_us.saturating_sub(LONGEST_US));
        while t_us < now_us {
            let step_us = STEP_US.min(now_us - t_us);
            t_us += step_us;
            self.step(t_us, step_us as f32 * 1e-6, force_n);
        }
        self.now_us = Some(now_us);
    }

    /// Semi-implicit Euler: at 0.25 ms k dt^2 / m is 1e-4, far inside its stability.
    fn step(&mut self, t_us: u64, dt_s: f32, force_n: Vec3) {
        let wanted_m = self.path.at(t_us).unwrap_or(vec3::ZERO);
        let spring_n = vec3::scale(vec3::sub(wanted_m, self.position_m), STIFFNESS_N_M);
        let damper_n = vec3::scale(self.velocity_m_s, -DAMPING_N_S_M);
        let total_n = vec3::add(vec3::add(spring_n, damper_n), force_n);
        self.velocity_m_s = vec3::add(self.velocity_m_s, vec3::scale(total_n, dt_s / MASS_KG));
        self.position_m = vec3::add(self.position_m, vec3::scale(self.velocity_m_s, dt_s));
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
    fn it_arrives_and_a_force_moves_it_by_its_compliance() {
        let mut handle = there_and_back();
        for t_us in (0..=1_500_000).step_by(1_000) {
            handle.advance(t_us, vec3::ZERO);
        }
        assert!((handle.position_m()[0] - 0.02).abs() < 1e-4);
        for t_us in (1_500_000..=2_500_000).step_by(1_000) {
            handle.advance(t_us, [-4.0, 0.0, 0.0]);
        }
        assert!((handle.position_m()[0] - 0.01).abs() < 1e-4, "4 N on 400 N/m");
    }

    #[test]
    fn a_long_pause_neither_hangs_nor_throws_it() {
        let mut handle = there_and_back();
        handle.advance(0, vec3::ZERO);
        handle.advance(u64::MAX / 2, [8.0, 0.0, 0.0]);
        assert!(vec3::is_finite(handle.position_m()) && handle.position_m()[0].abs() < 0.1);
    }
}
