//! Kinematics of the Falcon: arm angles from the position of the grip, and the force at the grip from torques
//! on the arms.
//!
//! For the leg at angle phi about z, in its own frame:
//!
//! ```text
//! u = x cos(phi) + y sin(phi) - r;   v = -x sin(phi) + y cos(phi) - s;   w = z
//! cos(theta3) = (v + f) / b;   L = d + e + b sin(theta3);   a e^(i theta1) + L e^(i theta2) = (u + c) + i w
//! ```
//!
//! Of the two solutions for theta1 the smaller one is taken. The arithmetic is f64, so that the emulator adds
//! no rounding error of its own. Source: the constants are those of libnifalcon (BSD-3); the closed form is
//! derived here.

use palpate_core::Vec3;

/// Length of an arm from the motor to the elbow, m.
const ARM_M: f64 = 0.060;
/// Length of the long sides of the parallelogram, m.
const FOREARM_M: f64 = 0.1025;
/// Distance from the leg's origin to the arm's axle, m.
const AXLE_M: f64 = 0.01443;
/// Sum of both offsets of the parallelogram along the leg, m.
const PARALLELOGRAM_M: f64 = 0.01125 + 0.01125;
/// Lateral offset of the parallelogram, m.
const SIDEWAYS_M: f64 = -0.025;
/// Offsets of a leg's frame from the centre, m.
const LEG_M: [f64; 2] = [0.0400, -0.023_09];
/// Directions of the legs about z, degrees.
const LEGS_DEG: [f64; 3] = [105.0, -15.0, -135.0];

/// Encoder counts per turn of the wheel: 320 slots, four edges each.
const COUNTS_PER_TURN: f64 = 320.0 * 4.0;
/// Turns of the wheel per turn of the arm: ratio of the diameters of the arm's drum and the motor's shaft.
const GEAR: f64 = 0.110 / 0.014_25;
/// Encoder counts per radian of an arm.
pub const COUNTS_PER_RAD: f64 = COUNTS_PER_TURN * GEAR / core::f64::consts::TAU;
/// Angle of an arm at count 0, degrees.
const ZERO_DEG: f64 = 35.0;

/// The grip is out of reach of the legs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutOfReach {
    /// The first leg that does not reach, 0 to 2.
    pub leg: usize,
}

impl core::fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "leg {} does not reach the grip", self.leg)
    }
}

impl core::error::Error for OutOfReach {}

/// The arms for one position of the grip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Angles of the arms, rad.
    pub angles_rad: [f64; 3],
    /// Derivatives of the angles along x, y and z, rad/m: the inverse of d(position)/d(angles).
    pub rad_per_m: [[f64; 3]; 3],
}

impl Pose {
    /// The arms for a grip at `position_m`, device frame.
    ///
    /// With p = (u + c, w), theta1 solves a^2 + |p|^2 - 2 a (p . e(theta1)) = L^2.
    /// Its derivatives: L dL = (p - a e) . dp + a (p x e) dtheta1, p x e = p_u sin(theta1) - p_w cos(theta1).
    pub fn at(position_m: Vec3) -> Result<Self, OutOfReach> {
        let [x, y, z] = position_m.map(f64::from);
        let (mut angles_rad, mut rad_per_m) = ([0.0; 3], [[0.0; 3]; 3]);
        for leg in 0..3 {
            let (sin_phi, cos_phi) = LEGS_DEG[leg].to_radians().sin_cos();
            let along = x * cos_phi + y * sin_phi - LEG_M[0] + AXLE_M;
            let across = -x * sin_phi + y * cos_phi - LEG_M[1];
            let cos_3 = (across + SIDEWAYS_M) / FOREARM_M;
            let sin_3 = (1.0 - cos_3 * cos_3).sqrt();
            let reach = PARALLELOGRAM_M + FOREARM_M * sin_3;
            let away = along.hypot(z);
            let cosine = (ARM_M * ARM_M + away * away - reach * reach) / (2.0 * ARM_M * away);
            let theta = z.atan2(along) - cosine.acos();
            let (sin_1, cos_1) = theta.sin_cos();
            let lever = ARM_M * (along * sin_1 - z * cos_1);
            // A leg out of reach has no angle, and a stretched leg no derivative.
            if !(theta.is_finite() && sin_3 > 0.0 && lever.abs() > 1e-9) {
                return Err(OutOfReach { leg });
            }
            let by_along = -(along - ARM_M * cos_1) / lever;
            let by_across = -reach * cos_3 / (sin_3 * lever);
            let by_z = -(z - ARM_M * sin_1) / lever;
            angles_rad[leg] = theta;
            rad_per_m[leg] =
                [by_along * cos_phi - by_across * sin_phi, by_along * sin_phi + by_across * cos_phi, by_z];
        }
        Ok(Self { angles_rad, rad_per_m })
    }

    /// Encoder counts from the angle of count 0. A slotted wheel counts passed edges, so the count rounds
    /// down.
    #[must_use]
    pub fn counts(&self) -> [i32; 3] {
        self.angles_rad.map(|rad| ((rad - ZERO_DEG.to_radians()) * COUNTS_PER_RAD).floor() as i32)
    }

    /// Force at the grip for torques on the arms. By equal power, F = (d angles / d position)^T tau.
    #[must_use]
    pub fn force_n(&self, torque_nm: [f64; 3]) -> Vec3 {
        core::array::from_fn(|axis| {
            (0..3).map(|leg| self.rad_per_m[leg][axis] * torque_nm[leg]).sum::<f64>() as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts on the axis as derived in docs/devices.md.
    #[test]
    fn counts_on_the_axis_match_the_documented_values() {
        for (z, expected) in [(0.075, -1463), (0.11, -516), (0.13, -96), (0.15, 336), (0.17, 872)] {
            let counts = Pose::at([0.0, 0.0, z]).expect("within reach").counts();
            for count in counts {
                assert!((count - expected).abs() <= 1, "{z} m: {counts:?}, expected {expected}");
            }
        }
        assert!((COUNTS_PER_RAD.to_radians() - 27.446).abs() < 1e-3, "counts per degree");
    }

    /// Computed independently by bisection of |p - a e(theta1)| = L. Checks the order and the orientation of
    /// the legs.
    #[test]
    fn counts_off_the_axis_match_an_independent_solution() {
        for (at_m, expected) in [
            ([0.02, -0.015, 0.12], [103.86, -651.43, -172.03]),
            ([-0.03, 0.01, 0.10], [-993.19, -3.09, -883.04]),
            ([0.0, 0.03, 0.14], [-250.32, 331.98, 535.22]),
        ] {
            let counts = Pose::at(at_m).expect("within reach").counts();
            let down = expected.map(|count: f64| count.floor() as i32);
            assert!(
                (0..3).all(|leg| (counts[leg] - down[leg]).abs() <= 1),
                "{counts:?}, expected {expected:?}"
            );
        }
    }

    #[test]
    fn the_legs_close_at_the_smaller_angle() {
        let [x, y, z] = [0.02, -0.015, 0.12];
        let pose = Pose::at([0.02, -0.015, 0.12]).expect("within reach");
        for leg in 0..3 {
            let (sin_phi, cos_phi) = LEGS_DEG[leg].to_radians().sin_cos();
            let (u, v): (f64, f64) =
                (x * cos_phi + y * sin_phi - LEG_M[0], -x * sin_phi + y * cos_phi - LEG_M[1]);
            let theta3 = ((v + SIDEWAYS_M) / FOREARM_M).acos();
            let reach = PARALLELOGRAM_M + FOREARM_M * theta3.sin();
            let elbow = [ARM_M * pose.angles_rad[leg].cos(), ARM_M * pose.angles_rad[leg].sin()];
            let from_elbow = [u + AXLE_M - elbow[0], z - elbow[1]];
            // Positions are f32: 1e-8 m.
            assert!((from_elbow[0].hypot(from_elbow[1]) - reach).abs() < 1e-8);
            // The other solution lies beyond the line from the axle to the grip.
            let other = 2.0 * z.atan2(u + AXLE_M) - pose.angles_rad[leg];
            assert!(pose.angles_rad[leg] < other);
        }
    }

    #[test]
    fn derivatives_match_central_differences() {
        for at_m in [[0.0, 0.0, 0.11], [0.03, -0.02, 0.10], [-0.025, 0.03, 0.14]] {
            let pose = Pose::at(at_m).expect("within reach");
            for axis in 0..3 {
                let step = 1e-3_f32;
                let moved = |by| {
                    let mut to_m = at_m;
                    to_m[axis] += by;
                    (Pose::at(to_m).expect("within reach").angles_rad, f64::from(to_m[axis]))
                };
                let ((up, at_up), (down, at_down)) = (moved(step), moved(-step));
                for leg in 0..3 {
                    let rate = (up[leg] - down[leg]) / (at_up - at_down);
                    // The truncation error is due to the third derivative, of the order of 1e4 rad/m^3.
                    assert!((rate - pose.rad_per_m[leg][axis]).abs() < 0.02, "{at_m:?} {leg} {axis}");
                }
            }
        }
    }

    /// Three equal torques that lift the arms push the grip along z, towards the user.
    #[test]
    fn equal_torques_act_along_z() {
        let pose = Pose::at([0.0, 0.0, 0.12]).expect("within reach");
        let [x, y, z] = pose.force_n([0.1; 3]);
        assert!(x.abs() < 1e-6 && y.abs() < 1e-6 && z > 1.0, "{x} {y} {z}");
    }

    #[test]
    fn positions_out_of_reach_are_errors() {
        assert!(Pose::at([0.0, 0.0, 0.3]).is_err());
        assert!(Pose::at([0.2, 0.0, 0.12]).is_err());
        assert!(Pose::at([f32::NAN, 0.0, 0.12]).is_err());
    }
}
