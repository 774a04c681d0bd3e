//! State of one configuration while the space is being built, named as in section 5.1 of the paper.

use serde::{Deserialize, Serialize};

/// What is known of one grid point's configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ConfigTag {
    /// Not solved yet.
    Unknown,
    /// Solved, and its neighbours may be reached from it.
    Expandable,
    /// Solved, but the reaction is beyond the device's force: the expansion stops here.
    Terminating,
    /// Newton did not converge from its parent. Expected physics, not an error.
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

    /// Reads back [`ConfigTag::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|tag| tag.name() == name)
    }

    /// Whether a converged solution stands behind this tag.
    pub const fn is_solved(self) -> bool {
        matches!(self, Self::Expandable | Self::Terminating)
    }
}
