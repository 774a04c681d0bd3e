//! A gantry: three perpendicular axes, each driven by a cable or belt on a drum.
//!
//! ```text
//! position [m]   = origin + metres_per_turn * counts / counts_per_turn
//! torque [N m]   = force * metres_per_turn / (2 pi)
//! ```
//!
//! The second relation follows from the first by virtual work: the work of the motor over a turn equals the
//! work of the force over the path of a turn. `metres_per_turn` has the sign of the axis. The firmware counts
//! up in the direction of positive torque.

use core::f64::consts::TAU;
use palpate_core::Vec3;
use palpate_link::clamp_torque;

/// Parameters of the mechanism, from the profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capstan {
    /// Path of the handle along each device axis per turn of its encoder, m; negative if it moves down as the
    /// counts increase.
    pub metres_per_turn: [f64; 3],
    /// Position of the handle at zero counts, that is at home; device frame, m.
    pub origin_m: [f64; 3],
}

impl Capstan {
    /// Position of the handle, device frame, m.
    #[must_use]
    pub fn position_m(&self, counts: [i64; 3], counts_per_turn: [u32; 3]) -> Vec3 {
        core::array::from_fn(|axis| {
            let turns = counts[axis] as f64 / f64::from(counts_per_turn[axis]);
            (self.origin_m[axis] + self.metres_per_turn[axis] * turns) as f32
        })
    }

    /// Torques for a force in the device frame, micro-newton-metres. All three are scaled together to the
    /// limits, so the direction is kept.
    #[must_use]
    pub fn torque_unm(&self, device_n: Vec3, limit_unm: [u32; 3]) -> [i32; 3] {
        let requested: [f64; 3] =
            core::array::from_fn(|axis| 1e6 * f64::from(device_n[axis]) * self.metres_per_turn[axis] / TAU);
        // A saturating cast would clamp each axis alone and change the direction of the force.
        let largest = requested.iter().fold(0.0_f64, |largest, torque| largest.max(torque.abs()));
        let share = (f64::from(i32::MAX) / largest).min(1.0);
        clamp_torque(requested.map(|torque| (share * torque).round() as i32), limit_unm).0
    }

    /// Largest force that these torque limits permit in every direction, N.
    #[must_use]
    pub fn max_force_n(&self, limit_unm: [u32; 3]) -> f32 {
        let axes = self.metres_per_turn.iter().zip(limit_unm);
        let forces_n = axes.map(|(metres, limit)| 1e-6 * f64::from(limit) * TAU / metres.abs());
        forces_n.fold(f64::INFINITY, f64::min) as f32
    }

    /// Coarsest resolution of the position, m.
    #[must_use]
    pub fn resolution_m(&self, counts_per_turn: [u32; 3]) -> f32 {
        let axes = self.metres_per_turn.iter().zip(counts_per_turn);
        axes.map(|(metres, counts)| metres.abs() / f64::from(counts)).fold(0.0, f64::max) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::vec3;

    const CAPSTAN: Capstan = Capstan { metres_per_turn: [0.06, 0.03, -0.06], origin_m: [-0.1, 0.0, 0.1] };
    const AMPLE: [u32; 3] = [i32::MAX as u32; 3];

    #[test]
    fn a_turn_moves_by_metres_per_turn_and_work_is_equal_on_both_sides() {
        let counts = [2_000, -1_000, 4_000];
        let at_m = CAPSTAN.position_m(counts, [2_000; 3]);
        assert!(vec3::distance(at_m, [-0.04, -0.015, -0.02]) < 1e-7, "{at_m:?}");
        // The work of the force over a turn of one axis equals its torque times 2 pi.
        let force_n = [1.5, -2.0, 0.7];
        let torque_unm = CAPSTAN.torque_unm(force_n, AMPLE);
        for axis in 0..3 {
            let work_j = f64::from(force_n[axis]) * CAPSTAN.metres_per_turn[axis];
            assert!((1e-6 * f64::from(torque_unm[axis]) * TAU - work_j).abs() < 1e-5, "axis {axis}");
        }
        assert!(torque_unm[2] < 0, "the drum of z turns the other way");
    }

    #[test]
    fn torques_are_shortened_together() {
        let limit_unm = [20_000; 3];
        let whole = CAPSTAN.torque_unm([4.0, 2.0, -1.0], AMPLE);
        let short = CAPSTAN.torque_unm([4.0, 2.0, -1.0], limit_unm);
        assert_eq!(short[0], 20_000);
        for axis in 0..3 {
            let share = f64::from(short[axis]) / f64::from(whole[axis]);
            assert!(
                (share - 20_000.0 / f64::from(whole[0])).abs() < 1e-3,
                "axis {axis}: {short:?} of {whole:?}"
            );
        }
        // The direction is kept beyond the range of the integer too.
        let huge = CAPSTAN.torque_unm([f32::MAX, f32::MAX, -f32::MAX], AMPLE);
        assert!(
            (f64::from(huge[0]) / f64::from(huge[1]) - 2.0).abs() < 1e-6 && huge[2] == huge[0],
            "{huge:?}"
        );
        assert!((CAPSTAN.max_force_n(limit_unm) - 2.094_395).abs() < 1e-5, "the weakest axis");
        assert!((CAPSTAN.resolution_m([2_000, 500, 2_000]) - 60e-6).abs() < 1e-9, "the coarsest axis");
    }
}
