//! `palpate`: the command line of all crates. This file has parsing and exit codes only; `cmd/` has one file
//! per command.
//!
//! It is a library because two binaries use it: `palpate`, and with feature `mpi` also `palpate-mpi`.
//!
//! Exit codes: 0 success; 1 the work failed (a path that does not converge, an interrupted run); 2 bad input.
#![forbid(unsafe_code)]

mod analysis;
mod blob;
#[cfg(feature = "mpi")]
mod cluster;
mod cmd;
mod device_spec;
mod displacements;
#[cfg(test)]
mod documents;
mod failure;
mod files;
mod hardware;
mod interrupt;
mod memory;
mod motors_off;
mod output;
mod progress;
mod resident;
mod summary;
mod timing;
mod touch;
mod truth;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Touch a nonlinear soft organ: solve its hyperelastic model offline, interpolate it at 1 kHz.
///
/// Data flow: scene (TOML) -> precompute -> .space -> pack -> .blob -> run. Start with `palpate demo`.
#[derive(Debug, Parser)]
#[command(name = "palpate", version, arg_required_else_help = true, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(cmd::demo::Args),
    Path(cmd::path::Args),
    Compare(cmd::compare::Args),
    Plan(cmd::plan::Args),
    Precompute(cmd::precompute::Args),
    HeldOut(cmd::held_out::Args),
    Protocol(cmd::protocol::Args),
    Pack(cmd::pack::Args),
    Query(cmd::query::Args),
    Inspect(cmd::inspect::Args),
    Report(cmd::report::Args),
    Run(cmd::run::Args),
    #[command(hide = true)]
    Guard(cmd::guard::Args),
    Doctor(cmd::doctor::Args),
    Bench(cmd::bench::Args),
}

#[cfg(feature = "mpi")]
pub use cluster::palpate_mpi;

/// Runs the command `palpate` with the arguments of the process.
pub fn palpate() -> ExitCode {
    let cli = Cli::parse();
    let done = match cli.command {
        Command::Demo(args) => cmd::demo::run(&args),
        Command::Path(args) => cmd::path::run(&args),
        Command::Compare(args) => cmd::compare::run(&args),
        Command::Plan(args) => cmd::plan::run(&args),
        Command::Precompute(args) => cmd::precompute::run(&args),
        Command::HeldOut(args) => cmd::held_out::run(&args),
        Command::Protocol(args) => cmd::protocol::run(&args),
        Command::Pack(args) => cmd::pack::run(&args),
        Command::Query(args) => cmd::query::run(&args),
        Command::Inspect(args) => cmd::inspect::run(&args),
        Command::Report(args) => cmd::report::run(&args),
        Command::Run(args) => cmd::run::run(&args),
        Command::Guard(args) => cmd::guard::run(&args),
        Command::Doctor(args) => cmd::doctor::run(&args),
        Command::Bench(args) => cmd::bench::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("palpate: {}", failure.line());
            failure.exit_code()
        }
    }
}
