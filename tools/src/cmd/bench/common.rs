//! Arguments that the subcommands of `bench` share.

use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_host::sys::{RtRequest, enter_real_time};
use serde::Serialize;

use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::output;

/// Destination of the figures.
#[derive(Debug, ClapArgs)]
pub(super) struct Out {
    /// Write the figures as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Print the figures as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// The checked destination of the figures.
#[derive(Debug)]
pub(super) struct Ready {
    csv: Option<Output>,
    json: bool,
}

impl Out {
    /// Checks the output of a command that reads `inputs`, before the measurement.
    pub(super) fn ready<'p>(&self, inputs: impl IntoIterator<Item = &'p Path>) -> Result<Ready, Failure> {
        let mut files = Files::new(self.replace);
        inputs.into_iter().for_each(|path| files.read(path));
        let csv = self.csv.as_ref().map(|path| files.write("--csv", path, FileKind::Table)).transpose()?;
        Ok(Ready { csv, json: self.json })
    }
}

impl Ready {
    /// Writes the table as CSV if requested. Prints `figures` as JSON or the table as text.
    pub(super) fn write(
        &self,
        csv: impl FnOnce() -> Result<Vec<u8>, Failure>,
        figures: &impl Serialize,
        table: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        if let Some(file) = &self.csv {
            file.put(&csv()?)?;
        }
        if self.json {
            return output::line(serde_json::to_string_pretty(figures).map_err(Failure::work)?);
        }
        output::line(table())
    }
}

/// The files of the bundled organs in their folder.
pub(super) fn assets(folder: &Path) -> Vec<PathBuf> {
    let names = ["liver-small", "liver-large"].into_iter();
    names.flat_map(|name| ["toml", "msh"].map(|kind| folder.join(format!("{name}.{kind}")))).collect()
}

/// The CPU of the measurement.
#[derive(Debug, ClapArgs)]
pub(super) struct Pinned {
    /// CPU to run on; the last one if not given.
    #[arg(long, value_name = "N")]
    cpu: Option<usize>,
}

impl Pinned {
    /// Pins the calling thread. Returns the CPU, and whether the system granted it.
    pub(super) fn pin(&self) -> String {
        let last = || std::thread::available_parallelism().map_or(0, |n| n.get() - 1);
        let cpu = self.cpu.unwrap_or_else(last);
        let (granted, _) = enter_real_time(&RtRequest { cpu: Some(cpu), ..RtRequest::none() });
        format!("CPU {cpu}: {}", granted.affinity)
    }
}
