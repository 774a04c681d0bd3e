//! Kills and stops host processes and their guards in the guest while they render a force, on a real bus.

use crate::line::Line;
use crate::{Outcome, json};
use nix::sys::signal::Signal;
use nix::unistd::Pid;
use palpate_core::Vec3;
use palpate_hil::bench::{BenchCommand, BenchRun, Report};
use palpate_hil::fault::FaultKind;
use palpate_hil::hosts::{self, Host, happens_within, is_running};
use palpate_hil::matrix::Ended;
use palpate_host::device::falcon::{Falcon, FalconConfig, Image, UsbFtdi};
use palpate_host::guard::guard_stdin;
use std::process::Command;
use std::time::{Duration, Instant};

/// Commanded force, N; towards the user.
const FORCE_N: Vec3 = [0.0, 0.0, 1.5];
/// Least force at the grip, N.
const FELT_N: f32 = 1.0;
/// Time without a tick after which the guard sets zero force here, ms. It is longer than the product's limit,
/// because the guest's clock is not real time and the virtual machine stops for longer than that limit.
const LIMIT_MS: u32 = 250;
/// How often to start a host until it renders a force.
const MAX_TRIES: usize = 3;
/// How long the force must stay zero at each check.
const ZERO_HOLD: Duration = Duration::from_millis(500);
/// Number of words of the synthetic firmware.
const FIRMWARE_WORDS: u16 = 500;

/// Main function of a host process.
pub(crate) fn host() -> Outcome<()> {
    let image = Image::synthetic(FIRMWARE_WORDS);
    let device = Falcon::open(FalconConfig::default(), Some(&image)).map_err(|error| error.to_string())?;
    hosts::host(device, this("guard")?, LIMIT_MS, FORCE_N)
}

/// Main function of its guard.
pub(crate) fn guard() -> Outcome<()> {
    guard_stdin().map(drop).map_err(|error| error.to_string())
}

fn this(word: &str) -> Outcome<Command> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut command = Command::new(program);
    command.arg(word);
    Ok(command)
}

/// Runs each fault once.
pub(crate) fn killed_hosts(line: &str) -> Outcome<()> {
    let start = Instant::now();
    let mut line = Line::open(line)?;
    let all = FaultKind::PROCESSES;
    let mut failed = 0;
    for fault in all {
        match killed_host(&mut line, fault) {
            Ok(Report { largest_n, step_n, zero_ms, .. }) => {
                let is_host = matches!(fault, FaultKind::HostKilled | FaultKind::HostPaused);
                let ended = if is_host { Ended::Guard } else { Ended::Host };
                let fault = Some(fault);
                let run = BenchRun { fault, ended, largest_n, step_n, zero_ms, ..BenchRun::default() };
                println!("host PASS {}", json(&run));
            }
            Err(reason) => {
                failed += 1;
                println!("host FAIL {fault} {reason}");
            }
        }
    }
    let word = if failed == 0 { "PASS" } else { "FAIL" };
    println!("hosts {word} runs={} failed={failed} seconds={:.1}", all.len(), start.elapsed().as_secs_f64());
    Ok(())
}

/// Starts a host and its guard, and waits until the force is on the motors.
fn held(line: &mut Line) -> Outcome<(Host, Pid)> {
    line.command(BenchCommand::Plug { seed: 0 })?;
    if !happens_within(hosts::MAX_WAIT, || UsbFtdi::open().is_ok()) {
        return Err("no Falcon on the bus".into());
    }
    let host = Host::start(this("host")?);
    let guard = host.guard().ok_or("the host has not named its guard")?;
    let mut violation = None;
    let is_felt = |report: Report| report.push_n > FELT_N;
    // A broken line ends the wait.
    let mut has_force =
        || line.report().map(is_felt).map_err(|error| violation = Some(error)).unwrap_or(true);
    let held = host.hold(|time| happens_within(time, &mut has_force));
    violation.map_or(Ok(()), Err)?;
    held?;
    Ok((host, guard))
}

fn killed_host(line: &mut Line, fault: FaultKind) -> Outcome<Report> {
    let mut tried = 1;
    let (mut host, guard) = loop {
        match held(line) {
            Ok(held) => break held,
            // No fault was injected yet: a failure here is due to the machine unless it repeats.
            Err(reason) if tried < MAX_TRIES => println!("again {fault}, try {tried}: {reason}"),
            Err(reason) => return Err(reason),
        }
        tried += 1;
    };
    line.command(BenchCommand::ResetRecord)?;
    line.command(BenchCommand::Inject)?;
    let is_host = matches!(fault, FaultKind::HostKilled | FaultKind::HostPaused);
    let process = if is_host { host.pid() } else { guard };
    hosts::send(process, hosts::signal(fault)).map_err(|error| error.to_string())?;
    let since = Instant::now();
    let zeroed = loop {
        let report = line.report()?;
        if report.force_n == 0.0 {
            break report;
        }
        if since.elapsed() > hosts::MAX_WAIT {
            return Err(format!("{} N after a process is lost", report.force_n));
        }
    };
    if zeroed.largest_n <= FELT_N {
        return Err("no force before the fault".into());
    }
    stays_zero(line)?;
    let certain = |what: &str, happens: bool| if happens { Ok(()) } else { Err(what.to_owned()) };
    match fault {
        FaultKind::HostKilled => {}
        FaultKind::GuardKilled => certain("the host has failed", host.end())?,
        _ => {
            // A host that resumes sends its force as before; under a stopped guard it has gone on doing so.
            hosts::send(process, Signal::SIGCONT).map_err(|error| error.to_string())?;
            certain(
                "the host has not reported that it was zeroed",
                happens_within(hosts::MAX_WAIT, || host.has_printed("zeroed")),
            )?;
            stays_zero(line)?;
        }
    }
    drop(host);
    certain("the guard does not end", happens_within(hosts::MAX_WAIT, || !is_running(guard)))?;
    stays_zero(line)?;
    Ok(zeroed)
}

fn stays_zero(line: &mut Line) -> Outcome<()> {
    line.command(BenchCommand::ResetRecord)?;
    std::thread::sleep(ZERO_HOLD);
    let report = line.report()?;
    if report.largest_n == 0.0 && report.force_n == 0.0 {
        return Ok(());
    }
    Err(format!("{} N returned", report.largest_n))
}
