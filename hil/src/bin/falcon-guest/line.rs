//! The serial line to the bench: an order, a line back.

use crate::Outcome;
use core::fmt::Display;
use palpate_hil::bench::{Order, Report};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};

/// The line: a port that carries bytes as they are.
#[derive(Debug)]
pub(crate) struct Line(File);

impl Line {
    pub(crate) fn open(path: &str) -> Outcome<Self> {
        let opened = OpenOptions::new().read(true).write(true).open(path);
        opened.map(Self).map_err(|error| format!("{path}: {error}"))
    }

    pub(crate) fn ask(&mut self, order: impl Display) -> Outcome<String> {
        let failed = |error: std::io::Error| format!("the line to the bench: {error}");
        self.0.write_all(format!("{order}\n").as_bytes()).map_err(failed)?;
        // One line for each, so nothing comes after its end.
        let (mut answer, mut some) = (Vec::new(), [0; 4096]);
        while answer.last() != Some(&b'\n') {
            match self.0.read(&mut some).map_err(failed)? {
                0 => return Err("the line to the bench: it is gone".into()),
                count => answer.extend(&some[..count]),
            }
        }
        Ok(String::from_utf8_lossy(&answer).trim().into())
    }

    pub(crate) fn order(&mut self, order: Order) -> Outcome<()> {
        let answer = self.ask(order)?;
        if answer == "ok" { Ok(()) } else { Err(format!("the bench says `{answer}` to `{order}`")) }
    }

    pub(crate) fn report(&mut self) -> Outcome<Report> {
        let answer = self.ask(Order::Report)?;
        answer.parse().map_err(|_| format!("the bench reports `{answer}`"))
    }
}
