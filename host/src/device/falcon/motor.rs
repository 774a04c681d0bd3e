//! Converts a force for the hand to three motor commands. Limits shorten the force and keep its direction.

use super::kinematics::Pose;
use palpate_core::Vec3;

/// Largest motor command, counts in either direction.
pub const MAX_COUNTS: i16 = 4096;

/// Conversion of forces to motor commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorConfig {
    /// Motor counts per N m at the crank, with sign: the profile's calibration.
    pub counts_per_n_m: [f64; 3],
    /// Largest force, N.
    pub max_force_n: f64,
}

/// Default for motors that are not calibrated, counts per N m. Source: libnifalcon.
const UNCALIBRATED: f64 = -10_000.0;

impl Default for MotorConfig {
    fn default() -> Self {
        Self { counts_per_n_m: [UNCALIBRATED; 3], max_force_n: 8.0 }
    }
}

impl MotorConfig {
    /// Motor commands that exert this force on the hand at the current pose and stay within the limit at the
    /// predicted pose.
    ///
    /// counts = s k J^T F,   |F| <= `max_force_n`, k = `counts_per_n_m`, s <= 1 such that no count exceeds
    /// [`MAX_COUNTS`]
    ///
    /// Torques are held until the next command, while the force that they exert changes with the pose.
    /// Therefore |s J_ahead^-T J^T F| <= `max_force_n` must hold too, for the predicted pose `ahead`. All
    /// limits scale the three torques together, so the direction of F is kept. A force that is not finite
    /// gives zero.
    #[must_use]
    pub fn commands(&self, pose: &Pose, ahead: &Pose, force_n: Vec3) -> [i16; 3] {
        if force_n == [0.0; 3] {
            return [0; 3];
        }
        let within = |force_n: [f64; 3]| {
            let size_n = norm(force_n);
            // This form of the condition keeps NaN.
            if size_n <= self.max_force_n { 1.0 } else { self.max_force_n / size_n }
        };
        let force_n = force_n.map(f64::from);
        let factor = within(force_n);
        let torques_n_m = pose.torques_n_m(force_n.map(|f| f * factor));
        let factor = within(ahead.force_n(torques_n_m));
        let counts: [f64; 3] =
            core::array::from_fn(|motor| self.counts_per_n_m[motor] * torques_n_m[motor] * factor);
        if !counts.iter().all(|count| count.is_finite()) {
            return [0; 3];
        }
        let largest = counts.iter().fold(0.0_f64, |largest, count| largest.max(count.abs()));
        let limit = f64::from(MAX_COUNTS);
        let factor = if largest > limit { limit / largest } else { 1.0 };
        // The cast saturates: a command that wrapped round would push in the opposite direction at full
        // force.
        counts.map(|count| ((count * factor).round() as i16).clamp(-MAX_COUNTS, MAX_COUNTS))
    }
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::falcon::kinematics::Kinematics;

    fn centre() -> Pose {
        *Kinematics::default().pose()
    }

    /// Force of the rounded commands.
    fn rendered_n(config: &MotorConfig, pose: &Pose, commands: [i16; 3]) -> [f64; 3] {
        pose.force_n(core::array::from_fn(|i| f64::from(commands[i]) / config.counts_per_n_m[i]))
    }

    /// Commands at rest.
    fn commands(config: &MotorConfig, force_n: Vec3) -> [i16; 3] {
        config.commands(&centre(), &centre(), force_n)
    }

    fn assert_along(rendered: [f64; 3], force_n: Vec3) {
        let expected = force_n.map(f64::from);
        let along: f64 = rendered.iter().zip(expected).map(|(a, b)| a * b).sum();
        let cos = along / (norm(rendered) * norm(expected));
        assert!(cos > 0.9999, "{rendered:?} is not along {expected:?}");
    }

    #[test]
    fn a_push_along_the_axis_is_three_equal_negative_commands() {
        let commands = commands(&MotorConfig::default(), [0.0, 0.0, 2.0]);
        assert!(commands[0] < -100 && commands == [commands[0]; 3], "{commands:?}");
    }

    #[test]
    fn small_forces_are_rendered_unchanged() {
        let config = MotorConfig::default();
        for force_n in [[1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.5, 1.0, -3.0]] {
            let rendered = rendered_n(&config, &centre(), commands(&config, force_n));
            let error = core::array::from_fn(|i| rendered[i] - f64::from(force_n[i]));
            // Half a count of three motors, 1e-4 N m each.
            assert!(norm(error) < 2e-3, "{rendered:?}, not {force_n:?}");
        }
    }

    #[test]
    fn an_excessive_force_is_shortened_and_keeps_its_direction() {
        let config = MotorConfig::default();
        for force_n in [[30.0, 20.0, -10.0], [0.0, 1e20, 1e20], [f32::MAX, 0.0, 0.0], [-9.0, 0.0, 0.0]] {
            let rendered = rendered_n(&config, &centre(), commands(&config, force_n));
            assert!(norm(rendered) < config.max_force_n + 2e-3, "{rendered:?}");
            let scaled = force_n.map(|f| f / 1e20_f32.min(force_n.iter().fold(0.0, |m, f| m.max(f.abs()))));
            assert_along(rendered, scaled);
        }
    }

    #[test]
    fn commands_are_scaled_together_and_never_wrap() {
        let strong = MotorConfig { counts_per_n_m: [-1e6; 3], ..MotorConfig::default() };
        for force_n in [[3.0, 2.0, -1.0], [0.0, 0.0, 5.0], [-1.0, 1.0, 8.0]] {
            let commands = commands(&strong, force_n);
            let largest = commands.iter().map(|c| c.unsigned_abs()).max();
            assert_eq!(largest, Some(MAX_COUNTS.unsigned_abs()), "{commands:?}");
            assert_along(rendered_n(&strong, &centre(), commands), force_n);
        }
    }

    #[test]
    fn zero_and_values_that_are_not_finite_give_no_force() {
        let config = MotorConfig::default();
        for force_n in [[0.0; 3], [f32::NAN, 0.0, 1.0], [f32::INFINITY, 0.0, 0.0]] {
            assert_eq!(commands(&config, force_n), [0; 3], "{force_n:?}");
        }
        let broken = Pose { jacobian: [[f64::NAN; 3]; 3], ..centre() };
        assert_eq!(config.commands(&broken, &centre(), [1.0; 3]), [0; 3]);
        assert_eq!(config.commands(&centre(), &broken, [1.0; 3]), [0; 3]);
    }

    /// Two motors with other calibrations, one with the opposite sign: the force is the same, the commands
    /// differ.
    #[test]
    fn each_motor_has_its_own_scale_and_sign() {
        let config =
            MotorConfig { counts_per_n_m: [-8_000.0, 12_000.0, -10_000.0], ..MotorConfig::default() };
        let force_n = [0.5, 1.0, -3.0];
        let [a, b, c] = commands(&config, force_n);
        let rendered = rendered_n(&config, &centre(), [a, b, c]);
        assert!(norm(core::array::from_fn(|i| rendered[i] - f64::from(force_n[i]))) < 2e-3, "{rendered:?}");
        let [x, y, z] = commands(&MotorConfig::default(), force_n);
        assert!((f64::from(a) - 0.8 * f64::from(x)).abs() < 1.0 && c == z, "{a} {c}, {x} {z}");
        assert!((f64::from(b) + 1.2 * f64::from(y)).abs() < 1.0, "{b}, {y}");
    }

    /// Torques within the limit here would exceed it a few millimetres further on: they are reduced before
    /// the handle gets there.
    #[test]
    fn held_torques_stay_within_the_limit_at_the_predicted_pose() {
        let (config, mechanism) = (MotorConfig::default(), Kinematics::default());
        let mut max_n: f64 = 0.0;
        for from_m in [[0.0, 0.0, 0.12], [0.03, 0.0, 0.11], [-0.02, 0.03, 0.14], [0.0, -0.03, 0.095]] {
            let now = mechanism.pose_with(from_m).expect("within reach");
            for axis in 0..6 {
                let mut to_m = from_m;
                to_m[axis % 3] += if axis < 3 { 5e-3 } else { -5e-3 };
                let predicted = mechanism.pose_with(to_m).expect("within reach");
                for force_n in [[9.0, 0.0, 0.0], [0.0, -9.0, 0.0], [0.0, 0.0, 9.0], [-6.0, 6.0, 6.0]] {
                    let counts = config.commands(&now, &predicted, force_n);
                    for pose in [&now, &predicted] {
                        let rendered = norm(rendered_n(&config, pose, counts));
                        assert!(rendered < config.max_force_n + 2e-3, "{rendered} N, {from_m:?} to {to_m:?}");
                    }
                    let unpredicted = config.commands(&now, &now, force_n);
                    max_n = max_n.max(norm(rendered_n(&config, &predicted, unpredicted)));
                }
            }
        }
        assert!(max_n > 1.05 * config.max_force_n, "the prediction must matter: {max_n} N");
    }
}
