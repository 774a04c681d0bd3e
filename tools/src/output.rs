//! Standard output: a reader that has seen enough (`| head`) ends the program quietly.

use std::io::{ErrorKind, Write};

use crate::failure::Failure;

/// Prints `text` and a line break.
pub(crate) fn line(text: impl std::fmt::Display) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(error) => Err(Failure::work(format!("standard output: {error}"))),
        Ok(()) => Ok(()),
    }
}
