//! The blind loop: take the position farthest from all that is known, predict, solve, score, and only then learn.
//!
//! A batch is chosen with one fit, whoever solves it and in whatever order: the outcome depends on neither.
//!
//! The score of a prediction is its error by the tolerance there. The loop stops when the last [`PASSES`] of them are all within it: a
//! verdict that is honest because no prediction had seen its answer, and strict because they were made where the fit knows least, but
//! no certificate: ten passes prove little by themselves.
//!
//! Early predictions were made by fits that knew less. What the present fit would say of a configuration if it knew only the others has not
//! seen its answer either: where all of those are within the tolerance, ten at least, the last [`BATCH`] predictions are enough; where more than
//! one in [`ONE_IN`] is beyond it, none are. Between the two they are enough where the fit is [`SURE`]: those at the edge of what is known are
//! said by extrapolation and may be beyond, and what that says of the present fit its deviation tells, which the left-out errors scale. The same
//! errors choose the kernel's length.
//!
//! Beside the fit the linear body is tested, at no cost. Where every prediction of it, ten at least, is within the tolerance too, it is what is
//! stored: the cheapest model within tolerance wins.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::fitted::{AdaptiveFit, LeftOut};
use super::linear::Linear;
use super::reach::Known;
use super::stagnation::is_stalled;
use crate::fit::KernelFit;
use crate::num::jet::EnergyJet;
use crate::num::vector::{difference, norm};
use crate::spec::{GridIndex, Wanted, displacement_m, nearest_index};

/// Positions of a batch, at most; and predictions in a row that must be within tolerance where all left-out configurations are.
const BATCH: usize = 4;
/// Predictions in a row that must be within tolerance.
pub const PASSES: usize = 10;
/// Of the configurations no more than one in so many may be beyond the tolerance as the others say it. Those at the edge of what is known are
/// said by extrapolation and may be; where a body is too rough for its data they are more, and ten good predictions in a row are chance.
const ONE_IN: usize = 5;
/// The fit is sure of itself where the deviation of its force, as far as it can be estimated, is within this share of the tolerance wherever the tool gets.
const SURE: f64 = 0.5;
/// Lengths of the kernel that are tried side by side, as shares of the reach at first sight.
const LENGTHS: [f64; 5] = [0.5, 0.75, 1.1, 1.6, 2.3];
/// What comes out beyond this share of the limit is not learned from, nor does it count as a test: the fit is for the other side. The rim
/// itself is aimed at from both sides, and a test just beyond it is the hardest there is.
const TOO_FAR: f64 = 1.15;

/// Places where the linear body is held against the fit.
const PLACES: u32 = 600;

/// A position to be solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Where, in units of [`crate::spec::UNIT_M`].
    pub index: GridIndex,
    /// Which of the configurations known so far to come from: 0 is rest, then in the order they were found.
    pub parent: usize,
    /// The force that the fit says, N.
    pub predicted_n: [f64; 3],
}

impl Target {
    /// Where, m.
    pub fn displacement_m(&self) -> [f64; 3] {
        displacement_m(self.index)
    }
}

/// What came of a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Found {
    /// A configuration on the branch of its parent.
    Solved(EnergyJet),
    /// A configuration on another branch.
    Elsewhere(EnergyJet),
    /// Nothing.
    Failed,
}

/// A prediction and what was true.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Test {
    /// Where, in units of [`crate::spec::UNIT_M`].
    pub index: GridIndex,
    /// |error|, N.
    pub error_n: f64,
    /// What it may have been, N.
    pub tolerance_n: f64,
    /// Whether |h| is near enough to the limit to be learned from: only those count.
    pub within: bool,
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verdict {
    /// All predictions of the linear body, ten or more, were within tolerance: nothing else is needed.
    Linear,
    /// The last ten predictions were within tolerance and few configurations beyond it as the others say, or the last four, and either none is or the
    /// fit is sure of itself.
    Passed,
    /// They ceased to fall before they were: the space folds, and a lattice has taken over.
    Stalled,
    /// As many configurations as may be, and still not.
    NotReached,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Solve these, in any order.
    Solve(Vec<Target>),
    /// It is over.
    Done(Verdict),
}

/// A search in progress.
#[derive(Debug, Clone)]
pub struct Search {
    wanted: Wanted,
    /// What was learned from; the first is rest.
    jets: Vec<EnergyJet>,
    /// Solved, beyond the limit or elsewhere: parents and places to keep away from.
    others: Vec<[f64; 3]>,
    fits: Vec<Candidate>,
    /// Which fit predicts.
    chosen: usize,
    /// Square root of the metric in which distances count.
    metric: Matrix3<f64>,
    tests: Vec<Test>,
    /// The largest deviation of the fit's force by the tolerance there, over places within reach; none where the stop does not ask.
    deviation: Option<f64>,
    /// The linear body, beside the fits.
    linear: Linear,
    /// Positions nearer to rest than one that came out too far.
    pulled_back: Vec<([f64; 3], usize)>,
    out: Vec<Target>,
    round: u32,
}

/// A fit and how well it predicts each of its configurations from the others.
#[derive(Debug, Clone)]
struct Candidate {
    fit: KernelFit,
    /// Errors by the tolerance, of all but rest.
    left_out: Vec<f64>,
}

impl Candidate {
    /// Not of their squares: the largest are of configurations at the edge of what is known. A long kernel says those best, and rings between.
    fn mean_left_out(&self) -> f64 {
        self.left_out.iter().sum::<f64>() / self.left_out.len().max(1) as f64
    }
}

impl Search {
    /// A search that knows the configuration at rest.
    pub fn new(wanted: Wanted, rest: &EnergyJet) -> Self {
        let stiffness = rest.stiffness_n_m;
        let eigen = stiffness.symmetric_eigen();
        let mean = (stiffness.trace() / 3.0).max(f64::MIN_POSITIVE);
        // Stiff directions count more: the fourth root of the stiffness, as measured best.
        let roots = eigen.eigenvalues.map(|k| (k.max(1e-2 * mean) / mean).powf(0.25));
        let metric = eigen.eigenvectors * Matrix3::from_diagonal(&roots) * eigen.eigenvectors.transpose();
        // How far a linear body would let the device get, on the average.
        let reach = (wanted.max_force_n / mean).min(wanted.radius_m);
        let fits = LENGTHS
            .iter()
            .filter_map(|share| {
                let mut fit = KernelFit::new(share * reach, stiffness);
                fit.add(&[*rest]).ok()?;
                Some(Candidate { fit, left_out: Vec::new() })
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
            pulled_back: Vec::new(),
            out: Vec::new(),
            round: 0,
        }
    }

    /// What was learned from, rest first.
    pub fn jets(&self) -> &[EnergyJet] {
        &self.jets
    }

    /// What is wanted.
    pub fn wanted(&self) -> &Wanted {
        &self.wanted
    }

    /// The fit and what is known of it, once the search ended with `verdict`; without one, as far as it is.
    pub fn fitted(&self, verdict: Option<Verdict>) -> AdaptiveFit {
        let Candidate { fit, left_out } = &self.fits[self.chosen];
        AdaptiveFit {
            wanted: self.wanted,
            verdict,
            jets: self.jets.clone(),
            fit: fit.as_it_is(),
            tests: self.tests.clone(),
            left_out: left_out.clone(),
            deviation: self.deviation,
            linear: self.linear.suits(),
            condition: fit.condition(),
        }
    }

    fn known(&self) -> Known<'_> {
        Known { wanted: &self.wanted, fit: self.fit(), jets: &self.jets }
    }

    /// Predictions within tolerance since the last that was not, of those that count.
    pub fn passes(&self) -> usize {
        passes(&self.tests)
    }

    fn left_out(&self) -> LeftOut {
        LeftOut::of(&self.fits[self.chosen].left_out)
    }

    /// Predictions that would end it, if all are within tolerance.
    fn short_of_passing(&self) -> usize {
        let (passes, LeftOut { configurations, beyond, .. }) = (self.passes(), self.left_out());
        let short = PASSES.saturating_sub(passes);
        if beyond == 0 || self.deviation.is_some_and(|largest| largest <= SURE) {
            short.min(PASSES.saturating_sub(configurations).max(BATCH.saturating_sub(passes)))
        } else if beyond * ONE_IN <= configurations {
            short
        } else {
            short.max(BATCH)
        }
    }

    /// The largest deviation of the fit's force by the tolerance there, over places within reach: asked where nothing else is between the loop and its
    /// end, and costly enough not to be asked before.
    fn asked_deviation(&self) -> Option<f64> {
        let (passes, LeftOut { configurations, beyond, .. }) = (self.passes(), self.left_out());
        let is_between = (BATCH..PASSES).contains(&passes) && configurations >= PASSES;
        (is_between && (1..=configurations / ONE_IN).contains(&beyond)).then(|| {
            let places = self.known().places(PLACES);
            let deviations = self.fit().deviation_n(&places).into_iter();
            let by_tolerance =
                |(n, &at): (f64, &[f64; 3])| n / self.wanted.tolerance.at(self.fit().force_n(at));
            deviations.zip(&places).map(by_tolerance).fold(0.0, f64::max)
        })
    }

    /// The fit that predicts.
    pub fn fit(&self) -> &KernelFit {
        &self.fits[self.chosen].fit
    }

    /// What to do next. Until all targets of a batch came back it is that batch.
    pub fn step(&mut self) -> Step {
        if !self.out.is_empty() {
            return Step::Solve(self.out.clone());
        }
        if self.linear.wants() == Some(0) && self.linear_is_enough() {
            return Step::Done(Verdict::Linear);
        }
        if self.linear.wants().is_none() && self.short_of_passing() == 0 {
            return Step::Done(Verdict::Passed);
        }
        if is_stalled(&self.tests) {
            return Step::Done(Verdict::Stalled);
        }
        if self.jets.len() + self.others.len() >= self.wanted.most {
            return Step::Done(Verdict::NotReached);
        }
        self.choose();
        if self.out.is_empty() { Step::Done(Verdict::NotReached) } else { Step::Solve(self.out.clone()) }
    }

    fn linear_is_enough(&mut self) -> bool {
        let places = self.known().places(PLACES);
        let (fit, tolerance) = (&self.fits[self.chosen].fit, self.wanted.tolerance);
        let said = places.into_iter().map(|at| {
            let force_n = fit.force_n(at);
            (at, force_n, tolerance.at(force_n))
        });
        self.linear.is_enough(said)
    }

    /// A batch: what was pulled back first, then the farthest candidates.
    fn choose(&mut self) {
        for (at, parent) in std::mem::take(&mut self.pulled_back) {
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
        // No more than would show that it is over, or that the linear body is enough, as long as it may be.
        let most = self.linear.wants().unwrap_or_else(|| self.short_of_passing()).min(BATCH);
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

    /// Adds a target to the batch, unless something was solved or is sought there.
    fn aim(&mut self, at: [f64; 3], parent: usize) {
        let index = nearest_index(at);
        let at = displacement_m(index);
        let known = self.jets.iter().map(|jet| jet.control_m).chain(self.others.iter().copied());
        if known.chain(self.out.iter().map(Target::displacement_m)).all(|other| other != at) {
            self.out.push(Target { index, parent, predicted_n: self.fit().force_n(at) });
        }
    }

    /// Takes what came of the whole batch, in the order of its targets.
    ///
    /// # Panics
    /// If it is not one outcome for each target.
    pub fn take(&mut self, found: &[Found]) {
        let batch = std::mem::take(&mut self.out);
        assert_eq!(batch.len(), found.len(), "one outcome for each target");
        let mut learned = Vec::new();
        for (target, found) in batch.iter().zip(found) {
            let at = target.displacement_m();
            match found {
                Found::Solved(jet) => {
                    self.score(target, jet);
                    if norm(jet.force_n) <= TOO_FAR * self.wanted.max_force_n {
                        learned.push(*jet);
                    } else {
                        self.others.push(at);
                        self.pull_back(target, norm(jet.force_n));
                    }
                }
                Found::Elsewhere(jet) => {
                    self.score(target, jet);
                    self.linear.rule_out();
                    self.others.push(at);
                }
                Found::Failed => {
                    self.linear.rule_out();
                    self.others.push(at);
                    self.pull_back(target, f64::INFINITY);
                }
            }
        }
        self.fits.retain_mut(|candidate| candidate.fit.add(&learned).is_ok());
        self.jets.extend(learned);
        for candidate in &mut self.fits {
            let missed = candidate.fit.left_out_n().zip(&self.jets).skip(1);
            candidate.left_out =
                missed.map(|(missed, jet)| norm(missed) / self.wanted.tolerance.at(jet.force_n)).collect();
        }
        let best = (0..self.fits.len())
            .min_by(|&a, &b| self.fits[a].mean_left_out().total_cmp(&self.fits[b].mean_left_out()));
        self.chosen = best.unwrap_or(0);
        self.deviation = self.asked_deviation();
    }

    fn score(&mut self, target: &Target, jet: &EnergyJet) {
        let tolerance_n = self.wanted.tolerance.at(jet.force_n);
        let within = norm(jet.force_n) <= TOO_FAR * self.wanted.max_force_n;
        let error_n = norm(difference(target.predicted_n, jet.force_n));
        self.tests.push(Test { index: target.index, error_n, tolerance_n, within });
        if within {
            self.linear.score(jet.control_m, jet.force_n, tolerance_n);
        }
    }

    /// Aims again where a straight line from the parent's force to `came_out_n` meets the limit.
    fn pull_back(&mut self, target: &Target, came_out_n: f64) {
        let parent = &self.jets[target.parent];
        let (low, limit) = (norm(parent.force_n), self.wanted.max_force_n);
        let share = ((limit - low) / (came_out_n - low)).clamp(0.2, 0.8);
        let at = std::array::from_fn(|i| {
            parent.control_m[i] + share * (target.displacement_m()[i] - parent.control_m[i])
        });
        self.pulled_back.push((at, target.parent));
    }
}

/// Predictions within tolerance since the last that was not, of those that count.
pub(super) fn passes(tests: &[Test]) -> usize {
    let counted = tests.iter().rev().filter(|test| test.within);
    counted.take_while(|test| test.error_n <= test.tolerance_n).count()
}

#[cfg(test)]
mod tests;
