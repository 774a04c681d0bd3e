//! How far a space is: what is open, how many points have which tag, and its fit.

use super::fallback::FallbackLattice;
use super::task::TagCounts;
use crate::adaptive::{AdaptiveFit, Verdict};

/// How far the space of an active node is. The store keeps it once nothing is open.
#[derive(Debug, Clone)]
pub struct SpaceState {
    /// Attempts that are certain to be needed still; none once the space is finished.
    pub open: usize,
    /// Points by tag, the rest point not counted.
    pub counts: TagCounts,
    /// The fit of adaptive sampling; none on a lattice, or before rest is solved.
    pub fit: Option<AdaptiveFit>,
}

impl SpaceState {
    /// The lattice that took over where the search stalled.
    pub fn fallback(&self) -> Option<FallbackLattice> {
        let fit = self.fit.as_ref().filter(|fit| fit.verdict == Some(Verdict::Stalled))?;
        FallbackLattice::within(fit.wanted.radius_m)
    }
}
