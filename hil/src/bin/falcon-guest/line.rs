//! The serial line to the bench: one line out, one line back.

use crate::Outcome;
use palpate_hil::bench::{BenchCommand, Reply, Report};
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

    fn request(&mut self, command: BenchCommand) -> Outcome<Reply> {
        let failed = |error: std::io::Error| format!("the line to the bench: {error}");
        let mut line = serde_json::to_vec(&command).map_err(|error| error.to_string())?;
        line.push(b'\n');
        self.0.write_all(&line).map_err(failed)?;
        // Each request has one reply line, so nothing follows its end.
        let (mut answer, mut some) = (Vec::new(), [0; 4096]);
        while answer.last() != Some(&b'\n') {
            match self.0.read(&mut some).map_err(failed)? {
                0 => return Err("the line to the bench: closed".into()),
                count => answer.extend(&some[..count]),
            }
        }
        serde_json::from_slice(&answer)
            .map_err(|_| format!("the bench sends a malformed reply: `{}`", String::from_utf8_lossy(&answer)))
    }

    pub(crate) fn command(&mut self, command: BenchCommand) -> Outcome<()> {
        match self.request(command)? {
            Reply::Ok => Ok(()),
            other => Err(format!("the bench answers {other:?} to {command:?}")),
        }
    }

    pub(crate) fn report(&mut self) -> Outcome<Report> {
        match self.request(BenchCommand::Report)? {
            Reply::Report(report) => Ok(report),
            other => Err(format!("the bench answers {other:?} to a report request")),
        }
    }
}
