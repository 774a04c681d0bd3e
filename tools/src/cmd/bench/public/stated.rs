//! `system.toml`: what a system says about itself, and the figures that it states.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use crate::failure::Failure;

/// Name of the file.
pub(super) const SYSTEM: &str = "system.toml";

/// Figures that a system states: by table and row.
pub(super) type Stated = BTreeMap<String, BTreeMap<String, f64>>;

/// The content of `system.toml`.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct System {
    /// Program, version and machine, for the page.
    pub(super) about: String,
    /// What it states.
    pub(super) figures: Stated,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    about: String,
    #[serde(default)]
    figures: toml::Table,
}

/// How a figure is given.
const EXAMPLE: &str = "as in [figures.\"cost.point\"] and query_ns = 250";

impl System {
    /// Reads the file; a missing one states nothing.
    pub(super) fn read(path: &Path) -> Result<Self, Failure> {
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = std::fs::read_to_string(path).map_err(|error| Failure::file(path, &error))?;
        Self::parse(&text).map_err(|what| Failure::input(format!("{}: {what}", path.display())))
    }

    /// Parses the file. Names with dots mean the same with quotes and without.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let File { about, figures } = toml::from_str(text)
            .map_err(|error| format!("{}; give `about` and figures, {EXAMPLE}", error.message()))?;
        let mut numbers = Vec::new();
        flatten(&figures, "", &mut numbers)?;
        let mut stated = Stated::new();
        for (path, value) in numbers {
            let second = path.match_indices('.').nth(1).map(|(at, _)| at);
            let Some((table, row)) = second.map(|at| (&path[..at], &path[at + 1..])) else {
                return Err(format!("figures.{path}: name a table and a row, {EXAMPLE}"));
            };
            if let Some(why) = impossible(row, value) {
                return Err(format!("{row} = {value} of the table {table} {why}; correct it or remove it"));
            }
            if stated.entry(table.into()).or_default().insert(row.into(), value).is_some() {
                return Err(format!("{row} of the table {table} is given twice; remove one"));
            }
        }
        Ok(Self { about, figures: stated })
    }
}

/// The numbers of nested tables with their paths.
fn flatten(table: &toml::Table, above: &str, to: &mut Vec<(String, f64)>) -> Result<(), String> {
    for (key, value) in table {
        let path = if above.is_empty() { key.clone() } else { format!("{above}.{key}") };
        match value {
            toml::Value::Table(inner) => flatten(inner, &path, to)?,
            toml::Value::Integer(number) => to.push((path, *number as f64)),
            toml::Value::Float(number) => to.push((path, *number)),
            other => return Err(format!("figures.{path} is a {}; give a number", other.type_str())),
        }
    }
    Ok(())
}

/// Why no system can have this figure. Every figure is a time, a size, a count, a stiffness, a depth, a force or a
/// share. A table may need no solves, but a query, a tick and a start take some time.
fn impossible(row: &str, value: f64) -> Option<&'static str> {
    let is_time = row != "solve_s" && ["_ns", "_us", "_s"].iter().any(|unit| row.ends_with(unit));
    match value {
        _ if !value.is_finite() => Some("is not finite"),
        _ if value < 0.0 => Some("is negative"),
        _ if is_time && value == 0.0 => Some("takes no time"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_dots_need_no_quotes() {
        let quoted =
            "[figures.\"cost.point\"]\nbytes = 7\n[figures.\"nodule.nodules\"]\n\"deep.depth_mm\" = 2.5";
        let plain = "[figures.cost.point]\nbytes = 7\n[figures.\"nodule.nodules\"]\ndeep.depth_mm = 2.5";
        let parsed = System::parse(quoted).expect("figures");
        assert_eq!(parsed.figures["cost.point"]["bytes"], 7.0);
        assert_eq!(parsed.figures["nodule.nodules"]["deep.depth_mm"], 2.5);
        assert_eq!(System::parse(plain), Ok(parsed));
    }

    #[test]
    fn what_no_system_can_have_is_refused() {
        for (text, words) in [
            ("[figures.\"cost.point\"]\nbytes = -5", "bytes = -5 of the table cost.point is negative"),
            ("[figures.\"cost.point\"]\nquery_ns = 0", "query_ns = 0 of the table cost.point takes no time"),
            ("[figures.\"tick.point\"]\nmax_us = 0.0", "max_us = 0 of the table tick.point takes no time"),
            ("[figures.\"start.first_touch\"]\nsmall_s = 0", "takes no time"),
            ("[figures.\"cost.point\"]\nbytes = nan", "is not finite"),
            ("[figures.\"cost.point\"]\nbytes = inf", "is not finite"),
            (
                "[figures.\"cost.point\"]\nbytes = \"7\"",
                "figures.cost.point.bytes is a string; give a number",
            ),
            ("[figures]\nbytes = 7", "figures.bytes: name a table and a row"),
            ("[figures.cost.point]\nbytes = 7\n[figures.\"cost.point\"]\nbytes = 7", "is given twice"),
            ("figure = 1", "[figures.\"cost.point\"]"),
        ] {
            let line = System::parse(text).expect_err(text);
            assert!(line.contains(words), "{line}");
        }
        let without = "[figures.\"cost.point\"]\nsolves = 0\nsolve_s = 0\nbytes = 0";
        assert!(System::parse(without).is_ok(), "a system without a table");
    }
}
