//! `palpate bench`: cost of the parts on this machine, compared with peers that are installed.

mod common;
mod core;
mod devices;
mod fem;
pub(super) mod forms;
mod sizes;
mod space;
mod tick;

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
    Devices(devices::Args),
    Forms(forms::Args),
    Fem(fem::Args),
    FemSizes(sizes::Args),
    Space(space::Args),
    Tick(tick::Args),
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    match &args.what {
        What::Core(args) => core::run(args),
        What::Devices(args) => devices::run(args),
        What::Forms(args) => forms::run(args),
        What::Fem(args) => fem::run(args),
        What::FemSizes(args) => sizes::run(args),
        What::Space(args) => space::run(args),
        What::Tick(args) => tick::run(args),
    }
}
