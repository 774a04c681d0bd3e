//! Numbers from a table: CSV with named columns, among them the points x_m, y_m and z_m.

use std::fs::File;
use std::io::{BufReader, ErrorKind, IsTerminal, Read, stdin};
use std::path::Path;

use crate::failure::Failure;
use crate::files::STANDARD;

/// Reads the points of a file, or of standard input; `option` is the one that names the file.
pub(crate) fn read_points(path: &Path, option: &str) -> Result<Vec<[f64; 3]>, Failure> {
    table(path, option, ["x_m", "y_m", "z_m"])
}

/// Reads some columns of a file, or of standard input; `option` is the one that names the file.
pub(crate) fn table<const N: usize>(
    path: &Path,
    option: &str,
    columns: [&str; N],
) -> Result<Vec<[f64; N]>, Failure> {
    Ok(table_with(path, option, columns, [])?.into_iter().map(|(row, [])| row).collect())
}

/// The numbers of the required columns of a row, and of the others.
type Row<const N: usize, const M: usize> = ([f64; N], [f64; M]);

/// The same with columns that are zero where the table has none of them.
pub(crate) fn table_with<const N: usize, const M: usize>(
    path: &Path,
    option: &str,
    columns: [&str; N],
    more: [&str; M],
) -> Result<Vec<Row<N, M>>, Failure> {
    if path == Path::new(STANDARD) {
        if stdin().is_terminal() {
            return Err(Failure::input(format!(
                "no points: give {option} FILE.csv, or pipe a table with the header {} into standard input",
                columns.join(",")
            )));
        }
        return parse("standard input", stdin().lock(), columns, more);
    }
    let file = File::open(path).map_err(|error| Failure::file(path, &error))?;
    if file.metadata().is_ok_and(|there| there.is_dir()) {
        return Err(Failure::file(path, &ErrorKind::IsADirectory.into()));
    }
    parse(&path.display().to_string(), BufReader::new(file), columns, more)
}

/// Reads the columns of a table that messages call `name`.
fn parse<const N: usize, const M: usize>(
    name: &str,
    source: impl Read,
    columns: [&str; N],
    more: [&str; M],
) -> Result<Vec<Row<N, M>>, Failure> {
    let at = |line: u64, what: String| {
        let header = columns.join(",");
        Failure::input(format!("{name}:{line}: {what}; the header is {header}, one point a line"))
    };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(source);
    let header = reader.headers().map_err(|error| at(1, error.to_string()))?;
    let mut places = [0; N];
    for (place, column) in places.iter_mut().zip(columns) {
        let found = header.iter().position(|h| h == column);
        *place = found.ok_or_else(|| at(1, format!("the column {column} is required")))?;
    }
    let mut other = [None; M];
    let has_more = more.iter().any(|column| header.iter().any(|h| h == *column));
    for (place, column) in other.iter_mut().zip(more).filter(|_| has_more) {
        *place = header.iter().position(|h| h == column);
        if place.is_none() {
            return Err(at(1, format!("the column {column} goes with the others of its kind")));
        }
    }
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
        let mut values = [0.0; N];
        for (value, place) in values.iter_mut().zip(places) {
            *value = number(place)?;
        }
        let mut others = [0.0; M];
        for (value, place) in others.iter_mut().zip(other) {
            *value = place.map_or(Ok(0.0), number)?;
        }
        points.push((values, others));
    }
    Ok(points)
}
