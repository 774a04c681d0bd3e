//! The datum of a radial basis function.

use super::Sample;

/// A position and the force there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centre {
    /// Position in cells.
    pub position: [f64; 3],
    /// h, N.
    pub force_n: [f64; 3],
}

impl From<&Sample> for Centre {
    fn from(sample: &Sample) -> Self {
        Self { position: sample.index.map(f64::from), force_n: sample.jet.force_n }
    }
}
