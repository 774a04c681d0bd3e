//! `palpate pack`: fits the tables of a `.space` file and writes the blob.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::Method;
use palpate_precompute::blob_writer::{Packed, pack, write_atomically};
use palpate_precompute::configuration_space::Store;

use crate::failure::Failure;
use crate::output;

/// Fit the tables of a .space file and pack them into a .blob for the real-time loop.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .space file
    space: PathBuf,
    /// Methods to pack, separated by commas: trilinear, tricubic, hybrid, rbf-linear, rbf-cubic
    #[arg(long = "method", value_delimiter = ',', default_value = "hybrid", value_parser = method)]
    methods: Vec<Method>,
    /// The .blob file to write
    #[arg(long)]
    out: PathBuf,
}

/// Parses a method's name.
pub(crate) fn method(text: &str) -> Result<Method, String> {
    Method::from_name(text).ok_or_else(|| {
        let names: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        format!("no such method; choose from {}", names.join(", "))
    })
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let store = Store::open(&args.space)?;
    let Packed { bytes, left_out } = pack(&store, &args.methods)?;
    for name in left_out {
        eprintln!("palpate: warning: active node {name} has no solved configuration and is left out");
    }
    write_atomically(&args.out, &bytes).map_err(|error| Failure::file(&args.out, &error))?;
    let names: Vec<&str> = args.methods.iter().map(|m| m.name()).collect();
    output::line(format!("{}: {} bytes, {}", args.out.display(), bytes.len(), names.join(", ")))?;
    Ok(())
}
