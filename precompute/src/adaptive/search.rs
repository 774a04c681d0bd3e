//! The adaptive search: choose the position farthest from all known ones, predict, solve, compare, then add
//! it to the fit.
//!
//! One fit chooses a whole batch of positions. The result is thus independent of the order and the place of
//! the solves.
//!
//! The error of a prediction is measured as a share of the tolerance. The basic stopping criterion is a
//! validation streak: the last [`STREAK`] predictions are within tolerance. Each prediction is made before
//! its position is solved, where the fit is least reliable. A streak of ten is evidence and not a
//! certificate.
//!
//! Early predictions used fits with fewer data. Each leave-one-out error of the present fit also compares
//! with a value that its fit does not contain. These errors modify the criterion:
//!
//! - All of at least ten are within tolerance: a streak of [`BATCH`] suffices.
//! - More than one in [`OUTLIER_DIVISOR`] is beyond the tolerance: no streak suffices.
//! - Otherwise a streak of [`BATCH`] suffices if the kriging variance test passes ([`MAX_DEVIATION`]). At the
//!   boundary of the data a leave-one-out prediction is an extrapolation and can fail although the fit is
//!   accurate. The standard deviation of the fit, scaled by the leave-one-out errors, accounts for this.
//!
//! The leave-one-out errors also choose the kernel length.
//!
//! The linear model is tested at the same positions without further solves. If it has at
//! least ten predictions and all are within tolerance, it is stored instead of the fit: the cheapest model
//! within tolerance is used.

use nalgebra::{Matrix3, Vector3};

use super::fitted::{AdaptiveFit, LeaveOneOutErrors, softest_displacement_m};
use super::linear::Linear;
use super::prediction::{STREAK, Test, Verdict, passes};
use super::reach::CurrentModel;
use super::stagnation::is_stagnant;
use crate::fit::KernelFit;
use crate::num::jet::EnergyJet;
use crate::num::vector::{difference, norm};
use crate::spec::{GridIndex, RADII_M, Requirements, UNIT_M, displacement_m, nearest_index};

/// Maximum number of positions of a batch; also the length of the short validation streak.
const BATCH: usize = 4;
/// One leave-one-out error in this many may be beyond the tolerance. Errors at the boundary of the data are
/// extrapolation errors and can be large. If more are large, the energy varies too much between the data, and
/// a streak of ten can be chance.
const OUTLIER_DIVISOR: usize = 5;
/// Kriging variance test: the largest standard deviation of the force over the reachable set, as a share of
/// the tolerance.
const MAX_DEVIATION: f64 = 0.5;
/// Candidate kernel lengths, as shares of the initial estimate of the reachable distance.
const LENGTH_SHARES: [f64; 5] = [0.5, 0.75, 1.1, 1.6, 2.3];
/// A configuration with a force above this multiple of the limit is neither added to the fit nor counted as a
/// test, because the fit must be accurate below the limit. Positions on both sides of the limit are chosen on
/// purpose; those just beyond it are the hardest tests.
const MAX_FORCE_FACTOR: f64 = 1.15;

/// Minimum number of positions for the comparison of the linear model with the fit and for the kriging
/// variance test; rounded up to whole sets of rays (768).
const POSITIONS: u32 = 600;

/// A position to be solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Position in units of `spec::UNIT_M`.
    pub index: GridIndex,
    /// Index of the configuration at which the solve starts: 0 is rest, then in the order of the solves.
    pub parent: usize,
    /// Force predicted by the fit, N.
    pub predicted_n: [f64; 3],
}

impl Target {
    /// Displacement of the position, m.
    pub fn displacement_m(&self) -> [f64; 3] {
        displacement_m(self.index)
    }
}

/// Result of a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SolveResult {
    /// A configuration on the branch of its parent.
    Solved(EnergyJet),
    /// A configuration on another branch.
    OtherBranch(EnergyJet),
    /// The solve failed.
    Failed,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Solve these positions, in any order.
    Solve(Vec<Target>),
    /// The search has ended.
    Done(Verdict),
}

/// A search in progress.
#[derive(Debug, Clone)]
pub struct Search {
    wanted: Requirements,
    /// The configurations in the fit; the first is rest.
    jets: Vec<EnergyJet>,
    /// Positions outside the fit: force beyond the limit, other branch, failed, or singular matrix of the
    /// fit. New positions keep a distance from them.
    others: Vec<[f64; 3]>,
    fits: Vec<Candidate>,
    /// Index of the fit that makes the predictions.
    chosen: usize,
    /// M of the distance |M (a - b)|: the fourth root of the normalised stiffness.
    metric: Matrix3<f64>,
    tests: Vec<Test>,
    /// Largest standard deviation of the fit's force over the reachable set, as a share of the tolerance;
    /// `None` if the stopping criterion does not need it.
    deviation: Option<f64>,
    /// The test of the linear model.
    linear: Linear,
    /// Replacements for positions that failed or exceed the limit: points between parent and target, with
    /// their parents.
    replacements: Vec<([f64; 3], usize)>,
    out: Vec<Target>,
    round: u32,
}

/// A fit with its leave-one-out errors.
#[derive(Debug, Clone)]
struct Candidate {
    fit: KernelFit,
    /// Leave-one-out errors of all configurations except rest, as shares of the tolerance.
    leave_one_out: Vec<f64>,
}

impl Candidate {
    /// Mean of the leave-one-out errors. A mean of squares would be dominated by the boundary of the data and
    /// would select a long kernel, which oscillates in between.
    fn mean_left_out(&self) -> f64 {
        self.leave_one_out.iter().sum::<f64>() / self.leave_one_out.len().max(1) as f64
    }
}

impl Search {
    /// Starts a search with the configuration at rest.
    pub fn new(wanted: Requirements, rest: &EnergyJet) -> Self {
        let stiffness = rest.stiffness_n_m;
        let eigen = stiffness.symmetric_eigen();
        let mean = (stiffness.trace() / 3.0).max(f64::MIN_POSITIVE);
        // Stiff directions have a larger weight. The fourth root of the stiffness gave the best results in
        // measurements.
        let roots = eigen.eigenvalues.map(|k| (k.max(1e-2 * mean) / mean).sqrt().sqrt());
        let metric = eigen.eigenvectors * Matrix3::from_diagonal(&roots) * eigen.eigenvectors.transpose();
        // Mean distance that a linear body would allow the device to reach.
        let reach = (wanted.max_force_n / mean).min(wanted.radius_m).max(UNIT_M);
        let fits = LENGTH_SHARES
            .iter()
            .filter_map(|share| {
                let mut fit = KernelFit::new(share * reach, stiffness);
                fit.add(&[*rest]).ok()?;
                Some(Candidate { fit, leave_one_out: Vec::new() })
            })
            .collect();
        Self {
            wanted,
            jets: vec![*rest],
            others: Vec::new(),
            fits,
            chosen: 1,
            metric,
            tests: Vec::new(),
            deviation: None,
            linear: Linear::new(stiffness),
            replacements: Vec::new(),
            out: Vec::new(),
            round: 0,
        }
    }

    /// The configurations in the fit, rest first.
    pub fn jets(&self) -> &[EnergyJet] {
        &self.jets
    }

    /// The fit with its error estimates: after the search with its `verdict`, during the search with `None`.
    pub fn fitted(&self, verdict: Option<Verdict>) -> AdaptiveFit {
        let Candidate { fit, leave_one_out } = &self.fits[self.chosen];
        AdaptiveFit {
            wanted: self.wanted,
            verdict,
            jets: self.jets.clone(),
            fit: fit.read_only(),
            tests: self.tests.clone(),
            leave_one_out: leave_one_out.clone(),
            deviation: self.deviation,
            linear: self.linear.suits(),
            condition: fit.condition(),
        }
    }

    fn known(&self) -> CurrentModel<'_> {
        CurrentModel { wanted: &self.wanted, fit: self.fit(), jets: &self.jets }
    }

    /// Length of the validation streak, among the predictions that count.
    pub(crate) fn passes(&self) -> usize {
        passes(&self.tests)
    }

    fn leave_one_out(&self) -> LeaveOneOutErrors {
        LeaveOneOutErrors::of(&self.fits[self.chosen].leave_one_out)
    }

    /// Number of predictions that would end the search if all were within tolerance.
    pub(crate) fn predictions_missing(&self) -> usize {
        let (passes, LeaveOneOutErrors { configurations, beyond, .. }) =
            (self.passes(), self.leave_one_out());
        let short = STREAK.saturating_sub(passes);
        if beyond == 0 || self.deviation.is_some_and(|largest| largest <= MAX_DEVIATION) {
            short.min(STREAK.saturating_sub(configurations).max(BATCH.saturating_sub(passes)))
        } else if beyond * OUTLIER_DIVISOR <= configurations {
            short
        } else {
            short.max(BATCH)
        }
    }

    /// Largest standard deviation of the fit's force over the reachable set, as a share of the tolerance.
    /// Expensive; computed only if the stopping criterion depends on it.
    fn largest_deviation(&self) -> Option<f64> {
        let (passes, LeaveOneOutErrors { configurations, beyond, .. }) =
            (self.passes(), self.leave_one_out());
        let is_between = (BATCH..STREAK).contains(&passes) && configurations >= STREAK;
        (is_between && (1..=configurations / OUTLIER_DIVISOR).contains(&beyond)).then(|| {
            let places = self.known().places(POSITIONS);
            let deviations = self.fit().deviation_n(&places).into_iter();
            let by_tolerance =
                |(n, &at): (f64, &[f64; 3])| n / self.wanted.tolerance.at(self.fit().force_n(at));
            deviations.zip(&places).map(by_tolerance).fold(0.0, f64::max)
        })
    }

    /// The fit that makes the predictions.
    pub fn fit(&self) -> &KernelFit {
        &self.fits[self.chosen].fit
    }

    /// The next step. While a batch is incomplete, it is this batch.
    pub fn step(&mut self) -> Step {
        if !self.out.is_empty() {
            return Step::Solve(self.out.clone());
        }
        if softest_displacement_m(&self.wanted, &self.jets) < RADII_M[0] {
            return Step::Done(Verdict::TooStiff);
        }
        if self.linear.wants() == Some(0) && self.linear_agrees() {
            return Step::Done(Verdict::Linear);
        }
        if self.linear.wants().is_none() && self.predictions_missing() == 0 {
            return Step::Done(Verdict::Passed);
        }
        if is_stagnant(&self.tests) {
            return Step::Done(Verdict::Stagnated);
        }
        if self.jets.len() + self.others.len() >= self.wanted.most {
            return Step::Done(Verdict::NotReached);
        }
        self.choose();
        if self.out.is_empty() { Step::Done(Verdict::NotReached) } else { Step::Solve(self.out.clone()) }
    }

    fn linear_agrees(&mut self) -> bool {
        let places = self.known().places(POSITIONS);
        let (fit, tolerance) = (&self.fits[self.chosen].fit, self.wanted.tolerance);
        let said = places.into_iter().map(|at| {
            let force_n = fit.force_n(at);
            (at, force_n, tolerance.at(force_n))
        });
        self.linear.agrees_with_fit(said)
    }

    /// Chooses a batch: first the replacements for positions beyond the limit, then the farthest candidates.
    fn choose(&mut self) {
        for (at, parent) in std::mem::take(&mut self.replacements) {
            self.aim(at, parent);
        }
        let candidates = self.known().candidates(self.round);
        self.round += 1;
        let distance =
            |a: [f64; 3], b: [f64; 3]| (self.metric * Vector3::from(difference(a, b))).norm_squared();
        let taken = self.jets.iter().map(|jet| jet.control_m).chain(self.others.iter().copied());
        let taken: Vec<[f64; 3]> = taken.chain(self.out.iter().map(Target::displacement_m)).collect();
        let gap = |at: [f64; 3]| taken.iter().map(|&t| distance(at, t)).fold(f64::INFINITY, f64::min);
        let mut gaps: Vec<f64> = candidates.iter().map(|&at| gap(at)).collect();
        // At most as many as could end the search or, while the linear model is not excluded, complete its
        // tests.
        let most = self.linear.wants().unwrap_or_else(|| self.predictions_missing()).min(BATCH);
        while self.out.len() < most {
            let farthest = (0..gaps.len()).max_by(|&a, &b| gaps[a].total_cmp(&gaps[b]).then(b.cmp(&a)));
            let Some(farthest) = farthest.filter(|&n| gaps[n] > 0.0) else { break };
            let at = candidates[farthest];
            for (gap, &other) in gaps.iter_mut().zip(&candidates) {
                *gap = gap.min((self.metric * Vector3::from(difference(at, other))).norm_squared());
            }
            let near = |jet: &EnergyJet| norm(difference(at, jet.control_m));
            let parent =
                (0..self.jets.len()).min_by(|&a, &b| near(&self.jets[a]).total_cmp(&near(&self.jets[b])));
            self.aim(at, parent.unwrap_or(0));
        }
    }

    /// Adds a target to the batch, unless its position is already solved or in the batch.
    fn aim(&mut self, at: [f64; 3], parent: usize) {
        let index = nearest_index(at);
        let at = displacement_m(index);
        let known = self.jets.iter().map(|jet| jet.control_m).chain(self.others.iter().copied());
        if known.chain(self.out.iter().map(Target::displacement_m)).all(|other| other != at) {
            self.out.push(Target { index, parent, predicted_n: self.fit().force_n(at) });
        }
    }

    /// Adds the results of the whole batch, in the order of its targets.
    ///
    /// # Panics
    ///
    /// If the number of results differs from the number of targets.
    pub fn take(&mut self, found: &[SolveResult]) {
        let batch = std::mem::take(&mut self.out);
        assert_eq!(batch.len(), found.len(), "one outcome for each target");
        let mut learned = Vec::new();
        for (target, found) in batch.iter().zip(found) {
            let at = target.displacement_m();
            match found {
                SolveResult::Solved(jet) => {
                    self.score(target, jet);
                    if norm(jet.force_n) <= MAX_FORCE_FACTOR * self.wanted.max_force_n {
                        learned.push(*jet);
                    } else {
                        self.others.push(at);
                        self.add_replacement(target, norm(jet.force_n));
                    }
                }
                SolveResult::OtherBranch(jet) => {
                    self.score(target, jet);
                    self.linear.exclude();
                    self.others.push(at);
                }
                SolveResult::Failed => {
                    self.linear.exclude();
                    self.others.push(at);
                    self.add_replacement(target, f64::INFINITY);
                }
            }
        }
        let grown: Vec<bool> =
            self.fits.iter_mut().map(|candidate| candidate.fit.add(&learned).is_ok()).collect();
        if grown.contains(&true) {
            let mut grown = grown.into_iter();
            self.fits.retain(|_| grown.next().unwrap_or(false));
            self.jets.extend(learned);
        } else {
            // No kernel length makes the matrix regular, so the fits do not change.
            self.others.extend(learned.iter().map(|jet| jet.control_m));
        }
        for candidate in &mut self.fits {
            let missed = candidate.fit.leave_one_out_n().zip(&self.jets).skip(1);
            candidate.leave_one_out =
                missed.map(|(missed, jet)| norm(missed) / self.wanted.tolerance.at(jet.force_n)).collect();
        }
        let best = (0..self.fits.len())
            .min_by(|&a, &b| self.fits[a].mean_left_out().total_cmp(&self.fits[b].mean_left_out()));
        self.chosen = best.unwrap_or(0);
        self.deviation = self.largest_deviation();
    }

    fn score(&mut self, target: &Target, jet: &EnergyJet) {
        let tolerance_n = self.wanted.tolerance.at(jet.force_n);
        let within = norm(jet.force_n) <= MAX_FORCE_FACTOR * self.wanted.max_force_n;
        let error_n = norm(difference(target.predicted_n, jet.force_n));
        self.tests.push(Test { index: target.index, error_n, tolerance_n, within });
        if within {
            self.linear.score(jet.control_m, jet.force_n, tolerance_n);
        }
    }

    /// Adds a point between parent and target: where the linearly interpolated force equals the limit, but at
    /// 0.2 to 0.8 of the way; at 0.2 after a failure (`came_out_n` infinite).
    fn add_replacement(&mut self, target: &Target, came_out_n: f64) {
        let parent = &self.jets[target.parent];
        let (low, limit) = (norm(parent.force_n), self.wanted.max_force_n);
        let share = ((limit - low) / (came_out_n - low)).clamp(0.2, 0.8);
        let at = std::array::from_fn(|i| {
            parent.control_m[i] + share * (target.displacement_m()[i] - parent.control_m[i])
        });
        self.replacements.push((at, target.parent));
    }
}

#[cfg(test)]
mod tests;
