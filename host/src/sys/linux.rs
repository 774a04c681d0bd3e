//! The real-time requests on Linux.

use super::{Outcome, Policy};
use nix::errno::Errno;
use nix::libc;
use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall, munlockall};
use nix::sys::prctl;
use nix::sys::resource::{Resource, getrlimit};
use nix::time::{ClockId, ClockNanosleepFlags, clock_getres, clock_gettime, clock_nanosleep};
use nix::unistd::{Pid, geteuid};
use std::fs::File;
use std::io::Write;

/// The lowest priority of a thread with ordinary scheduling.
const LOWEST_PRIORITY: i32 = 19;
const CALLING_THREAD: Pid = Pid::from_raw(0);

fn refused(errno: Errno, advice: &'static str) -> Outcome {
    Outcome::Refused { os_code: errno as i32, advice }
}

/// Locks the present pages, and future ones if no finite limit applies.
///
/// With a finite RLIMIT_MEMLOCK, MCL_FUTURE would make a later allocation of the viewer fail and abort the
/// process, which is worse than a page fault. So for an ordinary user only the present pages are locked.
pub(super) fn lock_memory(requested: bool) -> Outcome {
    if !requested {
        return Outcome::NotRequested;
    }
    let unlimited = getrlimit(Resource::RLIMIT_MEMLOCK).is_ok_and(|(soft, _)| soft == libc::RLIM_INFINITY);
    let flags = if unlimited || geteuid().is_root() {
        MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE
    } else {
        MlockAllFlags::MCL_CURRENT
    };
    match mlockall(flags) {
        Ok(()) => Outcome::Granted,
        Err(errno) => refused(errno, "raise memlock in /etc/security/limits.conf (memlock unlimited)"),
    }
}

pub(super) fn unlock_memory() {
    // On failure the pages stay resident until the process ends.
    let _ = munlockall();
}

pub(super) fn pin_to_cpu(cpu: usize) -> Outcome {
    let advice = "choose a CPU this process may use (see taskset -p)";
    let mut set = CpuSet::new();
    if let Err(errno) = set.set(cpu).and_then(|()| sched_setaffinity(CALLING_THREAD, &set)) {
        return refused(errno, advice);
    }
    match sched_getaffinity(CALLING_THREAD).and_then(|set| set.is_set(cpu)) {
        Ok(true) => Outcome::Granted,
        Ok(false) => refused(Errno::EINVAL, advice),
        Err(errno) => refused(errno, advice),
    }
}

pub(super) fn set_fifo(priority: i32) -> Outcome {
    let advice = "raise rtprio in /etc/security/limits.conf (rtprio 80) or give CAP_SYS_NICE";
    let parameters = libc::sched_param { sched_priority: priority };
    // RESET_ON_FORK: a thread started from this one must not run as FIFO unnoticed.
    // SAFETY: `parameters` outlives the call, and pid 0 means the calling thread.
    let answer =
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, &parameters) };
    if answer != 0 {
        return refused(Errno::last(), advice);
    }
    match current_policy() {
        Policy::Fifo(read_back) if read_back == priority => Outcome::Granted,
        _ => refused(Errno::EINVAL, advice),
    }
}

pub(super) fn current_policy() -> Policy {
    // SAFETY: no pointer is passed; pid 0 means the calling thread.
    let policy = unsafe { libc::sched_getscheduler(0) } & !libc::SCHED_RESET_ON_FORK;
    let mut parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: `parameters` is valid for the result and outlives the call.
    let answer = unsafe { libc::sched_getparam(0, &mut parameters) };
    match (answer, policy) {
        (0, libc::SCHED_FIFO) => Policy::Fifo(parameters.sched_priority),
        (0, libc::SCHED_RR) => Policy::RoundRobin(parameters.sched_priority),
        _ => Policy::Other,
    }
}

pub(super) fn shorten_timer_slack() -> Outcome {
    match prctl::set_timerslack(1) {
        Ok(()) => Outcome::Granted,
        Err(errno) => refused(errno, "needs a Linux kernel with PR_SET_TIMERSLACK"),
    }
}

/// Keeps every CPU of the machine out of sleep states with a long exit latency while the file is open.
///
/// Documentation/power/pm_qos_interface.rst: a 32-bit latency in microseconds, in effect until the file is
/// closed.
pub(super) fn hold_cpus_awake() -> (Outcome, Option<File>) {
    let opened = File::options().write(true).open("/dev/cpu_dma_latency");
    match opened.and_then(|mut file| file.write_all(&0_i32.to_ne_bytes()).map(|()| file)) {
        Ok(file) => (Outcome::Granted, Some(file)),
        Err(error) => {
            let os_code = error.raw_os_error().unwrap_or(0);
            let advice = "permit writing to /dev/cpu_dma_latency (host/deploy/72-palpate.rules)";
            (Outcome::Refused { os_code, advice }, None)
        }
    }
}

/// Resolution of the clock that the loop sleeps on: 1 ns with high-resolution timers, otherwise a kernel
/// tick.
#[must_use]
pub fn timer_resolution_ns() -> Option<u64> {
    let resolution = clock_getres(ClockId::CLOCK_MONOTONIC).ok()?;
    Some(resolution.tv_sec() as u64 * 1_000_000_000 + resolution.tv_nsec() as u64)
}

/// CPUs on which the calling thread may run.
#[must_use]
pub fn allowed_cpus() -> Vec<usize> {
    let set = sched_getaffinity(CALLING_THREAD);
    set.map_or_else(
        |_| Vec::new(),
        |set| (0..CpuSet::count()).filter(|cpu| set.is_set(*cpu) == Ok(true)).collect(),
    )
}

/// CLOCK_MONOTONIC in nanoseconds.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let time = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("CLOCK_MONOTONIC exists on every Linux");
    time.tv_sec() as u64 * 1_000_000_000 + time.tv_nsec() as u64
}

/// CPU time of all threads of this process, in nanoseconds.
#[must_use]
pub fn cpu_ns() -> u64 {
    let clock = ClockId::CLOCK_PROCESS_CPUTIME_ID;
    let time = clock_gettime(clock).expect("CLOCK_PROCESS_CPUTIME_ID exists on every Linux");
    time.tv_sec() as u64 * 1_000_000_000 + time.tv_nsec() as u64
}

/// Gives this thread the lowest priority: on a core that it shares it uses the time that others leave.
pub fn lower_priority() {
    // Linux changes the thread that asks; without the change it is only less considerate.
    let _ = rustix::process::setpriority_process(None, LOWEST_PRIORITY);
}

/// Sleeps until an absolute CLOCK_MONOTONIC time; returns at once if it has passed.
///
/// The time is absolute, so a late wake-up does not shift later deadlines, and an interrupted sleep can
/// resume.
pub fn sleep_until_ns(deadline_ns: u64) {
    let request = nix::sys::time::TimeSpec::new(
        (deadline_ns / 1_000_000_000) as libc::time_t,
        (deadline_ns % 1_000_000_000) as libc::c_long,
    );
    while let Err(Errno::EINTR) =
        clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &request)
    {}
}
