//! Names and kinds of the files of a report.

use crate::files::FileKind;

/// Name of the page.
pub(super) const PAGE: &str = "report.html";

/// Tables that are written both as CSV and as JSON.
const TABLES: [&str; 7] = ["methods", "spaces", "paths", "means", "along", "left-out", "curves"];
/// Outputs that are written as JSON only.
const FIGURES: [&str; 2] = ["certificates", "machine"];

/// The kind of the file with this name in the folder of a report.
pub(super) fn kind_of(name: &str) -> Option<FileKind> {
    let is_table = |stem: &&str| TABLES.contains(stem);
    match name.rsplit_once('.')? {
        _ if name == PAGE => Some(FileKind::Html),
        (stem, "csv") if is_table(&stem) => Some(FileKind::Table),
        (stem, "json") if is_table(&stem) || FIGURES.contains(&stem) => Some(FileKind::Json),
        _ => None,
    }
}
