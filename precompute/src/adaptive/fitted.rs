//! The fit of an adaptive search, with all that is asked of it once the search has ended.

use super::LinearSuits;
use super::reach::Known;
use super::search::{Test, Verdict, passes};
use crate::fit::KernelFit;
use crate::num::jet::EnergyJet;
use crate::num::vector::norm;
use crate::spec::{Wanted, Workspace, is_within};

/// Where the fit predicts a force beyond this many times the limit, the force is beyond the limit.
const REACH_MARGIN: f64 = 1.3;

/// The fit of a search and what is known of it. It takes in no further configuration.
#[derive(Debug, Clone)]
pub struct AdaptiveFit {
    /// What was wanted.
    pub wanted: Wanted,
    /// How the search ended; none while it goes on.
    pub verdict: Option<Verdict>,
    /// The configurations in the fit, rest first.
    pub jets: Vec<EnergyJet>,
    /// The fit.
    pub fit: KernelFit,
    /// All predictions, in the order they were made.
    pub tests: Vec<Test>,
    /// Error of each configuration but rest, predicted from all the others, as a share of the tolerance.
    pub left_out: Vec<f64>,
    /// The largest deviation of the fit's force as a share of the tolerance; none where the search did not need it.
    pub deviation: Option<f64>,
    /// How well the linear body predicts.
    pub linear: LinearSuits,
    /// A lower bound of the condition number of the fit's matrix.
    pub condition: f64,
}

impl AdaptiveFit {
    /// Predictions within tolerance since the last that was not, of those that count.
    pub fn passes(&self) -> usize {
        passes(&self.tests)
    }

    /// How well the fit of all the others predicts each configuration.
    pub fn left_out(&self) -> LeftOut {
        LeftOut::of(&self.left_out)
    }

    /// Whether the fit holds at a displacement, m: it is within the kernel's length of a configuration, and the
    /// force there is not far beyond the limit.
    pub fn knows(&self, at: [f64; 3]) -> bool {
        self.known().is_near(at) && norm(self.fit.force_n(at)) <= REACH_MARGIN * self.wanted.max_force_n
    }

    /// About `count` displacements spread over what is within reach, m.
    pub fn places(&self, count: u32) -> Vec<[f64; 3]> {
        self.known().places(count)
    }

    /// Where the tool can be.
    pub fn within_reach(&self) -> WithinReach {
        let Wanted { max_force_n, push, workspace_m, .. } = self.wanted;
        WithinReach { fit: self.fit.clone(), limit_n: REACH_MARGIN * max_force_n, push, workspace_m }
    }

    fn known(&self) -> Known<'_> {
        Known { wanted: &self.wanted, fit: &self.fit, jets: &self.jets }
    }
}

/// Every configuration but rest, predicted by the fit of all the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOut {
    /// How many.
    pub configurations: usize,
    /// Of these, beyond the tolerance.
    pub beyond: usize,
    /// The largest of the errors, as a share of the tolerance.
    pub worst: f64,
}

impl LeftOut {
    /// Of errors as shares of the tolerance.
    pub(super) fn of(shares: &[f64]) -> Self {
        Self {
            configurations: shares.len(),
            beyond: shares.iter().filter(|share| share.is_nan() || **share > 1.0).count(),
            worst: shares.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// Where the tool can be: in the workspace, with a force not far beyond the limit, and pressing if it only pushes.
#[derive(Debug, Clone)]
pub struct WithinReach {
    fit: KernelFit,
    limit_n: f64,
    push: Option<[f64; 3]>,
    workspace_m: Option<Workspace>,
}

impl WithinReach {
    /// Whether the tool can be at this displacement, m.
    pub fn has(&self, at: [f64; 3]) -> bool {
        if !self.workspace_m.is_none_or(|workspace| is_within(&workspace, &at)) {
            return false;
        }
        let force = self.fit.force_n(at);
        let along = |normal: [f64; 3]| force.iter().zip(normal).map(|(h, n)| h * n).sum::<f64>();
        norm(force) <= self.limit_n && self.push.is_none_or(|n| along(n) <= 0.0)
    }
}
