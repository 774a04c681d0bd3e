//! `palpate pack`: fits the tables of a `.space` file and writes the blob.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::Method;
use palpate_precompute::blob_writer::{Packed, pack, write_atomically};
use palpate_precompute::configuration_space::{SpaceGrid, Store, still_to_solve};

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
    /// Pack a space that is not finished: where it has no data the force is extrapolated
    #[arg(long)]
    partial: bool,
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
    check_finished(&store, args)?;
    let Packed { bytes, left_out } = pack(&store, &args.methods)?;
    for name in left_out {
        eprintln!("palpate: warning: active node {name} has no solved configuration and is left out");
    }
    write_atomically(&args.out, &bytes).map_err(|error| Failure::file(&args.out, &error))?;
    let names: Vec<&str> = args.methods.iter().map(|m| m.name()).collect();
    output::line(format!("{}: {} bytes, {}", args.out.display(), bytes.len(), names.join(", ")))?;
    Ok(())
}

/// A blob of half a space looks like any other in the hand: it is made only when asked for.
fn check_finished(store: &Store, args: &Args) -> Result<(), Failure> {
    let identity = store.identity()?;
    let space = args.space.display();
    let grid = SpaceGrid::new(identity.spacing_m, identity.radius_m)
        .map_err(|error| Failure::input(format!("{space}: {error}")))?;
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let open = still_to_solve(&grid, identity.complete_cells, &store.attempts(active)?);
        if open == 0 {
            continue;
        }
        let what = format!(
            "{space}: active node {name} is not finished: {open} points or more are still to be solved"
        );
        if !args.partial {
            return Err(Failure::input(format!(
                "{what}; run `palpate precompute` again, or pack with --partial"
            )));
        }
        eprintln!("palpate: warning: {what}");
    }
    Ok(())
}
