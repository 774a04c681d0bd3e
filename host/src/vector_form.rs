//! How serde writes a vector. JSON has no NaN and no infinity: a vector with such a component also stores its bits.

use palpate_core::{Vec3, vec3};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Vector {
    #[serde(skip_serializing_if = "Option::is_none")]
    x: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    y: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    z: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bits: Option<[u32; 3]>,
}

pub(crate) fn serialize<S: Serializer>(vector: &Vec3, to: S) -> Result<S::Ok, S::Error> {
    let [x, y, z] = vector.map(|component| Some(component).filter(|c| c.is_finite()));
    let bits = (!vec3::is_finite(*vector)).then(|| vector.map(f32::to_bits));
    Vector { x, y, z, bits }.serialize(to)
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec3, D::Error> {
    match Vector::deserialize(from)? {
        Vector { bits: Some(bits), .. } => Ok(bits.map(f32::from_bits)),
        Vector { x: Some(x), y: Some(y), z: Some(z), .. } => Ok([x, y, z]),
        _ => Err(D::Error::custom("a vector without three components")),
    }
}
