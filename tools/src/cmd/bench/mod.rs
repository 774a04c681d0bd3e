//! `palpate bench`: cost of the parts on this machine, compared with peers that are installed.

mod common;
mod core;
mod fem;
mod live;
mod public;
mod sizes;

use clap::{Args as ClapArgs, Subcommand};

use crate::failure::Failure;

/// Measure the cost of the parts on this machine, and of installed peers.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Core(core::Args),
    Fem(fem::Args),
    FemSizes(sizes::Args),
    Live(live::Args),
    Public(public::Args),
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    match &args.what {
        What::Core(args) => core::run(args),
        What::Fem(args) => fem::run(args),
        What::FemSizes(args) => sizes::run(args),
        What::Live(args) => live::run(args),
        What::Public(args) => public::run(args),
    }
}
