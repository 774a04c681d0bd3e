//! Points from a table: CSV with the columns x_m, y_m and z_m.

use std::fs::File;
use std::io::{BufReader, ErrorKind, IsTerminal, Read, stdin};
use std::path::Path;

use crate::failure::Failure;
use crate::files::STANDARD;

/// Reads the points of a file, or of standard input; `option` is the one that names the file.
pub(crate) fn read_points(path: &Path, option: &str) -> Result<Vec<[f64; 3]>, Failure> {
    if path == Path::new(STANDARD) {
        if stdin().is_terminal() {
            return Err(Failure::input(format!(
                "no points: give {option} FILE.csv, or pipe a table with the header x_m,y_m,z_m into standard input"
            )));
        }
        return parse_points("standard input", stdin().lock());
    }
    let file = File::open(path).map_err(|error| Failure::file(path, &error))?;
    if file.metadata().is_ok_and(|there| there.is_dir()) {
        return Err(Failure::file(path, &ErrorKind::IsADirectory.into()));
    }
    parse_points(&path.display().to_string(), BufReader::new(file))
}

/// Reads the points of a table that messages call `name`.
fn parse_points(name: &str, source: impl Read) -> Result<Vec<[f64; 3]>, Failure> {
    let at = |line: u64, what: String| {
        Failure::input(format!("{name}:{line}: {what}; the header is x_m,y_m,z_m, one point a line"))
    };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(source);
    let header = reader.headers().map_err(|error| at(1, error.to_string()))?;
    let column = |name: &str| header.iter().position(|h| h == name);
    let (Some(x), Some(y), Some(z)) = (column("x_m"), column("y_m"), column("z_m")) else {
        return Err(at(1, "columns x_m, y_m and z_m are required".into()));
    };
    let mut points = Vec::new();
    for (row, record) in reader.records().enumerate() {
        let line = row as u64 + 2;
        let record = record.map_err(|error| match error.kind() {
            csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                at(line, format!("{len} values for {expected_len} columns"))
            }
            _ => at(line, error.to_string()),
        })?;
        let number = |column: usize| -> Result<f64, Failure> {
            let text = record.get(column).unwrap_or("");
            let finite = text.parse().ok().filter(|number: &f64| number.is_finite());
            finite.ok_or_else(|| at(line, format!("`{text}` is not a finite number")))
        };
        points.push([number(x)?, number(y)?, number(z)?]);
    }
    Ok(points)
}
