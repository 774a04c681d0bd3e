//! State of a space: open attempts, points by tag, and its fit.

use super::fallback::FallbackLattice;
use super::task::TagCounts;
use crate::adaptive::{AdaptiveFit, Verdict};

/// State of the space of an active node. The store keeps it once nothing is open.
#[derive(Debug, Clone)]
pub struct SpaceState {
    /// Attempts that are certainly still required; 0 once the space is finished.
    pub open: usize,
    /// Points by tag, without the rest point.
    pub counts: TagCounts,
    /// The fit of adaptive sampling; `None` on a lattice and before rest is solved.
    pub fit: Option<AdaptiveFit>,
}

impl SpaceState {
    /// The fallback lattice, if the search stagnated.
    pub fn fallback(&self) -> Option<FallbackLattice> {
        let fit = self.fit.as_ref().filter(|fit| fit.verdict == Some(Verdict::Stagnated))?;
        FallbackLattice::within(fit.wanted.radius_m)
    }
}
