//! Hosts in the guest that are killed and stopped while they hold a force, and what their supervisor makes of it on a real bus.

use crate::Outcome;
use crate::line::Line;
use nix::sys::signal::Signal;
use nix::unistd::Pid;
use palpate_core::Vec3;
use palpate_hil::bench::{Order, Report};
use palpate_hil::hosts::{self, Host, comes, is_running};
use palpate_hil::matrix::Wrong;
use palpate_host::device::falcon::{Falcon, FalconConfig, Image, UsbFtdi};
use std::process::Command;
use std::time::{Duration, Instant};

/// What the host asks for, N; towards the user.
const FORCE_N: Vec3 = [0.0, 0.0, 1.5];
/// What of it must be felt, N.
const FELT_N: f32 = 1.0;
/// Silence after which the supervisor takes the force away here, ms: longer than the product's, for the time of this machine is not real, and it stands
/// still itself for longer than that.
const LIMIT_MS: u32 = 250;
/// How often a host is brought up before it is a failure that none holds a force.
const TRIES: usize = 3;
/// How long nothing must be felt, at each look.
const STAYS: Duration = Duration::from_millis(500);
/// Words of the firmware, which is none.
const FIRMWARE_WORDS: u16 = 500;

/// The life of a host process.
pub(crate) fn host() -> Outcome<()> {
    hosts::host(this("supervise")?, LIMIT_MS, true, FORCE_N)
}

/// The life of its supervisor.
pub(crate) fn supervise() -> Outcome<()> {
    let image = Image::synthetic(FIRMWARE_WORDS);
    hosts::supervise(|| {
        Falcon::open(FalconConfig::default(), Some(&image)).map_err(|error| error.to_string())
    })
}

fn this(word: &str) -> Outcome<Command> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut command = Command::new(program);
    command.arg(word);
    Ok(command)
}

/// Each of them once.
pub(crate) fn orphans(line: &str) -> Outcome<()> {
    let begun = Instant::now();
    let mut line = Line::open(line)?;
    let all = [Wrong::HostKilled, Wrong::HostPaused];
    let mut failed = 0;
    for wrong in all {
        let name = wrong.name();
        match orphan(&mut line, wrong) {
            Ok(Report { largest_n, step_n, zero_ms, .. }) => {
                let zero_ms = zero_ms.map_or_else(|| "-".into(), |ms| format!("{ms:.1}"));
                println!(
                    "host fault={name} end=supervisor largest_n={largest_n:.2} step_n={step_n:.2} zero_ms={zero_ms} PASS"
                );
            }
            Err(reason) => {
                failed += 1;
                println!("host fault={name} FAIL {reason}");
            }
        }
    }
    let word = if failed == 0 { "PASS" } else { "FAIL" };
    println!("hosts {word} runs={} failed={failed} seconds={:.1}", all.len(), begun.elapsed().as_secs_f64());
    Ok(())
}

/// A host whose force is on the motors, and its supervisor.
fn held(line: &mut Line) -> Outcome<(Host, Pid)> {
    line.order(Order::Plug { seed: 0 })?;
    if !comes(hosts::CERTAIN, || UsbFtdi::open().is_ok()) {
        return Err("no Falcon on the bus".into());
    }
    let host = Host::start(this("host")?);
    let supervisor = host.supervisor().ok_or("no word of the supervisor")?;
    let mut broken = None;
    let is_felt = |report: Report| report.push_n > FELT_N;
    // A line that is broken needs no more looks.
    let mut look = || line.report().map(is_felt).map_err(|error| broken = Some(error)).unwrap_or(true);
    let held = host.hold(|time| comes(time, &mut look));
    broken.map_or(Ok(()), Err)?;
    held?;
    Ok((host, supervisor))
}

fn orphan(line: &mut Line, wrong: Wrong) -> Outcome<Report> {
    let mut tried = 1;
    let (host, supervisor) = loop {
        match held(line) {
            Ok(held) => break held,
            // Nothing was done to it yet: the machine's doing, if it does not happen each time.
            Err(reason) if tried < TRIES => println!("host fault={} tried {tried}: {reason}", wrong.name()),
            Err(reason) => return Err(reason),
        }
        tried += 1;
    };
    line.order(Order::Forget)?;
    line.order(Order::Strike)?;
    host.signal(hosts::signal(wrong));
    let since = Instant::now();
    let zeroed = loop {
        let report = line.report()?;
        if report.force_n == 0.0 {
            break report;
        }
        if since.elapsed() > hosts::CERTAIN {
            return Err(format!("{} N, and the host is gone", report.force_n));
        }
    };
    if zeroed.largest_n <= FELT_N {
        return Err("there was no force to take away".into());
    }
    stays_zero(line)?;
    let ends = |supervisor| {
        if comes(hosts::CERTAIN, || !is_running(supervisor)) {
            Ok(())
        } else {
            Err("no end of the supervisor")
        }
    };
    if wrong == Wrong::HostKilled {
        ends(supervisor)?;
    } else {
        // It goes on with its force as if nothing had been.
        host.signal(Signal::SIGCONT);
        if !comes(hosts::CERTAIN, || host.said("zeroed")) {
            return Err("no word that it was zeroed".into());
        }
        stays_zero(line)?;
    }
    drop(host);
    ends(supervisor)?;
    stays_zero(line)?;
    Ok(zeroed)
}

fn stays_zero(line: &mut Line) -> Outcome<()> {
    line.order(Order::Forget)?;
    std::thread::sleep(STAYS);
    let report = line.report()?;
    if report.largest_n == 0.0 && report.force_n == 0.0 {
        return Ok(());
    }
    Err(format!("{} N came back", report.largest_n))
}
