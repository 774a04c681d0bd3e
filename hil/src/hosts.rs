//! Hosts that are killed and hosts that stand still: real processes, with a real supervisor where the product has one, on emulated devices, in
//! real time.
//!
//! ```text
//! Stage (this process): emulated device <- pty | socket <- supervisor process <- socket pair <- host process: a loop that asks for a force
//!   |---------------------------------- signals, words ---------------------------------------------|
//!                       emulated device of the link, with a watchdog <- pty <----------------- host process
//! ```
//!
//! A host process says where it is, a line each: `supervisor PID`, `holds`, `zeroed`, `end KIND`. It takes the words `hold`, from when on it resets
//! nothing by itself until `again` (to which it says so), and `reset`.

mod host;
mod process;
mod stage;

pub use host::{CERTAIN, Host, comes, is_running, wait};
pub use process::{Device, Role, host, process, supervise};
pub use stage::{Seen, Stage};

use crate::fault::split_mix;
use crate::matrix::{Ended, Run, Wrong};
use nix::sys::signal::Signal;
use palpate_core::{Vec3, vec3};
use std::path::Path;
use std::time::Duration;

/// Longest time to zero of a single run on a busy machine; the target is 20 ms, for the median. Of a supervisor with a longer limit of silence, too.
pub const GENEROUS: Duration = Duration::from_millis(500);

/// Longest median of the times to zero, of each device.
pub const TARGET: Duration = Duration::from_millis(20);

/// How long it must stay at zero.
const STAYS: Duration = Duration::from_millis(150);
/// The same while a host goes on with its force.
const STAYS_ASKED: Duration = Duration::from_millis(300);

/// How often a run is begun before it is a failed one.
const TRIES: usize = 2;

/// How a host is taken away.
#[must_use]
pub const fn signal(wrong: Wrong) -> Signal {
    if matches!(wrong, Wrong::HostKilled) { Signal::SIGKILL } else { Signal::SIGSTOP }
}

/// One run: a host with a force on a device, then the signal. What does not come, and which host cannot be brought up at all, is a run that
/// [`Ended::Missed`] something.
///
/// `program` is `palpate-hil`, of which the processes are made; `limit_ms` the silence after which a supervisor takes the force away: the product's
/// [`DEFAULT_LIMIT_MS`](palpate_host::supervisor::DEFAULT_LIMIT_MS), or more where a machine that stands still itself must not be taken for a host that does.
///
/// # Panics
///
/// If `program` does not start.
#[must_use]
pub fn run(program: &Path, limit_ms: u32, device: Device, wrong: Wrong, seed: u64) -> Run {
    let mut run = Run::with_nothing(device.name(), wrong, seed, device.profile().max_force_n);
    for _ in 0..TRIES {
        match attempt(program, limit_ms, device, &mut run) {
            Ok(()) => break,
            Err(Missing { what, is_staged }) => {
                run.ended = Ended::Missed(what);
                if is_staged {
                    break;
                }
            }
        }
    }
    run
}

/// What did not come in [`CERTAIN`].
struct Missing {
    what: &'static str,
    /// The signal was sent: this is a finding, and not to be tried again.
    is_staged: bool,
}

fn attempt(program: &Path, limit_ms: u32, device: Device, run: &mut Run) -> Result<(), Missing> {
    let draw = |what: u64, low: u64, high: u64| low + split_mix(run.seed, what) % (high - low + 1);
    let component = |what| 0.1 * draw(what, 0, 30) as f32 - 1.5;
    let force_n: Vec3 = [component(1), component(2), 0.5 + 0.1 * draw(3, 0, 15) as f32];
    let stage = Stage::new(device);
    let host = stage.host(program, Role::Host, limit_ms, force_n);
    let unstaged = |what| Missing { what, is_staged: false };
    stage.hold(&host, force_n).map_err(unstaged)?;
    let supervisor = if device.is_supervised() {
        Some(host.supervisor().ok_or(unstaged("no word of the supervisor"))?)
    } else {
        None
    };
    std::thread::sleep(Duration::from_millis(draw(4, 0, 40)));
    if host.said("zeroed") {
        // The machine's doing, and not what is measured.
        host.release().and_then(|()| stage.hold(&host, force_n)).map_err(unstaged)?;
    }
    // A force ends with its validity where the machine stands still, and comes back with the next request.
    let forced = || {
        stage.forget();
        stage.felt().largest_force_n > 0.0
    };
    if !comes(CERTAIN, forced) {
        return Err(unstaged("no force to be taken away"));
    }
    let then_ms = draw(5, 0, 100);
    let certain = |what, happens: bool| {
        if happens { Ok(()) } else { Err(Missing { what, is_staged: true }) }
    };
    host.signal(signal(run.wrong));
    certain("no zero", comes(CERTAIN, || stage.seen().force_n == vec3::ZERO))?;
    run.zero_us = stage.seen().zero_after_us();
    run.ended = Ended::Supervisor;
    if supervisor.is_none() {
        // A force that ends because nobody asks for it again may come back with the next request: only the latch is an end.
        certain("no latch by the device's watchdog", comes(CERTAIN, || stage.seen().latched_us.is_some()))?;
        run.ended = Ended::Watchdog;
        run.detected_us = stage.seen().latch_after_us();
    }
    if run.wrong == Wrong::HostKilled {
        if let Some(supervisor) = supervisor {
            certain("no end of the supervisor", comes(CERTAIN, || !is_running(supervisor)))?;
        }
        run.resumed = !stage.is_zero_for(STAYS);
    } else {
        std::thread::sleep(Duration::from_millis(then_ms));
        run.resumed = !stage.is_zero_for(STAYS);
        // It goes on with its force as if nothing had been.
        host.signal(Signal::SIGCONT);
        certain("no word that it was zeroed", comes(CERTAIN, || host.said("zeroed")))?;
        run.resumed |= !stage.is_zero_for(STAYS_ASKED);
        run.resumed |= supervisor.is_none() && stage.seen().latched_us.is_none();
    }
    let felt = stage.felt();
    (run.largest_n, run.step_n) = (felt.largest_force_n, felt.largest_step_n);
    Ok(())
}

/// So many runs, over all devices and both signals in turn, one after the other: they measure time.
#[must_use]
pub fn runs(program: &Path, limit_ms: u32, count: usize, seed: u64) -> Vec<Run> {
    let cells = Device::ALL.map(|device| [Wrong::HostKilled, Wrong::HostPaused].map(|wrong| (device, wrong)));
    let cells = cells.iter().flatten().cycle().take(count);
    cells
        .enumerate()
        .map(|(index, (device, wrong))| {
            run(program, limit_ms, *device, *wrong, split_mix(!seed, index as u64))
        })
        .collect()
}

/// From the last request with a force until there was none and none could come back.
#[must_use]
pub fn safe_after(run: &Run) -> Option<Duration> {
    Some(Duration::from_micros(run.zero_us?.max(run.detected_us.unwrap_or(0))))
}

/// For each device that has any the middle one of [`safe_after`].
#[must_use]
pub fn medians(runs: &[Run]) -> Vec<(Device, Duration)> {
    let median = |device: Device| {
        let of_device = runs.iter().filter(|run| run.rig == device.name());
        let mut times: Vec<Duration> = of_device.filter_map(safe_after).collect();
        times.sort_unstable();
        times.get(times.len() / 2).map(|time| (device, *time))
    };
    Device::ALL.into_iter().filter_map(median).collect()
}
