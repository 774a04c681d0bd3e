//! On other systems the loop runs as an ordinary thread with relative sleeps: suitable for a demonstration,
//! not for a device.
use super::{Outcome, Policy};
use std::fs::File;
use std::os::fd::BorrowedFd;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

const UNSUPPORTED: Outcome = Outcome::Refused { os_code: 0, advice: "available on Linux only" };

pub(super) fn lock_memory(requested: bool) -> Outcome {
    if requested { UNSUPPORTED } else { Outcome::NotRequested }
}

pub(super) fn unlock_memory() {}

pub(super) fn pin_to_cpu(_cpu: usize) -> Outcome {
    UNSUPPORTED
}

pub(super) fn set_fifo(_priority: i32) -> Outcome {
    UNSUPPORTED
}

pub(super) fn current_policy() -> Policy {
    Policy::Other
}

pub(super) fn shorten_timer_slack() -> Outcome {
    UNSUPPORTED
}

pub(super) fn hold_cpus_awake() -> (Outcome, Option<File>) {
    (UNSUPPORTED, None)
}

/// Not available on this system.
#[must_use]
pub fn timer_resolution_ns() -> Option<u64> {
    None
}

/// Not available on this system.
#[must_use]
pub fn allowed_cpus() -> Vec<usize> {
    Vec::new()
}

/// Nanoseconds since the first call.
#[must_use]
pub fn monotonic_ns() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64
}

/// Sleeps until a time on the clock of [`monotonic_ns`].
pub fn sleep_until_ns(deadline_ns: u64) {
    std::thread::sleep(Duration::from_nanos(deadline_ns.saturating_sub(monotonic_ns())));
}

/// Waits briefly; the caller then checks for data.
#[must_use]
pub fn wait_readable(_fd: BorrowedFd<'_>, timeout: Duration) -> bool {
    std::thread::sleep(timeout.min(Duration::from_millis(1)));
    true
}
