//! The command line of the emulated devices: emulators to connect to, and the tests of all drivers.
//!
//! `palpate-hil emulate link` prints the command for another shell: `palpate run BLOB --device
//! link:/dev/pts/N`. `palpate-hil matrix` and `palpate-hil closed-loop` print the tables of the
//! documentation. `palpate-hil falcon --usbredir SOCKET` serves QEMU with `-device qemu-xhci,id=x -chardev
//! socket,id=c,path=SOCKET,reconnect=1 -device usb-redir,bus=x.0,chardev=c`; the guest enumerates 0403:cb48.

use anyhow::{Context, bail, ensure};
use clap::{Args, Parser, Subcommand, ValueEnum};
use palpate_core::{Method, Organ};
use palpate_hil::bench::{Options, serve};
use palpate_hil::emulate::{self, Stroke};
use palpate_hil::fault::FaultKind;
use palpate_hil::{EmulatedLink, EmulatedPolhem, Faults, closed_loop, haply_rate, hosts, matrix, rig};
use palpate_host::BlobFile;
use palpate_host::device::profile::Profile;
use palpate_host::guard::DEFAULT_LIMIT_MS;
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
    /// Emulate a device on a pseudo terminal in a pressing hand, to try `palpate run` with.
    ///
    /// Prints the name of the terminal and the command that runs an organ on it. Serves one session after the
    /// other until Ctrl-C or --seconds. Every four seconds the hand lifts, presses the first button for a
    /// moment (which arms the loop), and presses down: with --organ through the organ's surface at its first
    /// active node to a depth of 10 mm, otherwise 12 mm up and down along z. No real hardware moves.
    ///
    ///   palpate-hil emulate link --organ organ.blob
    ///   palpate run organ.blob --device link:/dev/pts/N        in another shell, with the printed name
    #[command(verbatim_doc_comment)]
    Emulate(Emulate),
    /// Emulate a Novint Falcon on the USB of a QEMU guest, in real time.
    Falcon(Falcon),
    /// Inject every fault into every driver, and print the forces on the hand.
    ///
    /// Ends with exit code 1 if a limit is violated. The same seed gives the same runs.
    Matrix(Matrix),
    /// Repeat one run of the matrix from its line in --csv, and print the injected faults and the result.
    Once(Once),
    /// A host or guard process of the matrix, started by this program.
    #[command(hide = true)]
    Process {
        /// ROLE DEVICE ADDRESS LIMIT_MS FORCE: the limit is the guard's, the force has three components.
        #[arg(allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Palpate the golden organ through every driver on virtual time, and print the error of the force on the
    /// hand.
    ///
    /// Ends with exit code 1 if a force is not the organ's, the grip oscillates in a resting hand, or a
    /// device adds energy to the hand.
    ClosedLoop(ClosedLoop),
    /// Measure the exchanges of the driver of the Inverse Service, in turn with a bare echo over WebSocket.
    ///
    /// Ends with exit code 1 if there are fewer than 1000 in any second, or if their 99.9th percentile is more
    /// than 1.5 times that of the echo.
    HaplyRate {
        /// Time of the measurement, seconds.
        #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(2..))]
        seconds: u64,
    },
}

#[derive(Debug, Args)]
struct Falcon {
    /// Unix socket to create for QEMU's usb-redir.
    #[arg(long, value_name = "SOCKET")]
    usbredir: PathBuf,
    /// Unix socket to create for commands, one JSON value a line: {"plug":{"seed":1}}, "home", "press", "lift",
    /// "inject", "clear-faults", "reset-record", "report", "end".
    #[arg(long, value_name = "SOCKET")]
    control: Option<PathBuf>,
    /// Longest time to run, seconds.
    #[arg(long, default_value_t = 600.0)]
    seconds: f64,
}

/// Devices that can be emulated on a terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Emulated {
    Link,
    Polhem,
}

#[derive(Debug, Args)]
struct Emulate {
    /// A controller of the device link, which has a watchdog, or a Polhem / WoodenHaptics, which has none.
    device: Emulated,
    /// The organ that the hand presses.
    #[arg(long, value_name = "BLOB")]
    organ: Option<PathBuf>,
    /// Profile of the device: a bundled name or a .toml file; give the same to `palpate run`.
    #[arg(long)]
    profile: Option<String>,
    /// The hand presses no button: arm with key A in the window.
    #[arg(long)]
    no_button: bool,
    /// Time to run, seconds; without it, until Ctrl-C.
    #[arg(long)]
    seconds: Option<f64>,
    /// Probability of each of loss, truncation, corruption and a delay of 3 ms, for each frame, 0 to 1.
    #[arg(long, default_value_t = 0.0)]
    faults: f32,
    /// Seed of the faults.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Debug, Args)]
struct Matrix {
    /// Number of runs in memory, over all devices and faults in turn.
    #[arg(long, default_value_t = 1_000)]
    runs: usize,
    /// Number of runs over a pseudo terminal or the sockets of a service.
    #[arg(long, default_value_t = 50)]
    pty: usize,
    /// Number of runs with killed and stopped hosts and guards, over all devices in turn; each takes about a
    /// second.
    #[arg(long, default_value_t = 20)]
    hosts: usize,
    /// Seed of all runs.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File with the output of `hil/bench/run`, whose runs are added to the table.
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
    #[arg(hide_possible_values = true)]
    fault: FaultKind,
    /// Seed of the run.
    seed: u64,
}

#[derive(Debug, Args)]
struct ClosedLoop {
    /// Length of the palpation, seconds of virtual time.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(closed_loop::MIN_SECONDS..))]
    seconds: u64,
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().command {
        Command::Matrix(arguments) => run_matrix(&arguments),
        Command::Once(arguments) => run_once(&arguments),
        Command::Process { arguments } => hosts::process(&arguments).map_err(|error| anyhow::anyhow!(error)),
        Command::ClosedLoop(ClosedLoop { seconds }) => run_closed_loop(seconds),
        Command::Falcon(Falcon { usbredir, control, seconds }) => {
            ensure!(
                seconds >= 0.0 && seconds.is_finite(),
                "--seconds must be at least 0 and finite, not {seconds}"
            );
            let options = Options { usbredir, control, longest: Duration::from_secs_f64(seconds) };
            serve(&options, &mut std::io::stdout())?;
            Ok(())
        }
        Command::Emulate(arguments) => emulate(&arguments),
        Command::HaplyRate { seconds } => {
            let measured = haply_rate::measure(Duration::from_secs(seconds))?;
            print!("{measured}");
            measured.violation().map_or(Ok(()), |violation| bail!(violation))
        }
    }
}

fn run_closed_loop(seconds: u64) -> anyhow::Result<()> {
    let all = closed_loop::palpate_all(&rig::all(), Method::Energy, seconds);
    let all = all.map_err(|error| anyhow::anyhow!(error))?;
    print!("{}", closed_loop::Table(&all));
    let violation: Vec<String> =
        all.iter().filter_map(|found| Some(format!("{}: {}", found.rig, found.violation()?))).collect();
    ensure!(
        violation.is_empty(),
        "{} of {} violated a limit:\n{}",
        violation.len(),
        all.len(),
        violation.join("\n")
    );
    Ok(())
}

fn run_once(arguments: &Once) -> anyhow::Result<()> {
    let (kinds, fault) = (rig::all(), arguments.fault);
    let kind = kinds.iter().find(|kind| kind.name == arguments.rig);
    let known: Vec<&str> = kinds.iter().map(|kind| kind.name).collect();
    let kind =
        kind.with_context(|| format!("unknown device `{}`; known: {}", arguments.rig, known.join(", ")))?;
    let names = FaultKind::ALL.map(|fault| fault.to_string()).join(", ");
    ensure!(FaultKind::ALL.contains(&fault), "`{fault}` does not run in lockstep; these do: {names}");
    println!("{:#?}", fault.plan_for_display(arguments.seed));
    let blob = palpate_hil::session::golden_organ();
    let organ = palpate_core::Organ::read(blob.bytes()).map_err(|error| anyhow::anyhow!("{error:?}"))?;
    let run = matrix::run(*kind, fault, arguments.seed, &organ).map_err(|error| anyhow::anyhow!(error))?;
    println!("{run:#?}");
    ensure!(run.violation().is_none(), "{}", run.violation().unwrap_or_default());
    Ok(())
}

fn run_matrix(arguments: &Matrix) -> anyhow::Result<()> {
    let seen = std::io::stderr().is_terminal();
    let progress = |done: usize, all: usize| {
        if seen && (done.is_multiple_of(10) || done == all) {
            let end = if done == all { "\n" } else { "" };
            eprint!("\r{done} of {all} runs{end}");
            // A failure to print the progress is no error.
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
    let violation: Vec<String> = runs
        .iter()
        .filter_map(|run| {
            let why = run.violation()?;
            Some(format!("{}, {}, seed {}: {why}", run.rig, run.fault, run.seed))
        })
        .collect();
    if !violation.is_empty() {
        bail!("{} of {} runs violated a limit:\n{}", violation.len(), runs.len(), violation.join("\n"));
    }
    if !medians.is_empty() {
        println!("\ntime from the loss of a host or guard to zero force, median:");
    }
    for (device, median) in &medians {
        println!("{:>14} {:.1} ms", device.name(), median.as_secs_f64() * 1e3);
    }
    for (device, median) in medians {
        let limit_ms = hosts::TARGET.as_millis();
        ensure!(median <= hosts::TARGET, "{}: the median is above {limit_ms} ms", device.name());
    }
    println!("\n{} runs, seed {}: no limit was violated.", runs.len(), size.seed);
    Ok(())
}

fn emulate(arguments: &Emulate) -> anyhow::Result<()> {
    let &Emulate { device, faults: rate, seed, seconds, no_button, .. } = arguments;
    ensure!((0.0..=1.0).contains(&rate), "--faults must be from 0 to 1, not {rate}");
    ensure!(
        seconds.is_none_or(|s| s >= 0.0 && s.is_finite()),
        "--seconds must be at least 0 and finite, not {seconds:?}"
    );
    let kind = match device {
        Emulated::Link => "link",
        Emulated::Polhem => "polhem",
    };
    let profile = Profile::load(arguments.profile.as_deref().unwrap_or(kind))?;
    ensure!(device == Emulated::Polhem || profile.capstan.is_some(), "the profile has no [capstan]");
    let stroke = match &arguments.organ {
        Some(path) => {
            let blob = BlobFile::load(path).with_context(|| format!("cannot read {}", path.display()))?;
            let organ: Organ<'_> = Organ::read(blob.bytes())
                .with_context(|| format!("{} is not a valid blob", path.display()))?;
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
    let announce = |out: &mut dyn Write, port: &str| {
        let blob = arguments.organ.as_deref().unwrap_or(Path::new("BLOB")).display();
        let profile = arguments.profile.iter().map(|name| format!(" --profile {name}")).collect::<String>();
        writeln!(out, "{port}\npalpate run {blob} --device {kind}:{port}{profile}")
    };
    let out = &mut std::io::stdout();
    match device {
        Emulated::Link => emulate::emulate::<EmulatedLink>(&options, &stop, out, announce)?,
        Emulated::Polhem => emulate::emulate::<EmulatedPolhem>(&options, &stop, out, announce)?,
    }
    Ok(())
}
