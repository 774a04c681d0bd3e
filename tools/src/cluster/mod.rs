//! `palpate-mpi`: rank 0 plans and owns the store, the other ranks solve. The bits are those of one machine,
//! because an outcome depends on its job only, and every job starts from a state in the store.
//!
//! [`messages`] defines the messages, [`ranks`] is the executor on rank 0, and [`worker`] is the code of the
//! other ranks.
//!
//! Termination. Rank 0 always releases the other ranks: on success, on an error and on a stop (Ctrl-C,
//! SIGTERM). It waits for their last messages. The other ranks ignore signals: mpirun and Slurm signal all
//! ranks, and rank 0 decides. If a rank dies, MPI ends all ranks; the store keeps what was committed.

mod messages;
mod ranks;
mod worker;

use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use mpi::Threading;
use mpi::topology::SimpleCommunicator;
use mpi::traits::Communicator;
use palpate_precompute::space::{Threads, expand, with_threads};

use crate::analysis;
use crate::analysis::threads_or;
use crate::cmd::paper::held_out;
use crate::cmd::precompute::{self, Workers};
use crate::failure::Failure;
use crate::files::Output;
use crate::interrupt::stop_flag;
use crate::usage;
use messages::RankConfig;
use ranks::Ranks;

/// `palpate precompute` and `palpate paper held-out` on many machines
///
/// mpirun -n 64 palpate-mpi precompute liver.toml --out liver.space
///
/// Rank 0 plans, reads and writes; the others solve. A single rank does everything. See docs/guide.md,
/// section 10.
#[derive(Debug, Parser)]
#[command(name = "palpate-mpi", version, arg_required_else_help = true, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Precompute(precompute::Args),
    #[command(subcommand)]
    Paper(Paper),
}

/// Repeat the paper's measurements.
#[derive(Debug, Subcommand)]
enum Paper {
    HeldOut(held_out::Args),
}

impl Command {
    fn scene(&self) -> &Path {
        match self {
            Self::Precompute(args) => &args.scene,
            Self::Paper(Paper::HeldOut(args)) => &args.scene,
        }
    }

    fn space(&self) -> Result<Output, Failure> {
        match self {
            Self::Precompute(args) => args.space(),
            Self::Paper(Paper::HeldOut(args)) => args.space(),
        }
    }

    /// Threads per rank, if given.
    fn threads(&self) -> Option<usize> {
        match self {
            Self::Precompute(args) => args.threads,
            Self::Paper(Paper::HeldOut(args)) => args.threads,
        }
    }
}

/// Runs the command `palpate-mpi` with the arguments of the process.
pub fn palpate_mpi() -> ExitCode {
    let parsed: Result<Cli, clap::Error> = usage::parse(std::env::args_os());
    // Only the main thread calls MPI.
    let Some((mut universe, _)) = mpi::initialize_with_threading(Threading::Funneled) else {
        eprintln!("palpate-mpi: MPI cannot be started");
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
            return if first {
                usage::answer::<Cli>(&error)
            } else {
                ExitCode::from(error.exit_code() as u8)
            };
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

/// Rank 0 without other ranks: solves on its own threads.
fn alone(command: &Command, threads: usize) -> Result<(), Failure> {
    let stop = stop_flag()?;
    let space = command.space()?;
    let bench = analysis::load_for(command.scene(), space.path())?;
    let (context, team) = (bench.context()?, Workers::threads(threads));
    match command {
        Command::Precompute(args) => {
            precompute::run_with(args, (&bench, &space), &stop, &team, |actives, store, stop, progress| {
                let run = |executor: &mut Threads| expand(actives, store, executor, stop, progress);
                with_threads(&context, threads, run).map_err(|error| precompute::of_scene(&bench, error))
            })
        }
        Command::Paper(Paper::HeldOut(args)) => {
            held_out::run_with(args, (&bench, &space), &stop, &team, |held_out, store, stop, progress| {
                Ok(with_threads(&context, threads, |executor| held_out.run(store, executor, stop, progress))?)
            })
        }
    }
}

/// Rank 0 with other ranks: plans, reads and writes.
fn lead(world: &SimpleCommunicator, command: &Command) -> Result<(), Failure> {
    let mut ranks = Ranks::new(world);
    let stop = stop_flag()?;
    let space = command.space()?;
    let bench = analysis::load_for(command.scene(), space.path())?;
    ranks.check_ranks(&RankConfig::of(&bench), &stop)?;
    let team = Workers::ranks(ranks.workers(), world.size() as usize - 1);
    match command {
        Command::Precompute(args) => {
            precompute::run_with(args, (&bench, &space), &stop, &team, |actives, store, stop, progress| {
                expand(actives, store, &mut ranks, stop, progress)
                    .map_err(|error| precompute::of_scene(&bench, error))
            })
        }
        Command::Paper(Paper::HeldOut(args)) => {
            held_out::run_with(args, (&bench, &space), &stop, &team, |held_out, store, stop, progress| {
                Ok(held_out.run(store, &mut ranks, stop, progress)?)
            })
        }
    }
}
