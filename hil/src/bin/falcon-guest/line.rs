//! The serial line to the bench: one line out, one line back.

use crate::Outcome;
use core::fmt::Display;
use palpate_hil::bench::{BenchCommand, Report};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};

/// A port that carries bytes unchanged.
#[derive(Debug)]
pub(crate) struct Line(File);

impl Line {
    pub(crate) fn open(path: &str) -> Outcome<Self> {
        let opened = OpenOptions::new().read(true).write(true).open(path);
        opened.map(Self).map_err(|error| format!("{path}: {error}"))
    }

    pub(crate) fn request(&mut self, command: impl Display) -> Outcome<String> {
        let failed = |error: std::io::Error| format!("the line to the bench: {error}");
        self.0.write_all(format!("{command}\n").as_bytes()).map_err(failed)?;
        // Each request has one reply line, so nothing follows its end.
        let (mut answer, mut some) = (Vec::new(), [0; 4096]);
        while answer.last() != Some(&b'\n') {
            match self.0.read(&mut some).map_err(failed)? {
                0 => return Err("the line to the bench: closed".into()),
                count => answer.extend(&some[..count]),
            }
        }
        Ok(String::from_utf8_lossy(&answer).trim().into())
    }

    pub(crate) fn command(&mut self, command: BenchCommand) -> Outcome<()> {
        let answer = self.request(command)?;
        if answer == "ok" { Ok(()) } else { Err(format!("the bench answers `{answer}` to `{command}`")) }
    }

    pub(crate) fn report(&mut self) -> Outcome<Report> {
        let answer = self.request(BenchCommand::Report)?;
        answer.parse().map_err(|_| format!("the bench sends a malformed report: `{answer}`"))
    }
}
