//! The fit of an adaptive search, and the queries of it after the search.

use super::linear::LinearModelErrors;
use super::prediction::{Test, Verdict};
use crate::fit::{KernelFit, KernelSystem};
use crate::num::jet::EnergyJet;
use crate::num::vector::{distance, norm};
use crate::spec::{GridIndex, MIN_RADIUS_M, Requirements, is_within};
use serde::{Deserialize, Serialize};

/// A force predicted above this multiple of the limit counts as beyond the limit.
const LIMIT_FACTOR: f64 = 1.3;

/// Most configurations of the one fit of a complete chart, and most that its search begins with.
pub(crate) const MOST_DATA: usize = 80;

/// A configuration that another chart has solved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Shared {
    /// Number of the active node of that chart.
    pub chart: u32,
    /// Its index there.
    pub index: GridIndex,
    /// Its jet, as a displacement from the origin of this chart.
    pub jet: EnergyJet,
}

/// The fit of a search with its error estimates. It is read-only.
#[derive(Debug, Clone)]
pub struct AdaptiveFit {
    /// Requirements of the search.
    pub wanted: Requirements,
    /// Result of the search; `None` during the search.
    pub verdict: Option<Verdict>,
    /// The configurations in the fit: rest first, then those of neighbouring charts.
    pub jets: Vec<EnergyJet>,
    /// Those of neighbouring charts.
    pub shared: Vec<Shared>,
    /// The fit.
    pub fit: KernelFit,
    /// All predictions, in order of time.
    pub tests: Vec<Test>,
    /// Leave-one-out error of each configuration except rest, as a share of the tolerance.
    pub leave_one_out: Vec<f64>,
    /// Largest standard deviation of the fit's force, as a share of the tolerance; `None` if the search did
    /// not need it.
    pub deviation: Option<f64>,
    /// Prediction errors of the linear model.
    pub linear: LinearModelErrors,
    /// Lower bound of the condition number of the fit's matrix.
    pub condition: f64,
}

impl AdaptiveFit {
    /// The configurations that this search has solved.
    pub(crate) fn own(&self) -> impl Iterator<Item = &EnergyJet> {
        self.jets.iter().take(1).chain(self.jets.iter().skip(1 + self.shared.len()))
    }

    /// The search with these own configurations, the origin first, and shared ones. Its fit, which then only tells what is
    /// reachable, is to those nearest to the origin; unchanged if some are too close.
    pub(crate) fn with_shared(&self, own: &[EnergyJet], shared: Vec<Shared>) -> Self {
        let of_others: Vec<EnergyJet> = shared.iter().map(|shared| shared.jet).collect();
        let jets = [&own[..1], &of_others, &own[1..]].concat();
        let mut by_distance: Vec<usize> = (0..jets.len()).collect();
        by_distance.sort_by(|&a, &b| norm(jets[a].control_m).total_cmp(&norm(jets[b].control_m)));
        by_distance.truncate(MOST_DATA);
        let in_fit: Vec<EnergyJet> = by_distance.iter().map(|&at| jets[at]).collect();
        let mut system = KernelSystem::without_errors(self.fit.length_m, self.fit.quantity, self.fit.base);
        if system.add(&in_fit).is_err() {
            return self.clone();
        }
        let condition = system.condition();
        let mut fit = KernelFit {
            centres: jets.iter().map(|jet| jet.control_m.map(|x| x / self.fit.length_m)).collect(),
            weights: vec![[0.0; 20]; jets.len()],
            ..system.fit.clone()
        };
        for (&at, weights) in by_distance.iter().zip(&system.fit.weights) {
            fit.weights[at] = *weights;
        }
        Self { jets, shared, fit, condition, ..self.clone() }
    }

    /// Length of the validation streak: predictions within tolerance since the last failure, among those that
    /// count.
    pub fn passes(&self) -> usize {
        let counted = self.tests.iter().rev().filter(|test| test.counts);
        counted.take_while(|test| test.error_n <= test.tolerance_n).count()
    }

    /// Summary of the leave-one-out errors.
    pub fn leave_one_out(&self) -> LeaveOneOutErrors {
        LeaveOneOutErrors::of(&self.leave_one_out)
    }

    /// Whether the fit is valid at a displacement, m: it lies within the kernel length of a configuration,
    /// and the predicted force is not far beyond the limit.
    pub(crate) fn is_valid_at(&self, at: [f64; 3]) -> bool {
        let is_near = |jet: &EnergyJet| distance(at, jet.control_m) <= self.fit.length_m;
        self.jets.iter().any(is_near) && norm(self.fit.force_n(at)) <= LIMIT_FACTOR * self.wanted.max_force_n
    }

    /// Whether a displacement, m, is in the reachable set: in the workspace, with a force not far beyond the
    /// limit, and without pull if the tool only pushes.
    pub(crate) fn is_reachable(&self, at: [f64; 3]) -> bool {
        let Requirements { max_force_n, push, workspace_m, .. } = self.wanted;
        if !workspace_m.is_none_or(|workspace| is_within(&workspace, &at)) || !self.wanted.is_in_column(at) {
            return false;
        }
        let force = self.predicted_n(at);
        norm(force) <= LIMIT_FACTOR * max_force_n
            && push.is_none_or(|normal| self.wanted.pushes(force, normal))
    }

    /// Displacement of the node by the largest force in its softest direction, from the stiffness at rest, m;
    /// infinite if the stiffness is not positive definite.
    pub(super) fn displacement_in_softest_direction_m(&self) -> f64 {
        let Some(rest) = self.jets.first() else { return f64::INFINITY };
        let softest_n_m = rest.stiffness_n_m.symmetric_eigenvalues().min();
        if softest_n_m > 0.0 { self.wanted.max_force_n / softest_n_m } else { f64::INFINITY }
    }

    /// The reason why the node is too stiff to be solved, and the fix, as text.
    #[must_use]
    pub fn too_stiff_in_words(&self) -> String {
        format!(
            "{} N move the node by {:.2} um at most, and a space needs {:.0} um; check the units of the material and of the \
             mesh, or raise `max_force_n`",
            self.wanted.max_force_n,
            1e6 * self.displacement_in_softest_direction_m(),
            1e6 * MIN_RADIUS_M
        )
    }
}

/// Leave-one-out errors: every configuration except rest, predicted by the fit to all others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeaveOneOutErrors {
    /// Number of configurations.
    pub configurations: usize,
    /// Number of errors beyond the tolerance.
    pub beyond: usize,
    /// The largest error, as a share of the tolerance.
    pub worst: f64,
}

impl LeaveOneOutErrors {
    /// Summary of errors given as shares of the tolerance.
    fn of(shares: &[f64]) -> Self {
        Self {
            configurations: shares.len(),
            beyond: shares.iter().filter(|share| share.is_nan() || **share > 1.0).count(),
            worst: shares.iter().copied().fold(0.0, f64::max),
        }
    }
}
