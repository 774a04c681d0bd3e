//! The mouse of the viewer's window as a device.
//!
//! A mouse has no force feedback, so the tool gives way instead: a virtual coupling connects it to the
//! cursor, and a force displaces it by force / stiffness of the coupling, smoothly and no faster than a hand.
//! The window sets the target from the cursor; the haptic thread reads the newest target without waiting. The
//! device has no motors and arms itself.

use super::{Device, DeviceError, DeviceInfo};
use core::fmt;
use palpate_core::{Sample, Vec3, vec3};
use std::sync::{Arc, Mutex, PoisonError};

/// Longest step of one exchange: a stalled computer must not make the tool jump.
const MAX_STEP_US: u64 = 5_000;

/// How the tool follows the cursor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MouseConfig {
    /// Stiffness of the coupling between cursor and tool, N/m.
    pub coupling_n_m: f32,
    /// Time constant of the tool's motion, s.
    ///
    /// The motion is stable while K / coupling x 1 ms < time constant: with these values up to an organ of
    /// 20,000 N/m.
    pub time_constant_s: f32,
    /// Largest speed of the tool, m/s.
    pub max_speed_m_s: f32,
}

impl Default for MouseConfig {
    fn default() -> Self {
        Self { coupling_n_m: 800.0, time_constant_s: 0.025, max_speed_m_s: 0.6 }
    }
}

/// Target of the tool, from the cursor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MouseTarget {
    /// Position, model frame, m.
    pub position_m: Vec3,
    /// Buttons as of a device; the first one grasps.
    pub buttons: u32,
}

/// The window's end. The haptic thread never takes its lock.
#[derive(Clone)]
pub struct MouseHandle(Arc<Mutex<triple_buffer::Input<MouseTarget>>>);

impl MouseHandle {
    /// Sets the target of the tool. A position that is not finite is ignored.
    pub fn set(&self, target: MouseTarget) {
        if vec3::is_finite(target.position_m) {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).write(target);
        }
    }
}

impl fmt::Debug for MouseHandle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MouseHandle").finish_non_exhaustive()
    }
}

impl PartialEq for MouseHandle {
    /// Whether both belong to the same mouse.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// The device's end.
#[derive(Debug)]
pub struct Mouse {
    config: MouseConfig,
    target: triple_buffer::Output<MouseTarget>,
    position_m: Vec3,
    last_us: Option<u64>,
}

/// Makes both ends; the tool starts at `start_m`.
#[must_use]
pub fn mouse(start_m: Vec3, config: MouseConfig) -> (MouseHandle, Mouse) {
    let (input, target) = triple_buffer::triple_buffer(&MouseTarget { position_m: start_m, buttons: 0 });
    let device = Mouse { config, target, position_m: start_m, last_us: None };
    (MouseHandle(Arc::new(Mutex::new(input))), device)
}

impl Mouse {
    /// Moves the tool for `dt_s` under a constant force.
    ///
    /// tau x' = target + F / k - x, with |x'| bounded.
    fn follow(&mut self, target_m: Vec3, force_n: Vec3, dt_s: f32) {
        let MouseConfig { coupling_n_m, time_constant_s, max_speed_m_s } = self.config;
        let yields_m =
            if vec3::is_finite(force_n) { vec3::scale(force_n, coupling_n_m.recip()) } else { vec3::ZERO };
        let gap_m = vec3::sub(vec3::add(target_m, yields_m), self.position_m);
        let step_m = vec3::scale(gap_m, (dt_s / time_constant_s).min(1.0));
        let length_m = vec3::norm(step_m);
        let max_step_m = max_speed_m_s * dt_s;
        let share = if length_m > max_step_m { max_step_m / length_m } else { 1.0 };
        self.position_m = vec3::add(self.position_m, vec3::scale(step_m, share));
    }
}

impl Device for Mouse {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let elapsed_us = self.last_us.map_or(0, |last_us| now_us.saturating_sub(last_us)).min(MAX_STEP_US);
        self.last_us = Some(now_us);
        let MouseTarget { position_m, buttons } = *self.target.read();
        self.follow(position_m, hand_force_n, elapsed_us as f32 * 1e-6);
        Ok(Some(Sample { t_us: now_us, position_m: self.position_m, buttons, ..Sample::default() }))
    }

    fn stop(&mut self) {
        // There is no motor.
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "mouse".into(),
            self_arming: true,
            max_force_n: f32::INFINITY,
            max_stiffness_n_m: f32::INFINITY,
            resolution_m: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_M: Vec3 = [0.1, 0.0, 0.0];

    /// Moves the mouse for a range of ticks; the force is a function of the tool's position.
    fn run(device: &mut Mouse, ticks: core::ops::Range<u64>, force: impl Fn(Vec3) -> Vec3) -> Vec<Vec3> {
        let mut force_n = vec3::ZERO;
        ticks
            .map(|tick| {
                let sample = device.exchange(1_000 * tick, force_n).expect("never fails");
                let position_m = sample.expect("always samples").position_m;
                force_n = force(position_m);
                position_m
            })
            .collect()
    }

    #[test]
    fn the_tool_reaches_the_cursor_at_a_limited_speed() {
        let (handle, mut device) = mouse(START_M, MouseConfig::default());
        assert_eq!(run(&mut device, 0..50, |_| vec3::ZERO)[49], START_M);
        let target_m = [0.0, 0.3, -0.2];
        handle.set(MouseTarget { position_m: target_m, buttons: 1 });
        let trace = run(&mut device, 50..1_500, |_| vec3::ZERO);
        assert!(vec3::distance(trace[trace.len() - 1], target_m) < 1e-5);
        let fastest = trace.windows(2).map(|pair| vec3::distance(pair[0], pair[1])).fold(0.0, f32::max);
        assert!(fastest < 0.601e-3 && fastest > 0.59e-3, "{fastest} m per tick");
        // A step of the cursor becomes a ramp without overshoot.
        assert!(
            trace.windows(2).all(|pair| {
                vec3::distance(pair[1], target_m) <= vec3::distance(pair[0], target_m) + 1e-7
            })
        );
        let sample = device.exchange(1_600_000, vec3::ZERO).expect("never fails").expect("samples");
        assert_eq!((sample.buttons, sample.t_us), (1, 1_600_000));
    }

    #[test]
    fn a_force_displaces_the_tool_by_the_coupling() {
        let (_handle, mut device) = mouse(START_M, MouseConfig::default());
        let trace = run(&mut device, 0..1_000, |_| [0.0, 4.0, 0.0]);
        let yields_m = vec3::sub(trace[999], START_M);
        assert!(vec3::distance(yields_m, [0.0, 4.0 / 800.0, 0.0]) < 1e-5, "{yields_m:?}");
    }

    /// At equilibrium the organ's force equals the coupling's. The tool does not oscillate with any organ
    /// that a device may render.
    #[test]
    fn the_tool_comes_to_rest_in_soft_and_stiff_organs() {
        for stiffness_n_m in [100.0, 800.0, 3_000.0, 10_000.0] {
            let (handle, mut device) = mouse(START_M, MouseConfig::default());
            handle.set(MouseTarget { position_m: [0.08, 0.0, 0.0], buttons: 0 });
            let spring = |at: Vec3| vec3::scale(vec3::sub(START_M, at), stiffness_n_m);
            let trace = run(&mut device, 0..2_000, spring);
            let expected_m = 0.08 + 0.02 * stiffness_n_m / (800.0 + stiffness_n_m);
            let last = &trace[1_900..];
            assert!(
                last.iter().all(|at| (at[0] - expected_m).abs() < 2e-5),
                "{stiffness_n_m}: {:?}",
                last[99]
            );
        }
    }

    #[test]
    fn samples_are_finite_and_a_pause_does_not_make_the_tool_jump() {
        let (handle, mut device) = mouse(START_M, MouseConfig::default());
        handle.set(MouseTarget { position_m: [f32::NAN, 0.0, 0.0], buttons: 0 });
        run(&mut device, 0..10, |_| [f32::INFINITY, 0.0, f32::NAN]);
        assert_eq!(device.position_m, START_M);
        handle.set(MouseTarget { position_m: [1.0, 0.0, 0.0], buttons: 0 });
        let sample = device.exchange(30_000_000, vec3::ZERO).expect("never fails").expect("samples");
        assert!(vec3::distance(sample.position_m, START_M) <= 0.6 * 5.001e-3);
    }
}
