//! `palpate paper`: what the paper measures.

pub(crate) mod compare;
pub(crate) mod held_out;
pub(crate) mod protocol;

use clap::{Args as ClapArgs, Subcommand};

use crate::failure::Failure;

/// Repeat the paper's paths, held-out errors, comparison of laws.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Protocol(protocol::Args),
    Compare(compare::Args),
    HeldOut(held_out::Args),
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    match &args.what {
        What::Protocol(args) => protocol::run(args),
        What::Compare(args) => compare::run(args),
        What::HeldOut(args) => held_out::run(args),
    }
}
