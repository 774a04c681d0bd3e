//! State of one configuration while the space is being built, named as in section 5.1 of the paper.

use serde::{Deserialize, Serialize};

use crate::named::named;

named! {
    /// State of the configuration at one grid point.
    #[derive(Serialize, Deserialize)]
    pub enum ConfigTag {
        /// Not solved yet.
        Unknown = "unknown",
        /// Solved; its neighbours may be solved from it.
        Expandable = "expandable",
        /// Solved, but the reaction exceeds the force of the device: the expansion stops here.
        Terminating = "terminating",
        /// Newton's method did not converge from its parent. This is expected physics, not an error.
        Failed = "failed",
    }
}

impl ConfigTag {
    /// Whether the configuration has a converged solution.
    pub const fn is_solved(self) -> bool {
        matches!(self, Self::Expandable | Self::Terminating)
    }
}
