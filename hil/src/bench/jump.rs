//! How an encoder miscounts: by as much as moves the grip some millimetres, as a driver reckons it.

use crate::fault::split_mix;
use palpate_host::device::falcon::kinematics::{Kinematics, Solution};

/// How far the grip seems to have gone, mm.
const LEAST_MM: u64 = 5;
const MOST_MM: u64 = 30;
/// More than an arm has.
const MOST_COUNTS: i32 = 3_000;

/// One encoder that counts on from elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Jump {
    /// Whose.
    pub axis: usize,
    /// By how much.
    pub counts: i32,
}

impl Jump {
    /// The jump of a run while its encoders are at `counts`; the other way round if the legs would not reach.
    pub(super) fn of(seed: u64, counts: [i32; 3]) -> Option<Self> {
        let axis = (split_mix(seed, 0) % 3) as usize;
        let sign = if split_mix(seed, 1).is_multiple_of(2) { 1 } else { -1 };
        let wanted_m = 1e-3 * (LEAST_MM + split_mix(seed, 2) % (MOST_MM - LEAST_MM)) as f64;
        let by = |counts| Self { axis, counts };
        let is_enough = |jump: &Self| jump.grip_m(counts).is_some_and(|m| m >= wanted_m);
        let one_way = |sign: i32| (1..MOST_COUNTS).map(|n| by(sign * n)).find(is_enough);
        one_way(sign).or_else(|| one_way(-sign))
    }

    /// How far the grip seems to go, m.
    fn grip_m(self, counts: [i32; 3]) -> Option<f64> {
        let (from_m, mut to) = (place_m(counts)?, counts);
        to[self.axis] += self.counts;
        let to_m = place_m(to)?;
        Some((0..3).map(|i| (to_m[i] - from_m[i]).powi(2)).sum::<f64>().sqrt())
    }
}

/// Where a driver puts the grip, m.
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
    fn the_grip_goes_as_far_as_it_says() {
        for seed in 0..60 {
            let counts = Pose::at([0.0, 0.0, 0.110]).expect("within reach").counts();
            let jump = Jump::of(seed, counts).expect("one way or the other");
            let seems_mm = 1e3 * jump.grip_m(counts).expect("within reach");
            // A count moves it by less than a tenth of a millimetre.
            assert!((LEAST_MM as f64..MOST_MM as f64 + 0.1).contains(&seems_mm), "{jump:?}: {seems_mm} mm");
        }
    }
}
