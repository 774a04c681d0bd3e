//! How serde writes the entries of the metadata: every value as text.

/// A value by its text. A float is written with enough digits to restore its bits.
pub(super) mod text {
    use core::fmt::Display;
    use core::str::FromStr;
    use serde::de::{Error, Unexpected};
    use serde::{Deserialize, Deserializer, Serializer};

    pub(in super::super) fn serialize<S: Serializer>(value: &impl Display, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(value)
    }

    pub(in super::super) fn deserialize<'de, T: FromStr, D: Deserializer<'de>>(
        from: D,
    ) -> Result<T, D::Error> {
        let text = String::deserialize(from)?;
        let expected = core::any::type_name::<T>();
        text.parse().map_err(|_| D::Error::invalid_value(Unexpected::Str(&text), &expected))
    }
}

/// Names joined by commas. No name of an active node contains a comma: a scene with such a name is refused.
pub(super) mod list {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(in super::super) fn serialize<S: Serializer>(names: &[String], to: S) -> Result<S::Ok, S::Error> {
        names.join(",").serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<String>, D::Error> {
        let joined = String::deserialize(from)?;
        Ok(joined.split(',').filter(|name| !name.is_empty()).map(Into::into).collect())
    }
}

/// Three components, joined by commas.
pub(super) mod vector {
    use palpate_core::Vec3;
    use serde::de::{Error, Unexpected};
    use serde::{Deserialize, Deserializer, Serializer};

    pub(in super::super) fn serialize<S: Serializer>([x, y, z]: &Vec3, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(&format_args!("{x},{y},{z}"))
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec3, D::Error> {
        let text = String::deserialize(from)?;
        let numbers: Option<Vec<f32>> = text.split(',').map(|number| number.parse().ok()).collect();
        numbers
            .and_then(|numbers| numbers.try_into().ok())
            .ok_or_else(|| D::Error::invalid_value(Unexpected::Str(&text), &"three numbers"))
    }
}

/// A method by its name, or `jets` where the jets of a live solver gave the force.
pub(super) mod method {
    use palpate_core::Method;
    use serde::de::{Error, Unexpected};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    const JETS: &str = "jets";

    pub(in super::super) fn serialize<S: Serializer>(
        method: &Option<Method>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        method.map_or(JETS, Method::name).serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Method>, D::Error> {
        let name = String::deserialize(from)?;
        if name == JETS {
            return Ok(None);
        }
        let known = Method::from_name(&name);
        known.map(Some).ok_or_else(|| D::Error::invalid_value(Unexpected::Str(&name), &"a method"))
    }
}
