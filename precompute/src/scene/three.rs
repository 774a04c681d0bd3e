//! Lists of three numbers in a scene.

use crate::fem::material::Value;

/// A list of three numbers. As an array, serde would accept a longer one and leave out the rest.
#[derive(Debug, Clone, Copy, serde::Deserialize)]
#[serde(try_from = "Vec<f64>")]
pub(super) struct Three(pub(super) [f64; 3]);

impl From<Three> for Value {
    fn from(three: Three) -> Self {
        three.0.into()
    }
}

impl TryFrom<Vec<f64>> for Three {
    type Error = String;

    fn try_from(all: Vec<f64>) -> Result<Self, String> {
        // In the words of serde, which `Place::explain` knows.
        let wrong = |all: Vec<f64>| format!("invalid length {}, expected an array of length 3", all.len());
        all.try_into().map(Self).map_err(wrong)
    }
}
