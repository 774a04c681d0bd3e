//! Checks of this user's rights: real-time priority and locked memory; and of swap space.

use super::Check;
use super::Verdict;
use super::Verdict::{Better, Good};
use super::probe::{CAP_IPC_LOCK, CAP_SYS_NICE, Probe};

/// Locked memory for a session with a large organ and the window, bytes.
const ENOUGH_MEMORY: u64 = 1 << 30;

const LIMITS: [&str; 3] = [
    "$ cp host/deploy/palpate-limits.conf /etc/security/limits.d/palpate.conf",
    "$ groupadd -f realtime && usermod -aG realtime USER",
    "then log in again (a service sets LimitRTPRIO and LimitMEMLOCK instead)",
];

pub(super) fn priority(probe: &Probe, fifo_priority: i32) -> Check {
    const NAME: &str = "priority";
    let limit = probe.limit("Max realtime priority");
    if probe.has_capability(CAP_SYS_NICE) {
        return Check::new(NAME, Good, "CAP_SYS_NICE: SCHED_FIFO of any priority");
    }
    let Some(limit) = limit else { return Check::unknown(NAME, "/proc/self/limits") };
    // The priority of the guard is one above the loop's.
    let guard_priority = u64::from(fifo_priority.unsigned_abs()) + 1;
    if limit >= guard_priority {
        return Check::new(
            NAME,
            Good,
            format!("SCHED_FIFO up to {limit}; the loop requests {fifo_priority}"),
        );
    }
    let found =
        format!("SCHED_FIFO up to {limit}; loop and guard request {fifo_priority} and {guard_priority}");
    Check::new(NAME, Verdict::Bad, found)
        .fix(["without it any other process of the PC can delay the loop:"])
        .fix(LIMITS)
}

/// Whether the process may lock all its memory.
fn may_lock(probe: &Probe) -> Option<bool> {
    if probe.has_capability(CAP_IPC_LOCK) {
        return Some(true);
    }
    probe.limit("Max locked memory").map(|limit| limit >= ENOUGH_MEMORY)
}

pub(super) fn memory(probe: &Probe) -> Check {
    const NAME: &str = "memory";
    match (may_lock(probe), probe.limit("Max locked memory")) {
        (None, _) | (_, None) => Check::unknown(NAME, "/proc/self/limits"),
        (Some(true), Some(u64::MAX)) => Check::new(NAME, Good, "may be locked without limit"),
        (Some(true), Some(limit)) => {
            Check::new(NAME, Good, format!("may be locked (limit {} MB, or CAP_IPC_LOCK)", limit >> 20))
        }
        (Some(false), Some(limit)) => {
            let found = format!("{} kB may be locked; a swapped page costs milliseconds", limit >> 10);
            Check::new(NAME, Better, found).fix(LIMITS)
        }
    }
}

pub(super) fn swap(probe: &Probe) -> Check {
    const NAME: &str = "swap";
    const PATH: &str = "/proc/swaps";
    let Some(swaps) = probe.read(PATH) else { return Check::unknown(NAME, PATH) };
    let areas = swaps.lines().skip(1).filter(|line| !line.trim().is_empty()).count();
    match (areas, may_lock(probe)) {
        (0, _) => Check::new(NAME, Good, "none"),
        (_, Some(true)) => Check::new(NAME, Good, format!("{areas} in use, and the loop's memory is locked")),
        _ => Check::new(NAME, Better, format!("{areas} in use and memory cannot be locked"))
            .fix(["lock the memory (above), or", "$ swapoff -a"]),
    }
}
