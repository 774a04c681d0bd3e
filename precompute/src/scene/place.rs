//! Places in the text of a scene, and checks of the values there.

use std::ops::Range;
use std::path::PathBuf;

use toml::Spanned;

use super::three::Three;
use crate::error::{InputError, nearest_word};

/// A table with its place in the text.
pub(super) struct Located<'a, T> {
    pub(super) span: Range<usize>,
    pub(super) table: &'a T,
}

/// Path and text of the scene; converts a byte range to a file and a line.
#[derive(Debug)]
pub(super) struct Place {
    pub(super) path: PathBuf,
    pub(super) text: String,
}

impl Place {
    /// An error at a byte range of the text.
    pub(super) fn error(
        &self,
        span: Range<usize>,
        what: impl Into<String>,
        fix: impl Into<String>,
    ) -> InputError {
        InputError::at(&self.path, self.line(span.start), what, fix)
    }

    /// The line of a key in the table at `table`, for keys that are read without their places.
    pub(super) fn key_in(&self, table: Range<usize>, key: &str) -> Range<usize> {
        let mut lines = self.text[table.start..].split_inclusive('\n').scan(table.start, |start, line| {
            *start += line.len();
            Some((*start - line.len()..*start, line))
        });
        lines.find(|(_, line)| line.trim_start().starts_with(key)).map_or(table, |(span, _)| span)
    }

    fn line(&self, offset: usize) -> usize {
        1 + self.text.as_bytes().iter().take(offset).filter(|&&b| b == b'\n').count()
    }

    /// Resolves a path in the scene file relative to the folder of the scene.
    pub(super) fn relative(&self, file: &str) -> PathBuf {
        self.path.parent().map_or_else(|| PathBuf::from(file), |folder| folder.join(file))
    }

    /// The scene with sorted keys, without comments and layout, and with the force limit instead of a device
    /// profile.
    ///
    /// A store keeps this text. Its meaning must not depend on the profile, which can change or be missing.
    pub(super) fn canonical(&self, max_force_n: f64) -> String {
        let mut table: toml::Table = self.text.parse().expect("the text was parsed before");
        let device = table.get_mut("device").and_then(toml::Value::as_table_mut);
        if let Some(device) = device.filter(|device| device.contains_key("profile")) {
            *device = toml::Table::from_iter([("max_force_n".into(), max_force_n.into())]);
        }
        toml::to_string(&table).expect("a table that was parsed can be written")
    }

    /// The parser's error in this project's terms.
    pub(super) fn explain(&self, error: &toml::de::Error) -> InputError {
        let message = error.message();
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        let (what, fix) = if message.starts_with("unknown field") {
            let (key, allowed) = quoted.split_first().map_or(("", &[][..]), |(key, rest)| (*key, rest));
            let guess = match nearest_word(key, allowed.iter().copied()) {
                Some(guess) => format!("did you mean `{guess}`?"),
                None => "remove it".into(),
            };
            (format!("unknown key `{key}`"), format!("{guess} (allowed here: {})", allowed.join(", ")))
        } else if message.starts_with("unknown variant") {
            let (word, allowed) = quoted.split_first().map_or(("", &[][..]), |(word, rest)| (*word, rest));
            let allowed: Vec<String> = allowed.iter().map(|word| format!("\"{word}\"")).collect();
            (format!("unknown word \"{word}\""), format!("use {}", allowed.join(" or ")))
        } else if message.starts_with("missing field") {
            let key = quoted.first().copied().unwrap_or_default();
            let table = ["mesh", "material", "fixed", "active"].contains(&key);
            let written = match key {
                "active" => "[[active]]".into(),
                _ if table => format!("[{key}]"),
                _ => format!("`{key}`"),
            };
            (format!("{written} is missing"), format!("add {written}"))
        } else if let Some(what) = wrong_type(message) {
            (what, "correct the value".into())
        } else {
            (format!("not valid TOML ({message})"), "correct the syntax".into())
        };
        match error.span() {
            Some(span) => self.error(span, what, fix),
            None => InputError::at(&self.path, 1, what, fix),
        }
    }
}

/// serde's message of a value of the wrong type, in the words of a scene; `None` for other messages.
fn wrong_type(message: &str) -> Option<String> {
    // Only a word of a fixed list gets this message.
    if message.starts_with("wanted") {
        return Some("a text in quotes is expected here".into());
    }
    let (found, expected) = message.strip_prefix("invalid ")?.rsplit_once(", expected ")?;
    let expected = match expected {
        "f64" => "a number".into(),
        "i64" | "u64" | "u32" => "a whole number".into(),
        "a boolean" => "true or false".into(),
        "a string" => "a text in quotes".into(),
        "a sequence" => "a list".into(),
        "a map" => "a table".into(),
        _ if expected.starts_with("struct ") => "a table".into(),
        _ => match expected.strip_prefix("an array of length ") {
            Some(length) => format!("a list of {length}"),
            None => expected.to_owned(),
        },
    };
    let found = if let Some(length) = found.strip_prefix("length ") {
        format!("a list of {length}")
    } else {
        let value = found.strip_prefix("type: ").or_else(|| found.strip_prefix("value: "))?;
        match value.split_once('`').map(|(kind, rest)| (kind.trim_end(), rest.trim_end_matches('`'))) {
            Some(("integer" | "floating point", number)) => format!("the number {number}"),
            Some(("boolean", word)) => word.to_owned(),
            _ if value.starts_with("string ") => format!("the {value}"),
            _ if value == "sequence" => "a list".into(),
            _ if value == "map" => "a table".into(),
            _ => value.to_owned(),
        }
    };
    Some(format!("{expected} is expected here, not {found}"))
}

pub(super) fn check_name(
    place: &Place,
    span: Range<usize>,
    name: &str,
    limit: usize,
) -> Result<(), InputError> {
    let fault = if name.is_empty() {
        "is empty".to_owned()
    } else if name.len() > limit {
        format!("is {} bytes long", name.len())
    } else if name.contains(|c: char| c.is_control() || c == ',' || c == '"') {
        "holds a comma, a quote or a control character".to_owned()
    } else {
        return Ok(());
    };
    let what = format!("the name \"{}\" {fault}", name.escape_debug());
    Err(place.error(span, what, format!("use 1 to {limit} bytes without commas and quotes")))
}

pub(super) fn positive(place: &Place, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
    let number = *value.get_ref();
    if number.is_finite() && number > 0.0 {
        return Ok(number);
    }
    Err(place.error(
        value.span(),
        format!("`{key}` = {number} is not a positive number"),
        "correct the value",
    ))
}

pub(super) fn finite(place: &Place, key: &str, value: &Spanned<Three>) -> Result<[f64; 3], InputError> {
    let point = value.get_ref().0;
    if point.iter().all(|c| c.is_finite()) {
        return Ok(point);
    }
    Err(place.error(value.span(), format!("`{key}` = {point:?} is not finite"), "correct the value"))
}
