//! A push along the inward normal until the force reaches a value.
//!
//! With the inward unit normal m, the tool displaced by z m and the force h of the tool on the body,
//!
//! F(z) = m . h,   F' = m . S m,   F'' = W_ijk m_i m_j m_k.
//!
//! Every solve gives all three, so two solves give F between them by a quintic polynomial (Hermite
//! interpolation). A push that ends where the series of the rest solution predicts the force is mostly
//! enough: the force there is near the wanted one, and the polynomial gives the depth. Its error is estimated
//! by the difference from the cubic polynomial through F and F' alone, which has a lower order; if that is
//! large, the depth is solved again.
//!
//! Nearly all the time goes into factorisations, and every push needs one at rest. Its factor serves for the
//! solve at the depth too ([`Solver::follow`]), where the error of F is of second order in the residual that
//! is left.

use crate::fem::{Configuration, FollowOptions, Seed, SolveFailure, Solver};
use crate::num::THIRD_INDICES;
use crate::num::jet::EnergyJet;
use crate::num::vector::dot;

/// How far a push goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Wanted normal force, N.
    pub force_n: f64,
    /// Largest depth, m.
    pub max_depth_m: f64,
}

/// Largest difference between the two polynomials, as a share of the force.
const AGREEMENT: f64 = 2e-3;
/// A push aims at so much more than the wanted force, so that the wanted depth lies between two solves.
const AIM: f64 = 1.02;
/// Maximum number of solves of a push.
const MAX_SOLVES: usize = 12;
/// Accuracy of a solve with the factor at hand: the error of F is about the product of residual and
/// sensitivity, that of F' the square of the sensitivity.
const FOLLOW: FollowOptions = FollowOptions {
    residual: 1e-4,
    max_frozen_steps: 12,
    max_steps: 40,
    sensitivity: 1e-3,
    max_sweeps: 10,
    worst_sensitivity: 3e-3,
    renews: true,
    gives_up: false,
};
/// Halvings of the interval in the search for a depth: to rounding.
const HALVINGS: u32 = 60;

/// The normal force and its derivatives at one depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Depth z, m.
    pub depth_m: f64,
    /// F, N.
    pub force_n: f64,
    /// F', N/m.
    pub slope_n_m: f64,
    /// F'', N/m^2.
    pub curvature_n_m2: f64,
}

impl Sample {
    /// The sample of a jet at the displacement `depth_m` m.
    pub(super) fn of(jet: &EnergyJet, inward: [f64; 3], depth_m: f64) -> Self {
        let m = nalgebra::Vector3::from(inward);
        let third = THIRD_INDICES.iter().zip(jet.third_n_m2).map(|([i, j, k], value)| {
            // Number of distinct permutations of the indices.
            let times = if i == k {
                1.0
            } else if i == j || j == k {
                3.0
            } else {
                6.0
            };
            times * value * m[*i] * m[*j] * m[*k]
        });
        Self {
            depth_m,
            force_n: dot(jet.force_n, inward),
            slope_n_m: m.dot(&(jet.stiffness_n_m * m)),
            curvature_n_m2: third.sum(),
        }
    }

    /// F at another depth by the series, N.
    fn taylor_n(&self, depth_m: f64) -> f64 {
        let z = depth_m - self.depth_m;
        self.force_n + z * (self.slope_n_m + 0.5 * z * self.curvature_n_m2)
    }

    /// The first depth below this one where the series reaches a larger force, m; `None` if it never does.
    fn depth_at(&self, force_n: f64) -> Option<f64> {
        let (missing, slope) = (force_n - self.force_n, self.slope_n_m);
        let square = slope * slope + 2.0 * self.curvature_n_m2 * missing;
        // This form of the root has no cancellation as the curvature goes to zero.
        let z = 2.0 * missing / (slope + square.sqrt());
        (square >= 0.0 && slope > 0.0 && z.is_finite()).then_some(self.depth_m + z)
    }
}

/// The two polynomials through the samples at the ends of an interval.
#[derive(Debug, Clone, Copy)]
struct Between(Sample, Sample);

impl Between {
    /// The quintic polynomial through F, F' and F'', N.
    fn quintic_n(&self, depth_m: f64) -> f64 {
        let Self(a, b) = self;
        let length_m = b.depth_m - a.depth_m;
        let part = |end: &Sample, t: f64, sign: f64| {
            let (t2, t3) = (t * t, t * t * t);
            let value = 1.0 - t3 * (10.0 - t * (15.0 - 6.0 * t));
            let slope = t - t3 * (6.0 - t * (8.0 - 3.0 * t));
            let curvature = 0.5 * (t2 - t3 * (3.0 - t * (3.0 - t)));
            end.force_n * value
                + sign * length_m * end.slope_n_m * slope
                + length_m * length_m * end.curvature_n_m2 * curvature
        };
        let t = (depth_m - a.depth_m) / length_m;
        part(a, t, 1.0) + part(b, 1.0 - t, -1.0)
    }

    /// The cubic polynomial through F and F', N.
    fn cubic_n(&self, depth_m: f64) -> f64 {
        let Self(a, b) = self;
        let length_m = b.depth_m - a.depth_m;
        let part = |end: &Sample, t: f64, sign: f64| {
            let rest = 1.0 - t;
            end.force_n * (rest * rest * (1.0 + 2.0 * t))
                + sign * length_m * end.slope_n_m * (t * rest * rest)
        };
        let t = (depth_m - a.depth_m) / length_m;
        part(a, t, 1.0) + part(b, 1.0 - t, -1.0)
    }

    /// The depth where the quintic polynomial has a force between those of the ends, m.
    fn depth_at(&self, force_n: f64) -> f64 {
        let (mut low, mut high) = (self.0.depth_m, self.1.depth_m);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if self.quintic_n(middle) < force_n { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

/// The equilibrium at a displacement of the tool, with the factor at hand if it serves, otherwise in smaller
/// steps.
fn deeper(solver: &mut Solver, from: &Seed, control_m: [f64; 3]) -> Result<Seed, SolveFailure> {
    if !solver.problem().has_multipliers() {
        let mut found = from.clone();
        if solver.follow(from, control_m, false, &FOLLOW, &mut found).is_ok() {
            return Ok(found);
        }
    }
    solver.advance(from, control_m).map(|Configuration { seed, .. }| seed)
}

/// A push along the inward normal: samples in ascending order of depth, the first at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Press {
    /// The samples.
    pub samples: Vec<Sample>,
    /// Depths of the solves after rest, in their order, m.
    pub(super) solved_m: Vec<f64>,
    /// The solve that found no equilibrium, and ended the push.
    pub failure: Option<SolveFailure>,
}

impl Press {
    /// Pushes until the force reaches `goal.force_n` or the depth `goal.max_depth_m`. An error is that of the
    /// body at rest; a failure later ends the push.
    pub(super) fn to(solver: &mut Solver, inward: [f64; 3], goal: &Goal) -> Result<Self, SolveFailure> {
        let mut here = solver.rest()?.seed;
        let mut press = Self::at_rest(&here.jet, inward);
        while press.samples.len() < MAX_SOLVES
            && let Some(next_m) = press.next_m(goal)
        {
            match deeper(solver, &here, inward.map(|x| next_m * x)) {
                Ok(found) => {
                    press.add(Sample::of(&found.jet, inward, next_m));
                    here = found;
                }
                Err(failure) => {
                    press.failure = Some(failure);
                    break;
                }
            }
        }
        Ok(press)
    }

    /// Pushes to the depths of another push, in its order.
    pub(super) fn like(solver: &mut Solver, inward: [f64; 3], other: &Self) -> Result<Self, SolveFailure> {
        let mut here = solver.rest()?.seed;
        let mut press = Self::at_rest(&here.jet, inward);
        for &next_m in &other.solved_m {
            here = deeper(solver, &here, inward.map(|x| next_m * x))?;
            press.add(Sample::of(&here.jet, inward, next_m));
        }
        Ok(press)
    }

    fn at_rest(jet: &EnergyJet, inward: [f64; 3]) -> Self {
        let samples = vec![Sample::of(&jet.as_rest(), inward, 0.0)];
        Self { samples, solved_m: Vec::new(), failure: None }
    }

    fn add(&mut self, sample: Sample) {
        self.solved_m.push(sample.depth_m);
        let at = self.samples.partition_point(|other| other.depth_m < sample.depth_m);
        self.samples.insert(at, sample);
    }

    /// The first interval in which the force reaches a value.
    fn around(&self, force_n: f64) -> Option<Between> {
        let ends = self.samples.windows(2).find(|ends| ends[1].force_n >= force_n)?;
        Some(Between(ends[0], ends[1]))
    }

    /// The depth to solve next, m; `None` at the end of the push.
    fn next_m(&self, goal: &Goal) -> Option<f64> {
        if let Some(around) = self.around(goal.force_n) {
            let depth_m = around.depth_at(goal.force_n);
            let differs_n = (around.cubic_n(depth_m) - goal.force_n).abs();
            return (differs_n > AGREEMENT * goal.force_n).then_some(depth_m);
        }
        let last = self.samples.last().expect("a push has its rest");
        let aim_m = last.depth_at(AIM * goal.force_n).unwrap_or(goal.max_depth_m);
        (last.depth_m < goal.max_depth_m).then_some(aim_m.min(goal.max_depth_m))
    }

    /// The stiffness at rest, N/m.
    pub fn stiffness_n_m(&self) -> f64 {
        self.samples[0].slope_n_m
    }

    /// The depth where the force reaches a value, m; `None` if the push ended before.
    pub fn depth_at(&self, force_n: f64) -> Option<f64> {
        self.around(force_n).map(|around| around.depth_at(force_n))
    }

    /// The largest depth that is solved, m.
    pub fn end_m(&self) -> f64 {
        self.samples.last().map_or(0.0, |sample| sample.depth_m)
    }

    /// The force at a depth, N; beyond the last solve by its series.
    pub fn force_n(&self, depth_m: f64) -> f64 {
        let around = self.samples.windows(2).find(|ends| ends[1].depth_m >= depth_m);
        let last = self.samples.last().expect("a push has its rest");
        around.map_or_else(|| last.taylor_n(depth_m), |ends| Between(ends[0], ends[1]).quintic_n(depth_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(depth_m: f64) -> Sample {
        let z = depth_m;
        Sample {
            depth_m,
            force_n: 100.0 * z + 2e3 * z * z + 1e6 * z.powi(3) - 1e7 * z.powi(5),
            slope_n_m: 100.0 + 4e3 * z + 3e6 * z * z - 5e7 * z.powi(4),
            curvature_n_m2: 4e3 + 6e6 * z - 2e8 * z.powi(3),
        }
    }

    #[test]
    fn the_quintic_polynomial_is_exact_and_the_cubic_one_is_not() {
        let between = Between(sample(1e-3), sample(0.02));
        for depth_m in [1e-3, 4e-3, 0.011, 0.02] {
            let exact = sample(depth_m).force_n;
            assert!((between.quintic_n(depth_m) - exact).abs() < 1e-14 * exact.max(1.0), "{depth_m}");
        }
        let error = between.cubic_n(0.011) - sample(0.011).force_n;
        assert!(error.abs() > 1e-4 && error.abs() < 0.1, "{error}");
        let depth_m = between.depth_at(1.0);
        assert!((sample(depth_m).force_n - 1.0).abs() < 1e-12, "{depth_m}");
    }

    #[test]
    fn the_series_reaches_a_force_where_it_has_it() {
        for curvature_n_m2 in [-3e3, 0.0, 3e3] {
            let sample = Sample { depth_m: 1e-3, force_n: 0.1, slope_n_m: 90.0, curvature_n_m2 };
            let depth_m = sample.depth_at(1.0).expect("it rises enough");
            assert!((sample.taylor_n(depth_m) - 1.0).abs() < 1e-12, "{curvature_n_m2}: {depth_m}");
        }
        let falls = Sample { depth_m: 0.0, force_n: 0.0, slope_n_m: 50.0, curvature_n_m2: -3e3 };
        assert_eq!((falls.depth_at(1.0), Sample { slope_n_m: -1.0, ..falls }.depth_at(1.0)), (None, None));
    }

    /// The polynomial is not trusted where its two orders differ, and no solve is beyond the cap.
    #[test]
    fn a_push_goes_on_until_the_force_is_known() {
        let goal = Goal { force_n: 1.0, max_depth_m: 0.02 };
        let mut press = Press { samples: vec![sample(0.0)], solved_m: Vec::new(), failure: None };
        let mut solves = 0;
        while let Some(next_m) = press.next_m(&goal) {
            assert!(next_m <= goal.max_depth_m && solves < 5, "{next_m}");
            press.add(sample(next_m));
            solves += 1;
        }
        assert!(solves >= 1 && press.samples.is_sorted_by_key(|sample| sample.depth_m));
        let depth_m = press.depth_at(1.0).expect("within the cap");
        assert!((sample(depth_m).force_n - 1.0).abs() < 1e-3, "{depth_m}");
        assert!((press.force_n(depth_m) - 1.0).abs() < 1e-12);
        let low = Goal { max_depth_m: 4e-3, ..goal };
        let mut press = Press { samples: vec![sample(0.0)], solved_m: Vec::new(), failure: None };
        assert_eq!(press.next_m(&low), Some(4e-3));
        press.add(sample(4e-3));
        assert_eq!((press.next_m(&low), press.depth_at(1.0), press.end_m()), (None, None, 4e-3));
    }
}
