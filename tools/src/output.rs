//! Output of a command: lines and aligned tables on standard output, tables as CSV. Colours appear only on a
//! terminal and without `NO_COLOR`. If the reader closes standard output (`| head`), the program ends without
//! an error.

use std::fmt;
use std::io::{ErrorKind, Write};

use console::{Alignment, Style, pad_str};
use palpate_host::rt::LatencyReport;
use palpate_precompute::certificate::Verdict;
use serde::Serialize;

use crate::failure::Failure;
use crate::files::Output;

/// Prints `text` and a line break.
pub(crate) fn line(text: impl fmt::Display) -> Result<(), Failure> {
    bytes(format!("{text}\n").as_bytes())
}

/// Writes bytes to standard output.
fn bytes(bytes: &[u8]) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(error) => Err(Failure::work(format!("standard output: {error}"))),
        Ok(()) => Ok(()),
    }
}

/// Writes a whole table to a file, or to standard output.
pub(crate) fn table(file: Option<&Output>, table: &[u8]) -> Result<(), Failure> {
    file.map_or_else(|| bytes(table), |file| file.put(table))
}

/// Prints a value as indented JSON.
pub(crate) fn json(value: &impl Serialize) -> Result<(), Failure> {
    line(serde_json::to_string_pretty(value).map_err(Failure::work)?)
}

/// The name of a verdict in its colour.
pub(crate) fn verdict(verdict: Verdict) -> String {
    let style = match verdict {
        Verdict::Green => Style::new().green(),
        Verdict::Yellow => Style::new().yellow(),
        Verdict::Red => Style::new().red(),
    };
    style.bold().apply_to(verdict.name().to_uppercase()).to_string()
}

/// An aligned table: the first columns left, the others right, two spaces apart.
#[derive(Debug)]
pub(crate) struct Table {
    left: usize,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table whose first `left` columns hold text; the header names the unit of every number.
    pub(crate) fn new<const N: usize>(left: usize, header: [&str; N]) -> Self {
        let header = header.map(|name| Style::new().bold().apply_to(name).to_string());
        Self { left, rows: vec![header.into()] }
    }

    /// Adds a row.
    pub(crate) fn row<const N: usize>(&mut self, cells: [String; N]) {
        self.rows.push(cells.into());
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |column: usize| {
            let cells = self.rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| console::measure_text_width(cell)).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        for (number, row) in self.rows.iter().enumerate() {
            let pad = |(column, cell): (usize, &String)| {
                let side = if column < self.left { Alignment::Left } else { Alignment::Right };
                pad_str(cell, widths[column], side, None).into_owned()
            };
            let cells: Vec<String> = row.iter().enumerate().map(pad).collect();
            let end = if number == 0 { "" } else { "\n" };
            write!(f, "{end}{}", cells.join("  ").trim_end())?;
        }
        Ok(())
    }
}

/// A CSV file made row by row. A number has all its digits, a missing value is an empty cell.
#[derive(Debug)]
pub(crate) struct Csv(csv::Writer<Vec<u8>>);

impl Csv {
    /// A file with these columns.
    pub(crate) fn new<C: AsRef<[u8]>>(columns: impl IntoIterator<Item = C>) -> Result<Self, Failure> {
        let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
        writer.write_record(columns).map_err(Failure::work)?;
        Ok(Self(writer))
    }

    /// Adds a row: a tuple, an array or a list of them, as long as the header.
    pub(crate) fn row(&mut self, cells: impl Serialize) -> Result<(), Failure> {
        self.0.serialize(cells).map_err(Failure::work)
    }

    /// The bytes of the file.
    pub(crate) fn finish(self) -> Result<Vec<u8>, Failure> {
        self.0.into_inner().map_err(Failure::work)
    }
}

/// Rows as CSV under the names of their fields.
pub(crate) fn csv<T: Serialize>(rows: &[T]) -> Result<Vec<u8>, Failure> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).map_err(Failure::work)?;
    }
    writer.into_inner().map_err(Failure::work)
}

/// The histograms of a run: `quantity,ns,count,share`, one row per bin that is not empty.
pub(crate) fn histograms(file: &Output, latency: &LatencyReport) -> Result<(), Failure> {
    file.put(&csv(&latency.histograms.rows())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_aligns_text_left_and_numbers_right_without_colours_on_a_pipe() {
        let mut table = Table::new(1, ["node", "error, mN"]);
        table.row(["A1".into(), "0.02".into()]);
        table.row(["long name".into(), verdict(Verdict::Green)]);
        assert_eq!(table.to_string(), "node       error, mN\nA1              0.02\nlong name      GREEN");
    }

    /// The values of a row are read back bit for bit.
    #[test]
    fn a_csv_file_keeps_every_digit_and_the_order_of_its_columns() {
        let numbers = [0.1 + 0.2, 1.5e-5, -2.0e-17, 1e22, f64::MIN_POSITIVE];
        let mut file = Csv::new("name,a,b,c,d,e,f,none".split(',')).expect("in memory");
        file.row(("A,1", numbers, 0.1f32, None::<f64>)).expect("as long as the header");
        let text = String::from_utf8(file.finish().expect("in memory")).expect("text");
        let (header, row) = text.split_once('\n').expect("two lines");
        assert_eq!(header, "name,a,b,c,d,e,f,none");
        let row = row.strip_prefix("\"A,1\",").and_then(|row| row.strip_suffix(",0.1,\n")).expect("the ends");
        let read: Vec<f64> = row.split(',').map(|cell| cell.parse().expect("a number")).collect();
        assert_eq!(read, numbers);
        let mut other = Csv::new(["one", "two"]).expect("in memory");
        assert!(other.row(("short",)).is_err());
    }
}
