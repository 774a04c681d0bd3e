//! Output of a command: lines of text, and tables as CSV. If its reader closes standard output (`| head`),
//! the program ends without an error.

use std::io::{ErrorKind, Write};

use palpate_host::rt::LatencyReport;
use serde::Serialize;

use crate::failure::Failure;
use crate::files::Output;

/// Prints `text` and a line break.
pub(crate) fn line(text: impl std::fmt::Display) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(error) => Err(Failure::work(format!("standard output: {error}"))),
        Ok(()) => Ok(()),
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
