//! The adaptive search: choose the position farthest from all known ones, predict, solve, compare, then add
//! it to the fit.
//!
//! One fit chooses a whole batch of positions. So the result depends neither on the order of the
//! solves nor on the worker that makes them.
//!
//! The error of a prediction is measured as a share of the tolerance. The basic stopping criterion is a
//! validation streak: the last [`STREAK`] predictions are within tolerance. Each prediction is made before
//! the solve, at a position where the fit is unreliable. A streak of ten is evidence and not a certificate.
//!
//! Early predictions used fits with fewer data. A leave-one-out error tests the present data: a fit without
//! one configuration predicts it. These errors modify the criterion:
//!
//! - There are at least ten, and all are within tolerance: a streak of [`BATCH`] suffices.
//! - More than one in [`OUTLIER_DIVISOR`] is beyond the tolerance: no streak suffices.
//! - Otherwise a streak of [`BATCH`] suffices if the kriging variance test passes ([`MAX_DEVIATION`]). At the
//!   boundary of the data a leave-one-out prediction is an extrapolation and can fail although the fit is
//!   accurate. The standard deviation of the fit, scaled by the leave-one-out errors, accounts for this.
//!
//! The leave-one-out errors also choose the kernel length.
//!
//! Positions that are given are solved before those that the search chooses. They add to the fit. Neither their
//! predictions nor their leave-one-out errors count: a hand stays in one part of the reachable set.
//!
//! A chart of a sphere's field gets the configurations of the charts round it that are finished; they are in its fit like
//! its own. Its search ends by the gaps between its data instead ([`gaps`]).
//!
//! The linear model is tested at the same positions without further solves. If it passes at least ten tests
//! and agrees with the fit within tolerance, it is stored instead: the cheapest accurate model is used.

use nalgebra::{Matrix3, Vector3};

use super::branch::contradicts;
use super::fitted::{AdaptiveFit, LeaveOneOutErrors};
use super::linear::{Linear, LinearModelErrors};
use super::prediction::{STREAK, Test, Verdict};
use super::stagnation::is_stagnant;
use crate::fit::{Base, KernelSystem, LEAST_ROOT_J};
use crate::num::jet::EnergyJet;
use crate::num::vector::{difference, distance, norm};
use crate::spec::{GridIndex, MIN_RADIUS_M, Quantity, Requirements, UNIT_M, displacement_m, nearest_index};

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
/// Index of the length that predicts the first batch, before any leave-one-out error compares the lengths.
const INITIAL_LENGTH: usize = 1;
/// A configuration with a force above this multiple of the limit is neither added to the fit nor counted as a
/// test, because the fit must be accurate below the limit. Positions on both sides of the limit are chosen on
/// purpose; those just beyond it are the hardest tests.
pub(crate) const MAX_FORCE_FACTOR: f64 = 1.15;

/// Minimum number of positions for the comparison of the linear model with the fit and for the kriging
/// variance test; rounded up to whole sets of rays (768).
const POSITIONS: u32 = 600;

/// A position to be solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Position in units of `spec::UNIT_M`.
    pub index: GridIndex,
    /// Displacement of the position, m.
    pub displacement_m: [f64; 3],
    /// Index of the configuration at which the solve starts: 0 is rest, then in the order of the solves.
    pub parent: usize,
    /// Force predicted by the fit, N.
    pub predicted_n: [f64; 3],
    /// Whether the search chose it, so that the prediction is a test.
    pub is_test: bool,
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
pub(crate) enum Step {
    /// Solve these positions, in any order.
    Solve(Vec<Target>),
    /// The search has ended.
    Done(Verdict),
}

/// A search in progress.
#[derive(Debug, Clone)]
pub struct Search {
    /// The fit so far with its error estimates.
    pub fitted: AdaptiveFit,
    /// Positions outside the fit: force beyond the limit, other branch, failed, or singular matrix of the
    /// fit. New positions keep a distance from them.
    excluded: Vec<[f64; 3]>,
    fits: Vec<CandidateFit>,
    /// Index of the fit that makes the predictions.
    chosen: usize,
    /// M of the distance |M (a - b)|: the fourth root of the normalised stiffness.
    metric: Matrix3<f64>,
    /// The test of the linear model.
    linear: Linear,
    /// Replacements for positions that failed or exceed the limit: points between parent and target, with
    /// their parents.
    replacements: Vec<([f64; 3], usize)>,
    /// Given positions that are not solved yet, farthest from rest first.
    given_m: Vec<[f64; 3]>,
    /// Whether each configuration of the fit was given: rest, and the given positions.
    is_given: Vec<bool>,
    /// The batch whose results are missing.
    batch: Vec<Target>,
    round: u32,
}

/// A fit with its leave-one-out errors.
#[derive(Debug, Clone)]
struct CandidateFit {
    system: KernelSystem,
    /// Leave-one-out errors of the configurations that the search chose, as shares of the tolerance.
    leave_one_out: Vec<f64>,
}

impl CandidateFit {
    /// Mean of the leave-one-out errors. A mean of squares would be dominated by the boundary of the data and
    /// would select a long kernel, which oscillates in between.
    fn mean_left_out(&self) -> f64 {
        self.leave_one_out.iter().sum::<f64>() / self.leave_one_out.len().max(1) as f64
    }
}

impl Search {
    /// Starts a search with the configuration at zero displacement: that at rest, where energy and force are zero by
    /// definition, or one of a sphere that touches the body.
    pub fn new(wanted: Requirements, rest: &EnergyJet) -> Self {
        let rest = match wanted.quantity {
            Quantity::Energy => rest.as_rest(),
            Quantity::Root => *rest,
        };
        let stiffness = rest.stiffness_n_m;
        let eigen = stiffness.symmetric_eigen();
        let mean = (stiffness.trace() / 3.0).max(f64::MIN_POSITIVE);
        // Stiff directions have a larger weight. The fourth root of the stiffness gave the best results in
        // measurements.
        let roots = eigen.eigenvalues.map(|k| (k.max(1e-2 * mean) / mean).sqrt().sqrt());
        let metric = eigen.eigenvectors * Matrix3::from_diagonal(&roots) * eigen.eigenvectors.transpose();
        // Mean displacement of a linear body at the force limit, at most the radius.
        let reach = (wanted.max_force_n / mean).min(wanted.radius_m).max(UNIT_M);
        let lengths_m: Vec<f64> = match wanted.column {
            None => LENGTH_SHARES.iter().map(|share| share * reach).collect(),
            Some(column) => vec![column.length_m],
        };
        let base = Base::of(wanted.quantity, &rest).unwrap_or(Base::quadratic(stiffness));
        let fits: Vec<CandidateFit> = lengths_m
            .into_iter()
            .filter_map(|length_m| {
                let mut system = KernelSystem::new(length_m, wanted.quantity, base);
                system.add(&[rest]).ok()?;
                Some(CandidateFit { system, leave_one_out: Vec::new() })
            })
            .collect();
        let chosen = INITIAL_LENGTH.min(fits.len() - 1);
        let system = &fits[chosen].system;
        let fitted = AdaptiveFit {
            wanted,
            verdict: None,
            jets: vec![rest],
            shared: Vec::new(),
            fit: system.fit.clone(),
            tests: Vec::new(),
            leave_one_out: Vec::new(),
            deviation: None,
            linear: LinearModelErrors::default(),
            condition: system.condition(),
        };
        let mut linear = Linear::new(stiffness);
        if wanted.quantity == Quantity::Root {
            linear.exclude();
        }
        Self {
            fitted,
            excluded: Vec::new(),
            fits,
            chosen,
            metric,
            linear,
            replacements: Vec::new(),
            given_m: Vec::new(),
            is_given: vec![true],
            batch: Vec::new(),
            round: 0,
        }
    }

    /// The search with positions, m, to solve before those that it chooses, those near rest first.
    #[must_use]
    pub fn after(mut self, given_m: &[[f64; 3]]) -> Self {
        self.given_m = given_m.to_vec();
        self.given_m.sort_by(|a, b| norm(*b).total_cmp(&norm(*a)));
        self
    }

    /// Number of predictions that would end the search if all were within tolerance.
    pub(crate) fn predictions_missing(&self) -> usize {
        let (passes, LeaveOneOutErrors { configurations, beyond, .. }) =
            (self.fitted.passes(), self.fitted.leave_one_out());
        let short = STREAK.saturating_sub(passes);
        if beyond == 0 || self.fitted.deviation.is_some_and(|largest| largest <= MAX_DEVIATION) {
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
            (self.fitted.passes(), self.fitted.leave_one_out());
        let is_between = (BATCH..STREAK).contains(&passes) && configurations >= STREAK;
        (is_between && (1..=configurations / OUTLIER_DIVISOR).contains(&beyond)).then(|| {
            let AdaptiveFit { wanted, fit, .. } = &self.fitted;
            let places = self.fitted.places(POSITIONS);
            let deviations = self.fits[self.chosen].system.deviation_n(&places).into_iter();
            let by_tolerance = |(n, &at): (f64, &[f64; 3])| n / wanted.tolerance.at(fit.force_n(at));
            deviations.zip(&places).map(by_tolerance).fold(0.0, f64::max)
        })
    }

    /// Runs the search to its end; `solve` returns the result of a target.
    pub fn run(&mut self, mut solve: impl FnMut(&Self, &Target) -> SolveResult) -> Verdict {
        loop {
            let targets = match self.step() {
                Step::Done(verdict) => return verdict,
                Step::Solve(targets) => targets,
            };
            let found: Vec<SolveResult> = targets.iter().map(|target| solve(self, target)).collect();
            self.take(&found);
        }
    }

    /// The next step; the same batch until its results are taken.
    pub(crate) fn step(&mut self) -> Step {
        if self.batch.is_empty() {
            self.fitted.verdict = self.end();
        }
        match self.fitted.verdict {
            Some(verdict) => Step::Done(verdict),
            None => Step::Solve(self.batch.clone()),
        }
    }

    /// Returns the result of the search. If it goes on, chooses the next batch and returns `None`.
    fn end(&mut self) -> Option<Verdict> {
        if self.fitted.displacement_in_softest_direction_m() < MIN_RADIUS_M {
            return Some(Verdict::TooStiff);
        }
        let own = self.fitted.jets.len() - self.fitted.shared.len() + self.excluded.len();
        let is_full = own >= self.fitted.wanted.max_configurations;
        while !is_full && self.batch.is_empty() && !self.given_m.is_empty() {
            let first = self.given_m.len().saturating_sub(BATCH);
            for at in self.given_m.split_off(first).into_iter().rev() {
                self.aim(at, self.fitted.nearest(at), false);
            }
        }
        if !self.batch.is_empty() {
            return None;
        }
        if self.fitted.wanted.quantity == Quantity::Root {
            if is_full {
                return Some(Verdict::NotReached);
            }
            self.choose_in_gaps();
            return self.batch.is_empty().then_some(Verdict::Passed);
        }
        if self.linear.tests_missing() == Some(0) && self.linear_agrees() {
            return Some(Verdict::Linear);
        }
        if self.linear.tests_missing().is_none() && self.predictions_missing() == 0 {
            return Some(Verdict::Passed);
        }
        if is_stagnant(&self.fitted.tests) {
            return Some(Verdict::Stagnated);
        }
        if is_full {
            return Some(Verdict::NotReached);
        }
        self.choose();
        self.batch.is_empty().then_some(Verdict::NotReached)
    }

    fn linear_agrees(&mut self) -> bool {
        let AdaptiveFit { wanted, fit, .. } = &self.fitted;
        let fit_values = self.fitted.places(POSITIONS).into_iter().map(|at| {
            let force_n = fit.force_n(at);
            (at, force_n, wanted.tolerance.at(force_n))
        });
        let agrees = self.linear.agrees_with_fit(fit_values);
        self.fitted.linear = self.linear.errors;
        agrees
    }

    /// Chooses a batch: first the replacements for positions that failed or exceed the limit, then the
    /// farthest candidate positions.
    fn choose(&mut self) {
        for (at, parent) in std::mem::take(&mut self.replacements) {
            self.aim(at, parent, true);
        }
        let candidates = self.fitted.candidates(self.round);
        self.round += 1;
        let metric = self.metric;
        let squared = |a: [f64; 3], b: [f64; 3]| (metric * Vector3::from(difference(a, b))).norm_squared();
        let taken: Vec<[f64; 3]> = self.taken().collect();
        let gap = |at: [f64; 3]| taken.iter().map(|&t| squared(at, t)).fold(f64::INFINITY, f64::min);
        let mut gaps: Vec<f64> = candidates.iter().map(|&at| gap(at)).collect();
        // At most as many as the tests that are still missing: those of the linear model, or of the fit once
        // the linear model is excluded.
        let most = self.linear.tests_missing().unwrap_or_else(|| self.predictions_missing()).min(BATCH);
        while self.batch.len() < most {
            let farthest = (0..gaps.len()).max_by(|&a, &b| gaps[a].total_cmp(&gaps[b]).then(b.cmp(&a)));
            let Some(farthest) = farthest.filter(|&n| gaps[n] > 0.0) else { break };
            let at = candidates[farthest];
            for (gap, &other) in gaps.iter_mut().zip(&candidates) {
                *gap = gap.min(squared(at, other));
            }
            self.aim(at, self.fitted.nearest(at), true);
        }
    }

    /// Adds a target to the batch, unless its position is already solved or in the batch.
    fn aim(&mut self, at: [f64; 3], parent: usize, is_test: bool) {
        let index = nearest_index(at);
        let at = displacement_m(index);
        if self.taken().all(|other| other != at) {
            let predicted_n = self.fitted.fit.force_n(at);
            self.batch.push(Target { index, displacement_m: at, parent, predicted_n, is_test });
        }
    }

    /// Positions that are solved or in the batch, m.
    fn taken(&self) -> impl Iterator<Item = [f64; 3]> {
        let solved = self.fitted.jets.iter().map(|jet| jet.control_m).chain(self.excluded.iter().copied());
        solved.chain(self.batch.iter().map(|target| target.displacement_m))
    }

    /// Adds the results of the whole batch, in the order of its targets.
    ///
    /// # Panics
    ///
    /// If the number of results differs from the number of targets.
    pub(crate) fn take(&mut self, found: &[SolveResult]) {
        let batch = std::mem::take(&mut self.batch);
        assert_eq!(batch.len(), found.len(), "one outcome for each target");
        let (mut learned, mut is_given) = (Vec::new(), Vec::new());
        for (target, found) in batch.iter().zip(found) {
            let at = target.displacement_m;
            match found {
                SolveResult::Solved(jet) => {
                    self.score(target, jet);
                    let is_root = self.fitted.wanted.quantity == Quantity::Root;
                    if is_root && self.is_on_another_branch(jet) {
                        // Configurations in between show whether the branch goes on to it.
                        self.excluded.push(at);
                        self.add_replacement(target, f64::INFINITY);
                    } else if is_root && jet.energy_j <= LEAST_ROOT_J {
                        self.excluded.push(at);
                    } else if norm(jet.force_n) <= MAX_FORCE_FACTOR * self.fitted.wanted.max_force_n {
                        learned.push(*jet);
                        is_given.push(!target.is_test);
                    } else {
                        self.excluded.push(at);
                        self.add_replacement(target, norm(jet.force_n));
                    }
                }
                SolveResult::OtherBranch(jet) => {
                    self.score(target, jet);
                    self.linear.exclude();
                    self.excluded.push(at);
                }
                SolveResult::Failed => {
                    self.linear.exclude();
                    self.excluded.push(at);
                    self.add_replacement(target, f64::INFINITY);
                }
            }
        }
        self.learn(learned, &is_given);
    }

    /// Whether the nearest configuration contradicts one.
    fn is_on_another_branch(&self, jet: &EnergyJet) -> bool {
        let nearest = &self.fitted.jets[self.fitted.nearest(jet.control_m)];
        contradicts(jet, nearest, &self.fitted.wanted.tolerance)
    }

    fn score(&mut self, target: &Target, jet: &EnergyJet) {
        if !target.is_test {
            return;
        }
        let tolerance_n = self.fitted.wanted.tolerance.at(jet.force_n);
        let counts = norm(jet.force_n) <= MAX_FORCE_FACTOR * self.fitted.wanted.max_force_n;
        let error_n = distance(target.predicted_n, jet.force_n);
        self.fitted.tests.push(Test { index: target.index, error_n, tolerance_n, counts });
        if counts {
            self.linear.score(jet.control_m, jet.force_n, tolerance_n);
        }
    }

    /// Adds a point between parent and target: where the linearly interpolated force equals the limit,
    /// clamped to 0.2 .. 0.8 of the way. `found_n` is the force at the target, infinite after a failure.
    fn add_replacement(&mut self, target: &Target, found_n: f64) {
        let parent = &self.fitted.jets[target.parent];
        let (low, limit) = (norm(parent.force_n), self.fitted.wanted.max_force_n);
        let share = ((limit - low) / (found_n - low)).clamp(0.2, 0.8);
        let at = std::array::from_fn(|i| {
            parent.control_m[i] + share * (target.displacement_m[i] - parent.control_m[i])
        });
        self.replacements.push((at, target.parent));
    }
}

mod gaps;
mod learning;
#[cfg(test)]
mod tests;
