//! The test inside the virtual machine: the host's real driver on a Falcon on the guest's USB, from
//! enumeration to unplugging.
//!
//! `falcon-guest no-usb` runs before the machine has USB. Then follow `run LINE FIRST LAST EXCHANGES` or
//! `hosts LINE`, where LINE is the serial line to the bench; `end LINE` ends the bench. `falcon-guest faults`
//! prints the number of faults, which is the number of seeds that inject each fault once. Prints one line for
//! each step or run, and a last line that begins with `summary` or `hosts` and `PASS` or `FAIL`. See
//! `hil/bench/run`.

mod killed_hosts;
mod line;
mod runs;
mod timeout_ftdi;
mod wait_for_reply;

use line::Line;
use palpate_core::{Aligned, Organ};
use palpate_hil::bench::{BenchCommand, BenchRun};
use palpate_hil::fault::FaultKind;
use palpate_host::device::falcon::usb::UsbError;
use palpate_host::device::falcon::{Falcon, FalconConfig, FalconError};
use runs::Bench;
use std::ops::RangeInclusive;
use std::process::ExitCode;
use std::time::Instant;

static ORGAN: &Aligned<[u8]> =
    &Aligned(*include_bytes!("../../../../firmware-like-core/golden/organ-514.blob"));

/// The error is one line.
type Outcome<T> = Result<T, String>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let passed = match words[..] {
        ["no-usb"] => no_usb(),
        ["faults"] => {
            println!("{}", FaultKind::BENCH.len());
            Ok(())
        }
        ["run", line, first, last, exchanges] => match (first.parse(), last.parse(), exchanges.parse()) {
            (Ok(first), Ok(last), Ok(exchanges)) => run(line, first..=last, exchanges),
            _ => Err("FIRST, LAST and EXCHANGES must be integers".into()),
        },
        ["hosts", line] => killed_hosts::killed_hosts(line),
        ["end", line] => Line::open(line).and_then(|mut line| line.command(BenchCommand::End).map(drop)),
        ["host"] => killed_hosts::host(),
        ["guard"] => killed_hosts::guard(),
        _ => {
            Err("falcon-guest no-usb | faults | run LINE FIRST LAST EXCHANGES | hosts LINE | end LINE".into())
        }
    };
    match passed {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            println!("summary FAIL {reason}");
            ExitCode::FAILURE
        }
    }
}

/// A run for the log.
fn json(run: &BenchRun) -> String {
    serde_json::to_string(run).expect("plain data")
}

/// Checks the error message on a machine without USB.
fn no_usb() -> Outcome<()> {
    let start = Instant::now();
    match Falcon::open(FalconConfig::default(), None) {
        Err(error @ FalconError::Usb(UsbError::NoUsb)) if start.elapsed().as_secs() < 1 => {
            println!("no-usb PASS \"{error}\"");
            Ok(())
        }
        Err(error) => Err(format!("no-usb: unexpected error: {error}")),
        Ok(_) => Err("no-usb: a Falcon was opened without USB".into()),
    }
}

fn run(line: &str, seeds: RangeInclusive<u64>, exchanges: u64) -> Outcome<()> {
    let start = Instant::now();
    let organ: Organ<'_> = Organ::read(&ORGAN.0).map_err(|error| error.to_string())?;
    let line = Line::open(line)?;
    let mut bench = Bench::new(&organ, line, start);
    let mut runs = Vec::new();
    let mut failed = 0;
    for seed in seeds {
        match bench.run(seed, exchanges) {
            Ok(run) => {
                println!("run PASS {}", json(&run));
                runs.push(run);
            }
            Err(reason) => {
                failed += 1;
                println!("run FAIL seed={seed} {reason}");
            }
        }
    }
    let largest_n = runs.iter().map(|run| run.largest_n).fold(0.0, f32::max);
    let unhomed_n = runs.iter().map(|run| run.unhomed_n).fold(0.0, f32::max);
    let slowest_ms = runs.iter().filter_map(|run| run.zero_ms).fold(0.0, f32::max);
    let clean = runs.iter().find(|run| run.fault.is_none());
    let (done, lost, closing) = clean.map_or((0, 0, 0), |run| (run.exchanges, run.lost, run.lost_closing));
    let all: u64 = runs.iter().map(|run| run.exchanges).sum();
    let rate_hz = clean.map_or(0.0, BenchRun::rate_hz);
    println!(
        "summary {} runs={} failed={failed} exchanges={all} clean_exchanges={done} clean_lost={lost} \
         clean_lost_closing={closing} rate_hz={rate_hz:.0} largest_n={largest_n:.2} unhomed_n={unhomed_n:.2} \
         slowest_zero_ms={slowest_ms:.0} seconds={:.1}",
        if failed == 0 { "PASS" } else { "FAIL" },
        runs.len() + failed,
        start.elapsed().as_secs_f64()
    );
    Ok(())
}
