//! Encoder jumps that move the position of the grip by some millimetres, as the driver's kinematics compute
//! it.

use crate::fault::split_mix;
use palpate_host::device::falcon::kinematics::{Kinematics, Solution};

/// Range of the apparent displacement of the grip, mm.
const MIN_JUMP_MM: u64 = 5;
const MAX_JUMP_MM: u64 = 30;
/// More counts than the range of an arm.
const MAX_COUNTS: i32 = 3_000;

/// An offset of one encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Jump {
    /// Index of the encoder.
    pub axis: usize,
    /// Offset, counts.
    pub counts: i32,
}

impl Jump {
    /// The jump for a seed while the encoders read `counts`. Its sign is reversed where the legs do not
    /// reach.
    pub(super) fn of(seed: u64, counts: [i32; 3]) -> Option<Self> {
        let axis = (split_mix(seed, 0) % 3) as usize;
        let sign = if split_mix(seed, 1).is_multiple_of(2) { 1 } else { -1 };
        let min_displacement_m =
            1e-3 * (MIN_JUMP_MM + split_mix(seed, 2) % (MAX_JUMP_MM - MIN_JUMP_MM)) as f64;
        let by = |counts| Self { axis, counts };
        let is_enough = |jump: &Self| jump.grip_m(counts).is_some_and(|m| m >= min_displacement_m);
        let one_way = |sign: i32| (1..MAX_COUNTS).map(|n| by(sign * n)).find(is_enough);
        one_way(sign).or_else(|| one_way(-sign))
    }

    /// Apparent displacement of the grip, m.
    fn grip_m(self, counts: [i32; 3]) -> Option<f64> {
        let (from_m, mut to) = (place_m(counts)?, counts);
        to[self.axis] += self.counts;
        let to_m = place_m(to)?;
        Some((0..3).map(|i| (to_m[i] - from_m[i]).powi(2)).sum::<f64>().sqrt())
    }
}

/// Position of the grip by the driver's kinematics, m.
fn place_m(counts: [i32; 3]) -> Option<[f64; 3]> {
    let mut kinematics = Kinematics::default();
    let solution = kinematics.solve(counts.map(|count| count as i16));
    (solution != Solution::Kept).then(|| kinematics.pose().position_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falcon::kinematics::Pose;

    #[test]
    fn a_jump_displaces_the_grip_within_the_range() {
        for seed in 0..60 {
            let counts = Pose::at([0.0, 0.0, 0.110]).expect("within reach").counts();
            let jump = Jump::of(seed, counts).expect("one sign is within reach");
            let seems_mm = 1e3 * jump.grip_m(counts).expect("within reach");
            // One count moves the grip by less than 0.1 mm.
            assert!(
                (MIN_JUMP_MM as f64..MAX_JUMP_MM as f64 + 0.1).contains(&seems_mm),
                "{jump:?}: {seems_mm} mm"
            );
        }
    }
}
