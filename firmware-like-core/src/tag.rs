//! State of one configuration while the space is being built, named as in section 5.1 of the paper.

use serde::{Deserialize, Serialize};

/// State of the configuration at one grid point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ConfigTag {
    /// Not solved yet.
    Unknown,
    /// Solved; its neighbours may be solved from it.
    Expandable,
    /// Solved, but the reaction exceeds the force of the device: the expansion stops here.
    Terminating,
    /// Newton's method did not converge from its parent. This is expected physics, not an error.
    Failed,
}

impl ConfigTag {
    /// Every tag, in the order of the states.
    pub const ALL: [Self; 4] = [Self::Unknown, Self::Expandable, Self::Terminating, Self::Failed];

    /// The name used in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Expandable => "expandable",
            Self::Terminating => "terminating",
            Self::Failed => "failed",
        }
    }

    /// The tag with this [`ConfigTag::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|tag| tag.name() == name)
    }

    /// Whether the configuration has a converged solution.
    pub const fn is_solved(self) -> bool {
        matches!(self, Self::Expandable | Self::Terminating)
    }
}
