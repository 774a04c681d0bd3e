//! From a force for the hand to three motor commands, limited on the way without turning the force.

use super::kinematics::Pose;
use palpate_core::Vec3;

/// Largest motor command, counts either way.
pub const MAX_COUNTS: i16 = 4096;

/// How forces become motor commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorConfig {
    /// Motor counts to one N m at a crank, with its sign. Nobody has calibrated it: of a device of your own, check that a pushed grip is
    /// pushed back, and turn the sign if it is not.
    pub counts_per_n_m: f64,
    /// Force up (+y of the device) that carries the weight of the grip, N; found by trying. It goes and comes with the force: a command of
    /// zero is zero.
    pub gravity_n: f64,
    /// Largest force, N.
    pub max_force_n: f64,
}

impl Default for MotorConfig {
    fn default() -> Self {
        Self { counts_per_n_m: -10_000.0, gravity_n: 0.0, max_force_n: 8.0 }
    }
}

impl MotorConfig {
    /// Motor commands that put this force on the hand, where the handle is now.
    ///
    /// counts = s k J^T F,   |F| <= `max_force_n`, k `counts_per_n_m`, s <= 1 so that none is above [`MAX_COUNTS`]
    ///
    /// Clamps keep the direction of F: they shorten it, and all three torques together. What is no number is no force.
    #[must_use]
    pub fn commands(&self, pose: &Pose, force_n: Vec3) -> [i16; 3] {
        if force_n == [0.0; 3] {
            return [0; 3];
        }
        let mut force_n = force_n.map(f64::from);
        force_n[1] += self.gravity_n;
        let size_n = force_n.iter().map(|f| f * f).sum::<f64>().sqrt();
        if size_n > self.max_force_n {
            force_n = force_n.map(|f| f * (self.max_force_n / size_n));
        }
        let counts = pose.torques_n_m(force_n).map(|torque| self.counts_per_n_m * torque);
        if !counts.iter().all(|count| count.is_finite()) {
            return [0; 3];
        }
        let largest = counts.iter().fold(0.0_f64, |largest, count| largest.max(count.abs()));
        let most = f64::from(MAX_COUNTS);
        let shorten = if largest > most { most / largest } else { 1.0 };
        // A cast of a float saturates; a wrapped command would push the other way with all the motor has.
        counts.map(|count| ((count * shorten).round() as i16).clamp(-MAX_COUNTS, MAX_COUNTS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::falcon::kinematics::Kinematics;

    fn centre() -> Pose {
        *Kinematics::default().pose()
    }

    /// F of the commands that really go out: solved back through J^T.
    fn rendered_n(config: &MotorConfig, pose: &Pose, commands: [i16; 3]) -> [f64; 3] {
        let columns: [[f64; 3]; 3] = core::array::from_fn(|axis| {
            let mut unit = [0.0; 3];
            unit[axis] = 1.0;
            pose.torques_n_m(unit)
        });
        let torque = commands.map(|count| f64::from(count) / config.counts_per_n_m);
        let det = |a: [f64; 3], b: [f64; 3], c: [f64; 3]| {
            a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
        };
        let [x, y, z] = columns;
        let all = det(x, y, z);
        [det(torque, y, z) / all, det(x, torque, z) / all, det(x, y, torque) / all]
    }

    fn norm(v: [f64; 3]) -> f64 {
        v.iter().map(|c| c * c).sum::<f64>().sqrt()
    }

    fn assert_along(rendered: [f64; 3], force_n: Vec3) {
        let wanted = force_n.map(f64::from);
        let along: f64 = rendered.iter().zip(wanted).map(|(a, b)| a * b).sum();
        let cos = along / (norm(rendered) * norm(wanted));
        assert!(cos > 0.9999, "{rendered:?} is not along {wanted:?}");
    }

    #[test]
    fn a_push_along_the_axis_is_three_equal_negative_commands() {
        let commands = MotorConfig::default().commands(&centre(), [0.0, 0.0, 2.0]);
        assert!(commands[0] < -100 && commands == [commands[0]; 3], "{commands:?}");
    }

    #[test]
    fn small_forces_come_out_as_they_went_in() {
        let config = MotorConfig::default();
        for force_n in [[1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.5, 1.0, -3.0]] {
            let rendered = rendered_n(&config, &centre(), config.commands(&centre(), force_n));
            let off = core::array::from_fn(|i| rendered[i] - f64::from(force_n[i]));
            // Half a count of three motors, 1e-4 N m each.
            assert!(norm(off) < 2e-3, "{rendered:?}, not {force_n:?}");
        }
    }

    #[test]
    fn too_large_a_force_is_shortened_and_not_turned() {
        let config = MotorConfig::default();
        for force_n in [[30.0, 20.0, -10.0], [0.0, 1e20, 1e20], [f32::MAX, 0.0, 0.0], [-9.0, 0.0, 0.0]] {
            let rendered = rendered_n(&config, &centre(), config.commands(&centre(), force_n));
            assert!(norm(rendered) < config.max_force_n + 2e-3, "{rendered:?}");
            let scaled = force_n.map(|f| f / 1e20_f32.min(force_n.iter().fold(0.0, |m, f| m.max(f.abs()))));
            assert_along(rendered, scaled);
        }
    }

    #[test]
    fn commands_are_scaled_together_and_never_wrap() {
        let strong = MotorConfig { counts_per_n_m: -1e6, ..MotorConfig::default() };
        for force_n in [[3.0, 2.0, -1.0], [0.0, 0.0, 5.0], [-1.0, 1.0, 8.0]] {
            let commands = strong.commands(&centre(), force_n);
            let largest = commands.iter().map(|c| c.unsigned_abs()).max();
            assert_eq!(largest, Some(MAX_COUNTS.unsigned_abs()), "{commands:?}");
            assert_along(rendered_n(&strong, &centre(), commands), force_n);
        }
    }

    #[test]
    fn nothing_and_what_is_no_number_are_no_force() {
        let config = MotorConfig { gravity_n: 0.5, ..MotorConfig::default() };
        for force_n in [[0.0; 3], [f32::NAN, 0.0, 1.0], [f32::INFINITY, 0.0, 0.0]] {
            assert_eq!(config.commands(&centre(), force_n), [0; 3], "{force_n:?}");
        }
        let broken = Pose { jacobian: [[f64::NAN; 3]; 3], ..centre() };
        assert_eq!(config.commands(&broken, [1.0; 3]), [0; 3]);
    }

    #[test]
    fn the_weight_of_the_grip_is_carried_upwards_and_counts_for_the_limit() {
        let config = MotorConfig { gravity_n: 0.5, max_force_n: 2.0, ..MotorConfig::default() };
        let rendered = rendered_n(&config, &centre(), config.commands(&centre(), [1.0, 0.0, 0.0]));
        assert!((rendered[1] - 0.5).abs() < 2e-3 && (rendered[0] - 1.0).abs() < 2e-3, "{rendered:?}");
        let rendered = rendered_n(&config, &centre(), config.commands(&centre(), [0.0, 2.0, 0.0]));
        assert!(norm(rendered) < 2.002, "{rendered:?}");
    }
}
