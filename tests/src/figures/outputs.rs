//! Numbers in what a command writes: JSON, CSV and text.

use std::fs;
use std::path::Path;

use serde_json::{Map, Value};

use super::{Missing, places};

fn text(path: &Path) -> Result<String, Missing> {
    fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn read(path: &Path) -> Result<Value, Missing> {
    let text = text(path)?;
    if path.extension().is_some_and(|of| of == "json") {
        return serde_json::from_str(&text).map_err(|error| format!("{}: {error}", path.display()));
    }
    let mut lines = text.lines().map(|line| line.split(','));
    let header: Vec<&str> = lines.next().into_iter().flatten().collect();
    let row = |line: std::str::Split<'_, char>| {
        let cells = header.iter().zip(line).map(|(key, cell)| ((*key).to_owned(), Value::from(cell)));
        Value::from(cells.collect::<Map<_, _>>())
    };
    Ok(lines.map(row).collect::<Vec<_>>().into())
}

/// The number at a path of a file, or of the one that it names: `other.json > cases/0`.
pub(super) fn value(folder: &Path, file: &str, path: &str) -> Result<f64, Missing> {
    let (file, path) = path.split_once(" > ").unwrap_or((file, path));
    at(&read(&folder.join(file))?, path)
}

/// The number at a path, for example `cases/name=demo&law=stvk/error_n/0`; `#` counts; `a : b` is a quotient.
fn at(content: &Value, path: &str) -> Result<f64, Missing> {
    if let Some((left, right)) = path.split_once(" : ") {
        return Ok(at(content, left)? / at(content, right)?);
    }
    let missing = |part: &str| format!("no `{part}` of `{path}`");
    let mut found = content;
    for part in path.split('/') {
        if part == "#" {
            return found.as_array().map(|all| all.len() as f64).ok_or_else(|| missing(part));
        }
        found = match found {
            Value::Array(all) if part.contains('=') => {
                let mut those = all.iter().filter(|item| part.split('&').all(|pair| has(item, pair)));
                let first = those.next().ok_or_else(|| missing(part))?;
                if those.next().is_some() { Err(format!("several `{part}` of `{path}`")) } else { Ok(first) }
            }
            Value::Array(all) => {
                part.parse::<usize>().ok().and_then(|k| all.get(k)).ok_or_else(|| missing(part))
            }
            _ => found.get(part).ok_or_else(|| missing(part)),
        }?;
    }
    let parsed = found.as_f64().or_else(|| found.as_str().and_then(|text| text.parse().ok()));
    parsed.ok_or_else(|| format!("no number at `{path}`"))
}

fn has(item: &Value, pair: &str) -> bool {
    let Some((key, wanted)) = pair.split_once('=') else { return false };
    match item.get(key) {
        Some(Value::String(text)) => text == wanted,
        Some(other) => {
            let shown = other.to_string();
            shown == wanted || other.as_f64().is_some_and(|value| wanted.parse() == Ok(value))
        }
        None => false,
    }
}

/// The numbers of a text; see [`places::find`].
pub(super) fn find(path: &Path, words: &str) -> Result<Vec<f64>, Missing> {
    Ok(places::find(&text(path)?, words)?.into_iter().map(|number| number.value).collect())
}
