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
mod control;
mod device_spec;
mod displacements;
#[cfg(test)]
mod documents;
mod failure;
mod files;
mod friction;
mod hardware;
mod html;
mod interrupt;
mod machine;
mod memory;
mod motors_off;
mod output;
mod plot;
mod points;
mod progress;
mod regions;
mod resident;
mod session;
mod setting;
mod steps;
mod summary;
mod timing;
mod touch;
mod truth;
mod usage;
mod version;
mod words;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

const FLOW: &str = "scene.toml -> precompute -> .space -> pack -> .blob -> run: see docs/guide.md";

/// Touch a nonlinear soft organ: solve its model offline, interpolate at 1 kHz.
#[derive(Debug, Parser)]
#[command(name = "palpate", version, long_version = version::long(), arg_required_else_help = true, max_term_width = 100, after_help = FLOW)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(cmd::demo::Args),
    Path(cmd::path::Args),
    Map(cmd::map::Args),
    Plan(cmd::plan::Args),
    Precompute(cmd::precompute::Args),
    Pack(cmd::pack::Args),
    Query(cmd::query::Args),
    Identify(cmd::identify::Args),
    Inspect(cmd::inspect::Args),
    Run(cmd::run::Args),
    Live(cmd::live::Args),
    Control(cmd::control::Args),
    #[command(hide = true)]
    Guard(cmd::guard::Args),
    #[command(hide = true)]
    Proxy(cmd::proxy::Args),
    #[command(hide = true)]
    LiveSolver(cmd::live_solver::Args),
    Doctor(cmd::doctor::Args),
    Report(cmd::report::Args),
    Paper(cmd::paper::Args),
    /// Measure the cost of the parts, and of installed peers
    Bench(cmd::bench::Args),
    Man(cmd::man::Args),
    Completions(cmd::completions::Args),
}

#[cfg(feature = "mpi")]
pub use cluster::palpate_mpi;

/// Runs the command `palpate` with the arguments of the process.
pub fn palpate() -> ExitCode {
    let cli: Cli = match usage::parse(std::env::args_os()) {
        Ok(cli) => cli,
        Err(error) => return usage::answer::<Cli>(&error),
    };
    let done = match cli.command {
        Command::Demo(args) => cmd::demo::run(&args),
        Command::Path(args) => cmd::path::run(&args),
        Command::Map(args) => cmd::map::run(&args),
        Command::Plan(args) => cmd::plan::run(&args),
        Command::Precompute(args) => cmd::precompute::run(&args),
        Command::Pack(args) => cmd::pack::run(&args),
        Command::Query(args) => cmd::query::run(&args),
        Command::Identify(args) => cmd::identify::run(&args),
        Command::Inspect(args) => cmd::inspect::run(&args),
        Command::Report(args) => cmd::report::run(&args),
        Command::Run(args) => cmd::run::run(&args),
        Command::Live(args) => cmd::live::run(&args),
        Command::LiveSolver(args) => cmd::live_solver::run(&args),
        Command::Control(args) => cmd::control::run(&args),
        Command::Guard(args) => cmd::guard::run(&args),
        Command::Proxy(args) => cmd::proxy::run(&args),
        Command::Doctor(args) => cmd::doctor::run(&args),
        Command::Paper(args) => cmd::paper::run(&args),
        Command::Bench(args) => cmd::bench::run(&args),
        Command::Man(args) => cmd::man::run(&args, usage::command::<Cli>()),
        Command::Completions(args) => cmd::completions::run(&args, usage::command::<Cli>()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("palpate: {}", failure.line());
            failure.exit_code()
        }
    }
}
