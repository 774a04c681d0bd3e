//! `palpate-mpi`: rank 0 plans and owns the store, the other ranks solve. The same bits as on one machine,
//! because outcomes depend on the jobs alone and every job's start is what the store holds.
//!
//! [`messages`] is what they say to each other; [`ranks`] is the crew that rank 0 sees; [`worker`] is the
//! other end.
//!
//! Ending. Rank 0 always releases the others, on success, on an error and when it is asked to stop (Ctrl-C,
//! SIGTERM), and waits for their last word. Signals to other ranks do nothing: mpirun and Slurm signal all
//! ranks, and rank 0 decides. A rank that dies takes the others with it (that is MPI's way); what was
//! committed is in the store.

mod messages;
mod ranks;
mod worker;

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

use clap::{Parser, Subcommand};
use mpi::Threading;
use mpi::topology::SimpleCommunicator;
use mpi::traits::Communicator;
use palpate_precompute::space::with_threads;

use crate::analysis;
use crate::analysis::threads_or;
use crate::cmd::held_out;
use crate::cmd::precompute::{self, Team};
use crate::failure::Failure;
use crate::files::Output;
use crate::interrupt::stop_flag;
use messages::Basis;
use ranks::Ranks;

/// `palpate precompute` and `palpate held-out` on many machines:
/// `mpirun -n 64 palpate-mpi precompute liver.toml --out liver.space`.
///
/// Rank 0 plans, reads and writes; the others solve. One rank alone does it all. docs/guide.md, section 10,
/// shows how to start it.
#[derive(Debug, Parser)]
#[command(name = "palpate-mpi", version, arg_required_else_help = true, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Precompute(precompute::Args),
    HeldOut(held_out::Args),
}

impl Command {
    fn scene(&self) -> &Path {
        match self {
            Self::Precompute(args) => &args.scene,
            Self::HeldOut(args) => &args.scene,
        }
    }

    fn space(&self) -> Result<Output, Failure> {
        match self {
            Self::Precompute(args) => args.space(),
            Self::HeldOut(args) => args.space(),
        }
    }

    /// Threads a rank, if asked for.
    fn threads(&self) -> Option<usize> {
        match self {
            Self::Precompute(args) => args.threads,
            Self::HeldOut(args) => args.threads,
        }
    }
}

/// The command `palpate-mpi`, with the arguments of the process.
pub fn palpate_mpi() -> ExitCode {
    let parsed = Cli::try_parse();
    // Only the main thread calls MPI.
    let Some((mut universe, _)) = mpi::initialize_with_threading(Threading::Funneled) else {
        eprintln!("palpate-mpi: MPI does not start");
        return ExitCode::FAILURE;
    };
    let world = universe.world();
    let first = world.rank() == 0;
    if first {
        universe.set_buffer_size(ranks::BUFFER);
    }
    let command = match parsed {
        Ok(cli) => cli.command,
        Err(error) => {
            if first {
                let _ = error.print();
            }
            return ExitCode::from(error.exit_code() as u8);
        }
    };
    let threads = match threads_or(command.threads(), 1) {
        Ok(threads) => threads,
        Err(failure) => {
            if first {
                eprintln!("palpate-mpi: {}", failure.line());
            }
            return failure.exit_code();
        }
    };
    let done = match (first, world.size()) {
        (_, 1) => alone(&command, threads),
        (true, _) => lead(&world, &command),
        (false, _) => stop_flag().map(|_| worker::serve(&world, command.scene(), threads)),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("palpate-mpi: {}", failure.line());
            failure.exit_code()
        }
    }
}

/// Rank 0 without others: solves on its own threads.
fn alone(command: &Command, threads: usize) -> Result<(), Failure> {
    let stop = stop_flag()?;
    let space = command.space()?;
    let bench = analysis::load(command.scene())?;
    let (workshop, team) = (bench.workshop()?, Team::threads(threads));
    match command {
        Command::Precompute(args) => {
            precompute::run_with(args, (&bench, &space), &stop, &team, |expansion, store, stop, progress| {
                Ok(with_threads(&workshop, threads, |crew| expansion.run(store, crew, stop, progress))?)
            })
        }
        Command::HeldOut(args) => {
            held_out::run_with(args, (&bench, &space), &stop, &team, |held_out, store, stop, progress| {
                Ok(with_threads(&workshop, threads, |crew| held_out.run(store, crew, stop, progress))?)
            })
        }
    }
}

/// Rank 0 with others: plans, reads and writes.
fn lead(world: &SimpleCommunicator, command: &Command) -> Result<(), Failure> {
    let mut ranks = Ranks::new(world);
    let stop = stop_flag()?;
    let space = command.space()?;
    let bench = analysis::load(command.scene())?;
    ranks.muster(&Basis::of(&bench), &stop)?;
    let team = Team::ranks(ranks.workers(), world.size() as usize - 1);
    match command {
        Command::Precompute(args) => {
            precompute::run_with(args, (&bench, &space), &stop, &team, |expansion, store, stop, progress| {
                Ok(expansion.run(store, &mut ranks, stop, progress)?)
            })
        }
        Command::HeldOut(args) => {
            held_out::run_with(args, (&bench, &space), &stop, &team, |held_out, store, stop, progress| {
                Ok(held_out.run(store, &mut ranks, stop, progress)?)
            })
        }
    }
}
