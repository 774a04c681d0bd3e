//! Writes each table as CSV and as JSON, with the same columns.

use serde::Serialize;

use super::measure::Measured;
use super::results::Report;
use crate::failure::Failure;
use crate::files::Folder;
use crate::output;

/// Results of a method along one regular path.
#[derive(Serialize)]
struct AlongRow<'r> {
    scene: &'r str,
    grid: u32,
    /// Number of the regular direction.
    direction: u32,
    distance_m: f64,
    /// |h| by finite elements.
    truth_n: f64,
    method: &'static str,
    force_n: f64,
    error_n: f64,
}

/// Writes all tables into a folder.
pub(super) fn write(report: &Report, out: &Folder) -> Result<(), Failure> {
    let all = || report.cases.iter().flatten();
    both(out, "methods", &all().flat_map(|case| &case.methods).collect::<Vec<_>>())?;
    both(out, "spaces", &all().map(|case| &case.space).collect::<Vec<_>>())?;
    both(out, "paths", &all().flat_map(|case| &case.paths).collect::<Vec<_>>())?;
    both(out, "means", &all().flat_map(|case| &case.means).collect::<Vec<_>>())?;
    both(out, "along", &all().flat_map(along).collect::<Vec<_>>())?;
    both(out, "left-out", &all().flat_map(|case| &case.left_out).collect::<Vec<_>>())?;
    both(out, "curves", &report.curves)?;
    let certificates: Vec<_> = all().flat_map(|case| &case.certificates).collect();
    json(out, "certificates", &certificates)?;
    json(out, "machine", &report.machine)
}

fn along(case: &Measured) -> Vec<AlongRow<'_>> {
    let along = &case.along;
    let mut rows = Vec::new();
    for (method, answers) in &along.methods {
        for ((distance_m, truth_n), [force_n, error_n]) in
            along.distance_m.iter().zip(&along.truth_n).zip(answers)
        {
            rows.push(AlongRow {
                scene: &case.space.scene,
                grid: case.space.grid,
                direction: along.number,
                distance_m: *distance_m,
                truth_n: *truth_n,
                method: method.name(),
                force_n: *force_n,
                error_n: *error_n,
            });
        }
    }
    rows
}

fn both<T: Serialize>(out: &Folder, name: &str, rows: &[T]) -> Result<(), Failure> {
    out.file(&format!("{name}.csv")).put(&output::csv(rows)?)?;
    json(out, name, &rows)
}

fn json<T: Serialize>(out: &Folder, name: &str, value: &T) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(Failure::work)?;
    out.file(&format!("{name}.json")).put(text.as_bytes())
}
