//! Arguments that the sub-commands of `bench` share.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_host::sys::{RtRequest, enter_real_time};
use serde::Serialize;

use crate::failure::Failure;
use crate::output;

/// Where the figures go.
#[derive(Debug, ClapArgs)]
pub(super) struct Out {
    /// Write the figures as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Print the figures as JSON.
    #[arg(long)]
    json: bool,
}

impl Out {
    /// Writes the table as CSV if asked for, and prints `figures` as JSON or else the table for people.
    pub(super) fn write(
        &self,
        csv: impl FnOnce() -> Result<Vec<u8>, Failure>,
        figures: &impl Serialize,
        table: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        if let Some(path) = &self.csv {
            std::fs::write(path, csv()?).map_err(|error| Failure::file(path, &error))?;
        }
        if self.json {
            return output::line(serde_json::to_string_pretty(figures).map_err(Failure::work)?);
        }
        output::line(table())
    }
}

/// Where it runs.
#[derive(Debug, ClapArgs)]
pub(super) struct Pinned {
    /// CPU to run on; the last one if not given.
    #[arg(long, value_name = "N")]
    cpu: Option<usize>,
}

impl Pinned {
    /// Pins the calling thread; says to which CPU, and whether that was granted.
    pub(super) fn pin(&self) -> String {
        let last = || std::thread::available_parallelism().map_or(0, |n| n.get() - 1);
        let cpu = self.cpu.unwrap_or_else(last);
        let (granted, _) = enter_real_time(&RtRequest { cpu: Some(cpu), ..RtRequest::none() });
        format!("CPU {cpu}: {}", granted.affinity)
    }
}
