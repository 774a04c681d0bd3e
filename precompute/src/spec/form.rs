//! In which form the energy of a space goes into the blob.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// How the energy of a space goes into the blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Form {
    /// The first of the others, in their order, whose blob fits the limit.
    #[default]
    Auto,
    /// The table of `energy`: 27 derivatives of W at every node of a lattice, eight nodes combined in the tick.
    Node,
    /// The fit itself: 23 numbers a configuration, all of them summed in the tick. Scattered positions only.
    Kernel,
}

impl Form {
    /// Every form, as scenes write them.
    pub const NAMES: [(&'static str, Self); 3] =
        [("auto", Self::Auto), ("node", Self::Node), ("kernel", Self::Kernel)];

    /// The word in a scene.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, form)| *form == self).map_or("auto", |(name, _)| *name)
    }
}

impl FromStr for Form {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::NAMES.iter().find(|(name, _)| *name == text).map(|(_, form)| *form).ok_or(())
    }
}

/// What a scene needs of the form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FormNeeds {
    /// Which one.
    pub form: Form,
    /// Largest blob, its certificate not counted, bytes.
    pub most_bytes: Option<u64>,
}
