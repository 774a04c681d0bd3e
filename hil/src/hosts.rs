//! Host processes and their guards that are killed or stopped, on emulated devices in real time.
//!
//! ```text
//! Testbed (this process): emulated device <- pty, socket <- host process
//!   |                                           ^-- duplicate -- guard process
//!   |-------------------- signals, commands, status lines ---------|
//! ```
//!
//! A host process renders a constant force. It prints status lines: `guard PID`, `holds`, `zeroed`, `end KIND`. It reads commands: after `hold` it no longer resets by itself; `again` ends that and is confirmed;
//! `reset` resets once.

mod host;
mod process;
mod testbed;

pub use host::{Host, MAX_WAIT, happens_within, is_running, send, wait};
pub use process::{Device, Role, host, process};
pub use testbed::{Observation, Testbed};

use crate::fault::{FaultKind, split_mix};
use crate::matrix::{Ended, Run};
use nix::sys::signal::Signal;
use palpate_core::Vec3;
use std::path::Path;
use std::time::Duration;

/// Largest median of the times to zero force of a device.
pub const TARGET: Duration = Duration::from_millis(20);

/// How long the force must stay zero.
const ZERO_HOLD: Duration = Duration::from_millis(150);
/// The same while a resumed host sends its force.
const ZERO_HOLD_RESUMED: Duration = Duration::from_millis(300);

/// How often a run is tried before it fails.
const MAX_TRIES: usize = 2;

/// The signal for a fault of a process.
#[must_use]
pub const fn signal(fault: FaultKind) -> Signal {
    if matches!(fault, FaultKind::HostKilled | FaultKind::GuardKilled) {
        Signal::SIGKILL
    } else {
        Signal::SIGSTOP
    }
}

/// One run: brings up a host with a force on a device, then sends the signal. A run in which an expected
/// event does not happen, or whose host cannot be brought up, ends as [`Ended::TimedOut`].
///
/// `program` is `palpate-hil`, which runs the processes. `limit_ms` is the guard's limit: the product's
/// [`DEFAULT_LIMIT_MS`](palpate_host::guard::DEFAULT_LIMIT_MS), or more on a machine that itself stops for
/// longer.
///
/// # Panics
///
/// If `program` does not start.
#[must_use]
pub fn run(program: &Path, limit_ms: u32, role: Role, device: Device, fault: FaultKind, seed: u64) -> Run {
    let mut run = Run::empty(device.name(), fault, seed, device.profile().max_force_n);
    for _ in 0..MAX_TRIES {
        match attempt(program, limit_ms, role, device, &mut run) {
            Ok(()) => break,
            Err(NotObserved { what, after_signal }) => {
                run.ended = Ended::TimedOut(what);
                if after_signal {
                    break;
                }
            }
        }
    }
    run
}

/// An event that did not happen within [`MAX_WAIT`].
struct NotObserved {
    what: &'static str,
    /// It follows the signal: a result, and no reason for another try.
    after_signal: bool,
}

fn attempt(
    program: &Path,
    limit_ms: u32,
    role: Role,
    device: Device,
    run: &mut Run,
) -> Result<(), NotObserved> {
    let draw = |what: u64, low: u64, high: u64| low + split_mix(run.seed, what) % (high - low + 1);
    let component = |what| 0.1 * draw(what, 0, 30) as f32 - 1.5;
    let force_n: Vec3 = [component(1), component(2), 0.5 + 0.1 * draw(3, 0, 15) as f32];
    let testbed = Testbed::new(device);
    let mut host = testbed.host(program, role, limit_ms, force_n);
    let before_signal = |what| NotObserved { what, after_signal: false };
    testbed.hold(&host, force_n).map_err(before_signal)?;
    let guard = match role {
        Role::Host => Some(host.guard().ok_or(before_signal("the host has not named its guard"))?),
        Role::Unguarded => None,
    };
    std::thread::sleep(Duration::from_millis(draw(4, 0, 40)));
    if host.has_printed("zeroed") {
        // A pause of the machine caused this zero, so the run holds again.
        host.release().and_then(|()| testbed.hold(&host, force_n)).map_err(before_signal)?;
    }
    // A force expires when the machine pauses, and returns with the next request.
    let forced = || {
        testbed.reset_record();
        testbed.force_record().largest_force_n > 0.0
    };
    if !happens_within(MAX_WAIT, forced) {
        return Err(before_signal("no force before the fault"));
    }
    let then_ms = draw(5, 0, 100);
    let certain = |what, happens: bool| {
        if happens { Ok(()) } else { Err(NotObserved { what, after_signal: true }) }
    };
    let is_host = matches!(run.fault, FaultKind::HostKilled | FaultKind::HostPaused);
    let process = if is_host { host.pid() } else { guard.ok_or(before_signal("there is no guard"))? };
    testbed.note_signal();
    send(process, signal(run.fault)).map_err(|_| before_signal("the process had ended"))?;
    certain("no zero", happens_within(MAX_WAIT, || testbed.observed().zeroed_since_signal_us().is_some()))?;
    run.zero_us = testbed.observed().zeroed_since_signal_us();
    run.ended = if is_host { Ended::Guard } else { Ended::Host };
    if guard.is_none() {
        // A force that expired without a request may return with the next one. Only the latch is final.
        certain(
            "no latch by the device's watchdog",
            happens_within(MAX_WAIT, || testbed.observed().latched_us.is_some()),
        )?;
        run.ended = Ended::Watchdog;
        run.detected_us = testbed.observed().latch_after_us();
    }
    match run.fault {
        FaultKind::HostKilled => {
            if let Some(guard) = guard {
                certain("the guard does not end", happens_within(MAX_WAIT, || !is_running(guard)))?;
            }
            run.resumed = !testbed.is_zero_for(ZERO_HOLD);
        }
        FaultKind::GuardKilled => {
            certain(
                "the host has not reported that its guard is lost",
                happens_within(MAX_WAIT, || host.has_printed("end GuardLost")),
            )?;
            certain("the host has failed", host.end())?;
            run.resumed = !testbed.is_zero_for(ZERO_HOLD);
        }
        _ => {
            std::thread::sleep(Duration::from_millis(then_ms));
            run.resumed = !testbed.is_zero_for(ZERO_HOLD);
            // A host that resumes sends its force as before; under a stopped guard it has gone on doing so.
            send(process, Signal::SIGCONT).map_err(|_| before_signal("the process had ended"))?;
            certain(
                "the host has not reported that it was zeroed",
                happens_within(MAX_WAIT, || host.has_printed("zeroed")),
            )?;
            run.resumed |= !testbed.is_zero_for(ZERO_HOLD_RESUMED);
            run.resumed |= guard.is_none() && testbed.observed().latched_us.is_none();
        }
    }
    let felt = testbed.force_record();
    (run.largest_n, run.step_n) = (felt.largest_force_n, felt.largest_step_n);
    Ok(())
}

/// Runs `count` runs over all devices and faults of a process in turn. They run one at a time, because they measure
/// times.
#[must_use]
pub fn runs(program: &Path, limit_ms: u32, count: usize, seed: u64) -> Vec<Run> {
    let cells = Device::ALL.map(|device| FaultKind::PROCESSES.map(|fault| (device, fault)));
    let cells = cells.iter().flatten().cycle().take(count);
    cells
        .enumerate()
        .map(|(index, (device, fault))| {
            run(program, limit_ms, Role::Host, *device, *fault, split_mix(!seed, index as u64))
        })
        .collect()
}

/// Time from the loss of the process until the force was zero and could not return.
#[must_use]
pub fn time_to_safe(run: &Run) -> Option<Duration> {
    Some(Duration::from_micros(run.zero_us?.max(run.detected_us.unwrap_or(0))))
}

/// Median of [`time_to_safe`] for each device that has any.
#[must_use]
pub fn medians(runs: &[Run]) -> Vec<(Device, Duration)> {
    let median = |device: Device| {
        let of_device = runs.iter().filter(|run| run.rig == device.name());
        let mut times: Vec<Duration> = of_device.filter_map(time_to_safe).collect();
        times.sort_unstable();
        times.get(times.len() / 2).map(|time| (device, *time))
    };
    Device::ALL.into_iter().filter_map(median).collect()
}
