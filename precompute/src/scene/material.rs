//! A `[material]` table and its law.

use std::fmt;
use std::sync::LazyLock;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, Visitor};
use toml::Spanned;

use super::place::{Located, Place};
use super::three::Three;
use crate::error::{InputError, nearest_word};
use crate::fem::material::{Key, LAWS, Material, Value};

/// A `[material]` table. The list of laws defines its parameters.
#[derive(Debug)]
pub(super) struct MaterialTable {
    pub(super) law: Spanned<String>,
    pub(super) group: Option<Spanned<String>>,
    /// Bulk modulus of a law with a pressure: nearly incompressible instead of exactly incompressible.
    pub(super) bulk_pa: Option<Spanned<f64>>,
    /// Parameters of the law, in the order of the file.
    pub(super) parameters: Vec<(&'static str, Spanned<Value>)>,
}

/// The keys of the table that do not belong to a law.
const OWN_KEYS: [&str; 3] = ["law", "group", "bulk_pa"];
static LAW_KEYS: LazyLock<Vec<Key>> = LazyLock::new(Material::keys);
static ALL_KEYS: LazyLock<Vec<&str>> =
    LazyLock::new(|| OWN_KEYS.into_iter().chain(LAW_KEYS.iter().map(|key| key.name())).collect());

/// A key of the table.
enum TableKey {
    Own(&'static str),
    Law(Key),
}

impl<'de> Deserialize<'de> for TableKey {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Word;
        impl Visitor<'_> for Word {
            type Value = TableKey;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a key")
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<TableKey, E> {
                let own = OWN_KEYS.into_iter().find(|key| *key == word).map(TableKey::Own);
                let of_law = || LAW_KEYS.iter().find(|key| key.name() == word).copied().map(TableKey::Law);
                own.or_else(of_law).ok_or_else(|| E::unknown_field(word, &ALL_KEYS))
            }
        }
        deserializer.deserialize_identifier(Word)
    }
}

/// Implemented by hand because the keys are those of the list of laws, and because serde's `flatten` buffers
/// values, which loses their places in the text.
impl<'de> Deserialize<'de> for MaterialTable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Table;
        impl<'de> Visitor<'de> for Table {
            type Value = MaterialTable;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a table of a material")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<MaterialTable, A::Error> {
                let (mut law, mut group, mut bulk_pa, mut parameters) = (None, None, None, Vec::new());
                while let Some(key) = map.next_key()? {
                    match key {
                        TableKey::Own("law") => law = Some(map.next_value()?),
                        TableKey::Own("group") => group = Some(map.next_value()?),
                        TableKey::Own(_) => bulk_pa = Some(map.next_value()?),
                        TableKey::Law(Key::Number(name)) => {
                            parameters.push((name, placed(map.next_value::<Spanned<f64>>()?)));
                        }
                        TableKey::Law(Key::Vector(name)) => {
                            parameters.push((name, placed(map.next_value::<Spanned<Three>>()?)));
                        }
                    }
                }
                let law = law.ok_or_else(|| A::Error::missing_field("law"))?;
                Ok(MaterialTable { law, group, bulk_pa, parameters })
            }
        }
        deserializer.deserialize_map(Table)
    }
}

fn placed<T: Into<Value>>(value: Spanned<T>) -> Spanned<Value> {
    let span = value.span();
    Spanned::new(span, value.into_inner().into())
}

/// The law of a table and its bulk modulus; adds warnings about unusual but solvable parameters to
/// `warnings`.
pub(super) fn law(
    place: &Place,
    material: &Located<'_, MaterialTable>,
    warnings: &mut Vec<String>,
) -> Result<(Material, Option<f64>), InputError> {
    let MaterialTable { law, bulk_pa, parameters, .. } = material.table;
    let name = law.get_ref().as_str();
    if !LAWS.contains(&name) {
        let fix = match nearest_word(name, LAWS.iter().copied()) {
            Some(guess) => format!("did you mean \"{guess}\"? (laws: {})", LAWS.join(", ")),
            None => format!("choose one of {}", LAWS.join(", ")),
        };
        return Err(place.error(law.span(), format!("unknown law \"{name}\""), fix));
    }
    let given: Vec<(&str, Value)> = parameters.iter().map(|(key, value)| (*key, *value.get_ref())).collect();
    let material = Material::from_parameters(name, &given).map_err(|error| {
        let at = parameters.iter().find(|(key, _)| error.key.as_deref() == Some(key));
        place.error(at.map_or(law.span(), |(_, value)| value.span()), error.what, error.fix)
    })?;
    warnings.extend(material.warnings());
    let bulk_modulus_pa = bulk_pa.as_ref().map(|value| bulk(place, &material, value)).transpose()?;
    Ok((material, bulk_modulus_pa))
}

/// The bulk modulus; only laws with a pressure accept it.
fn bulk(place: &Place, law: &Material, value: &Spanned<f64>) -> Result<f64, InputError> {
    if law.rest_pressure_pa().is_none() {
        let what = format!("`bulk_pa` does not belong to the law \"{}\", which has no pressure", law.name());
        return Err(place.error(
            value.span(),
            what,
            "remove it: `poisson` or `lambda_pa` defines the bulk modulus",
        ));
    }
    let bulk = *value.get_ref();
    if !(bulk.is_finite() && bulk > 0.0) {
        let fix = "give the bulk modulus in pascals, or leave it out for exact incompressibility";
        return Err(place.error(value.span(), format!("`bulk_pa` = {bulk} must be a positive number"), fix));
    }
    Ok(bulk)
}
