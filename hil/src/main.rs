//! The emulated devices on the command line: one to talk to, and what all of them are put through.
//!
//! `palpate-hil --seconds 60`, and in another shell `palpate run FILE.blob --device polhem:/dev/pts/N`; `palpate-hil matrix` and
//! `palpate-hil closed-loop` print the tables of the documentation.
//! `palpate-hil falcon --usbredir SOCKET`, and then QEMU with `-device qemu-xhci,id=x -chardev socket,id=c,path=SOCKET,reconnect=1
//! -device usb-redir,bus=x.0,chardev=c`: its guest sees 0403:cb48.

use anyhow::{Context, bail, ensure};
use clap::{Args, Parser, Subcommand};
use palpate_core::Method;
use palpate_hil::bench::{Options, serve};
use palpate_hil::{EmulatedPolhem, Faults, Faulty, Handle, PtyTransport, Waypoint};
use palpate_hil::{closed_loop, hosts, matrix, rig};
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Emulated haptic devices. Without a command: a Polhem / WoodenHaptics on a pseudo terminal.
#[derive(Debug, Parser)]
#[command(name = "palpate-hil", version, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    emulate: Emulate,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Emulated Novint Falcon on the USB of a QEMU guest, in real time.
    Falcon(Falcon),
    /// Put every driver through everything that may go wrong, and print what the hand felt.
    ///
    /// Ends with code 1 if a limit was broken. The same seed gives the same runs.
    Matrix(Matrix),
    /// A host or a supervisor of the matrix, which starts this program again.
    #[command(hide = true)]
    Process {
        /// ROLE DEVICE PLACE and a force.
        #[arg(allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Palpate the golden organ through every driver on virtual time, and print the error of the force at the hand.
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

#[derive(Debug, Args)]
struct Emulate {
    /// How long to run, seconds.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
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
struct ClosedLoop {
    /// Length of the palpation, seconds of virtual time.
    #[arg(long, default_value_t = 60)]
    seconds: u64,
}

fn main() -> anyhow::Result<()> {
    let Arguments { command, emulate: alone } = Arguments::parse();
    match command {
        Some(Command::Matrix(arguments)) => run_matrix(&arguments),
        Some(Command::Process { arguments }) => {
            hosts::process(&arguments).map_err(|error| anyhow::anyhow!(error))
        }
        Some(Command::ClosedLoop(ClosedLoop { seconds })) => {
            let found = closed_loop::palpate_all(&rig::all(), Method::Energy, seconds);
            print!("{}", closed_loop::Table(&found.map_err(|error| anyhow::anyhow!(error))?));
            Ok(())
        }
        Some(Command::Falcon(Falcon { usbredir, control, seconds })) => {
            ensure!(seconds >= 0.0 && seconds.is_finite(), "--seconds is not {seconds}");
            let options = Options { usbredir, control, longest: Duration::from_secs_f64(seconds) };
            serve(&options, &mut std::io::stdout())?;
            Ok(())
        }
        None => emulate(&alone),
    }
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
    let host_runs = hosts::runs(&std::env::current_exe()?, arguments.hosts, size.seed);
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
    let rate = arguments.faults;
    ensure!((0.0..=1.0).contains(&rate), "--faults is a share from 0 to 1, not {rate}");
    let (link, driver) = PtyTransport::pair()?;
    {
        use serialport::SerialPort;
        println!("{}", driver.name().unwrap_or_default());
    }
    let faults = Faults {
        drop: rate,
        truncate: rate,
        corrupt: rate,
        delay: rate,
        delay_us: 3_000,
        ..Faults::default()
    };
    let mut link = Faulty::new(link, faults, arguments.seed);
    let mut device = EmulatedPolhem::new(Handle::new(strokes(arguments.seconds)));
    let begun = Instant::now();
    while begun.elapsed().as_secs_f64() < arguments.seconds {
        device.poll(begun.elapsed().as_micros() as u64, &mut link)?;
        std::thread::sleep(Duration::from_micros(100));
    }
    println!("{} requests, {} refused, {:?}", device.requests(), device.refused(), link.counts());
    // Held open to here: without a driver the terminal would otherwise be gone.
    drop(driver);
    Ok(())
}

/// Up and down along z, 12 mm either way, four seconds a stroke.
fn strokes(seconds: f64) -> Vec<Waypoint> {
    let count = (seconds / 2.0).ceil().max(1.0) as u64;
    (0..=count)
        .map(|i| Waypoint {
            t_us: i * 2_000_000,
            position_m: [0.0, 0.0, if i % 2 == 0 { 0.012 } else { -0.012 }],
        })
        .collect()
}
