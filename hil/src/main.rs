//! The emulated devices on the command line: one to talk to, and what all of them are put through.
//!
//! `palpate-hil emulate link`, and in another shell what it prints: `palpate run BLOB --device link:/dev/pts/N`; `palpate-hil matrix` and
//! `palpate-hil closed-loop` print the tables of the documentation.
//! `palpate-hil falcon --usbredir SOCKET`, and then QEMU with `-device qemu-xhci,id=x -chardev socket,id=c,path=SOCKET,reconnect=1
//! -device usb-redir,bus=x.0,chardev=c`: its guest sees 0403:cb48.

use anyhow::{Context, bail, ensure};
use clap::{Args, Parser, Subcommand, ValueEnum};
use palpate_core::{Method, Organ};
use palpate_hil::bench::{Options, serve};
use palpate_hil::emulate::{self, Stroke};
use palpate_hil::{EmulatedLink, EmulatedPolhem, Faults, closed_loop, hosts, matrix, rig};
use palpate_host::BlobFile;
use palpate_host::device::profile::Profile;
use palpate_host::supervisor::DEFAULT_LIMIT_MS;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Emulated haptic devices.
#[derive(Debug, Parser)]
#[command(name = "palpate-hil", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Emulated device on a pseudo terminal, in a hand that presses, to try `palpate run` with.
    ///
    /// Prints the terminal's name, the command that runs an organ on it, and waits for sessions, one after the other, until Ctrl-C or
    /// --seconds. Every four seconds the hand lifts, holds the first button for a moment (which arms), and presses: with --organ through
    /// that organ's surface at its first active node, 10 mm deep, without it 12 mm up and down along z. Nothing real moves.
    ///
    ///   palpate-hil emulate link --organ organ.blob
    ///   palpate run organ.blob --device link:/dev/pts/N        in another shell, with the name that was printed
    #[command(verbatim_doc_comment)]
    Emulate(Emulate),
    /// Emulated Novint Falcon on the USB of a QEMU guest, in real time.
    Falcon(Falcon),
    /// Put every driver through everything that may go wrong, and print what the hand felt.
    ///
    /// Ends with code 1 if a limit was broken. The same seed gives the same runs.
    Matrix(Matrix),
    /// One run of the matrix once more, by what its line in --csv says: what it was struck with, and what came of it.
    Once(Once),
    /// A host or a supervisor of the matrix, which starts this program again.
    #[command(hide = true)]
    Process {
        /// ROLE DEVICE PLACE, the supervisor's limit in ms, and a force.
        #[arg(allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Palpate the golden organ through every driver on virtual time, and print the error of the force at the hand.
    ///
    /// Ends with code 1 if a force is not the organ's, a hand at rest shakes, or a device gives energy to it.
    ClosedLoop(ClosedLoop),
}

#[derive(Debug, Args)]
struct Falcon {
    /// Unix socket to make and to listen on for QEMU's usb-redir.
    #[arg(long, value_name = "SOCKET")]
    usbredir: PathBuf,
    /// Unix socket to make and to listen on for orders, a line each: plug SEED, home, press, lift, strike, calm, forget, report, end.
    #[arg(long, value_name = "SOCKET")]
    control: Option<PathBuf>,
    /// How long to run at most, seconds.
    #[arg(long, default_value_t = 600.0)]
    seconds: f64,
}

/// What can be emulated on a terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Emulated {
    Link,
    Polhem,
}

#[derive(Debug, Args)]
struct Emulate {
    /// A controller of the device link, with its watchdog, or a Polhem / WoodenHaptics, which has none.
    device: Emulated,
    /// The organ that is pressed.
    #[arg(long, value_name = "BLOB")]
    organ: Option<PathBuf>,
    /// Profile of the device: a bundled one's name or a .toml; give the same to `palpate run`.
    #[arg(long)]
    profile: Option<String>,
    /// The hand presses no button: arm with key A in the window.
    #[arg(long)]
    no_button: bool,
    /// How long to run, seconds; until Ctrl-C if not given.
    #[arg(long)]
    seconds: Option<f64>,
    /// Share of the frames that is lost, cut, damaged or 3 ms late, each, 0 to 1.
    #[arg(long, default_value_t = 0.0)]
    faults: f32,
    /// Seed of the faults.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Debug, Args)]
struct Matrix {
    /// Runs in memory, over all devices and faults in turn.
    #[arg(long, default_value_t = 1_000)]
    runs: usize,
    /// Runs over a pseudo terminal.
    #[arg(long, default_value_t = 50)]
    pty: usize,
    /// Runs with hosts that are killed and stopped, over all devices in turn; a second each.
    #[arg(long, default_value_t = 20)]
    hosts: usize,
    /// Seed of all runs.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Add the runs of `hil/bench/run`, whose output is in this file, to the table.
    #[arg(long, value_name = "FILE")]
    qemu: Option<PathBuf>,
    /// Write every run to this file, as comma-separated values.
    #[arg(long)]
    csv: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct Once {
    /// The device and its link.
    rig: String,
    /// The fault.
    fault: String,
    /// Seed of the run.
    seed: u64,
}

#[derive(Debug, Args)]
struct ClosedLoop {
    /// Length of the palpation, seconds of virtual time.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(closed_loop::LEAST_SECONDS..))]
    seconds: u64,
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().command {
        Command::Matrix(arguments) => run_matrix(&arguments),
        Command::Once(arguments) => run_once(&arguments),
        Command::Process { arguments } => hosts::process(&arguments).map_err(|error| anyhow::anyhow!(error)),
        Command::ClosedLoop(ClosedLoop { seconds }) => run_closed_loop(seconds),
        Command::Falcon(Falcon { usbredir, control, seconds }) => {
            ensure!(seconds >= 0.0 && seconds.is_finite(), "--seconds is not {seconds}");
            let options = Options { usbredir, control, longest: Duration::from_secs_f64(seconds) };
            serve(&options, &mut std::io::stdout())?;
            Ok(())
        }
        Command::Emulate(arguments) => emulate(&arguments),
    }
}

fn run_closed_loop(seconds: u64) -> anyhow::Result<()> {
    let all = closed_loop::palpate_all(&rig::all(), Method::Energy, seconds);
    let all = all.map_err(|error| anyhow::anyhow!(error))?;
    print!("{}", closed_loop::Table(&all));
    let broken: Vec<String> =
        all.iter().filter_map(|found| Some(format!("{}: {}", found.rig, found.broken()?))).collect();
    ensure!(broken.is_empty(), "{} of {} broke a limit:\n{}", broken.len(), all.len(), broken.join("\n"));
    Ok(())
}

fn run_once(arguments: &Once) -> anyhow::Result<()> {
    let (kinds, names) = (rig::all(), matrix::Wrong::ALL.map(matrix::Wrong::name));
    let kind = kinds.iter().find(|kind| kind.name == arguments.rig);
    let wrong = matrix::Wrong::ALL.into_iter().find(|wrong| wrong.name() == arguments.fault);
    let known: Vec<&str> = kinds.iter().map(|kind| kind.name).collect();
    let kind = kind.with_context(|| format!("no device `{}`: {}", arguments.rig, known.join(", ")))?;
    let wrong = wrong.with_context(|| format!("no fault `{}`: {}", arguments.fault, names.join(", ")))?;
    println!("{:#?}", wrong.planned(arguments.seed));
    let blob = palpate_hil::session::golden_organ();
    let organ = palpate_core::Organ::read(blob.bytes()).map_err(|error| anyhow::anyhow!("{error:?}"))?;
    let run = matrix::run(*kind, wrong, arguments.seed, &organ).map_err(|error| anyhow::anyhow!(error))?;
    println!("{run:#?}");
    ensure!(run.broken().is_none(), "{}", run.broken().unwrap_or_default());
    Ok(())
}

fn run_matrix(arguments: &Matrix) -> anyhow::Result<()> {
    let seen = std::io::stderr().is_terminal();
    let progress = |done: usize, all: usize| {
        if seen && (done.is_multiple_of(10) || done == all) {
            let end = if done == all { "\n" } else { "" };
            eprint!("\r{done} of {all} runs{end}");
            // A line that cannot be shown is no reason to stop.
            let _ = std::io::stderr().flush();
        }
    };
    let size = matrix::Size { in_memory: arguments.runs, real: arguments.pty, seed: arguments.seed };
    let mut runs = matrix::matrix(&rig::all(), size, &progress);
    let host_runs = hosts::runs(&std::env::current_exe()?, DEFAULT_LIMIT_MS, arguments.hosts, size.seed);
    let medians = hosts::medians(&host_runs);
    runs.extend(host_runs);
    let mut rows = runs.clone();
    if let Some(path) = &arguments.qemu {
        let log = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        rows.extend(palpate_hil::bench::log::runs(&log)?);
    }
    print!("{}", matrix::Table(&rows));
    if let Some(path) = &arguments.csv {
        std::fs::write(path, matrix::csv(&runs))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let broken: Vec<String> = runs
        .iter()
        .filter_map(|run| {
            let why = run.broken()?;
            Some(format!("{}, {}, seed {}: {why}", run.rig, run.wrong.name(), run.seed))
        })
        .collect();
    if !broken.is_empty() {
        bail!("{} of {} runs broke a limit:\n{}", broken.len(), runs.len(), broken.join("\n"));
    }
    if !medians.is_empty() {
        println!("\nno force after the last request of a killed or stopped host, median:");
    }
    for (device, median) in &medians {
        println!("{:>14} {:.1} ms", device.name(), median.as_secs_f64() * 1e3);
    }
    for (device, median) in medians {
        let limit_ms = hosts::TARGET.as_millis();
        ensure!(median <= hosts::TARGET, "{}: later than {limit_ms} ms", device.name());
    }
    println!("\n{} runs, seed {}: no limit was broken.", runs.len(), size.seed);
    Ok(())
}

fn emulate(arguments: &Emulate) -> anyhow::Result<()> {
    let &Emulate { device, faults: rate, seed, seconds, no_button, .. } = arguments;
    ensure!((0.0..=1.0).contains(&rate), "--faults is a share from 0 to 1, not {rate}");
    ensure!(seconds.is_none_or(|s| s >= 0.0 && s.is_finite()), "--seconds is not {seconds:?}");
    let kind = match device {
        Emulated::Link => "link",
        Emulated::Polhem => "polhem",
    };
    let profile = Profile::load(arguments.profile.as_deref().unwrap_or(kind))?;
    ensure!(device == Emulated::Polhem || profile.capstan.is_some(), "the profile states no [capstan]");
    let stroke = match &arguments.organ {
        Some(path) => {
            let blob = BlobFile::load(path).with_context(|| format!("cannot read {}", path.display()))?;
            let organ: Organ<'_> =
                Organ::read(blob.bytes()).with_context(|| format!("{} is no blob", path.display()))?;
            Stroke::on(&organ, &profile)?
        }
        None => Stroke::in_air(&profile),
    };
    let faults = Faults {
        drop: rate,
        truncate: rate,
        corrupt: rate,
        delay: rate,
        delay_us: 3_000,
        ..Faults::default()
    };
    let time = seconds.map(Duration::from_secs_f64);
    let options = emulate::Options { profile, stroke, presses_button: !no_button, faults, seed, time };
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    ctrlc::set_handler(move || stopped.store(true, Ordering::Relaxed)).context("cannot catch Ctrl-C")?;
    let greet = |out: &mut dyn Write, port: &str| {
        let blob = arguments.organ.as_deref().unwrap_or(Path::new("BLOB")).display();
        let profile = arguments.profile.iter().map(|name| format!(" --profile {name}")).collect::<String>();
        writeln!(out, "{port}\npalpate run {blob} --device {kind}:{port}{profile}")
    };
    let out = &mut std::io::stdout();
    match device {
        Emulated::Link => emulate::emulate::<EmulatedLink>(&options, &stop, out, greet)?,
        Emulated::Polhem => emulate::emulate::<EmulatedPolhem>(&options, &stop, out, greet)?,
    }
    Ok(())
}
