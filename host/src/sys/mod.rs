//! System calls. Real-time requests of the haptic thread: locked memory, SCHED_FIFO, affinity, timer slack, CPUs
//! kept awake, absolute sleep. For the guard: shared memory, descriptors of processes and USB devices.
//!
//! This is the only module of the crate that may contain `unsafe`. Every real-time request is best effort:
//! without it the loop runs with more latency and jitter. So each outcome is reported instead of becoming an
//! error.
#![allow(unsafe_code)]

use core::fmt;
use std::fs::File;

/// Default priority: above ordinary threads and most kernel threads, well below the 99 of the kernel's
/// watchdog.
pub const DEFAULT_FIFO_PRIORITY: i32 = 50;

/// Highest priority of a haptic loop: its guard uses the next one, and 99 belongs to the kernel.
pub const MAX_LOOP_FIFO_PRIORITY: i32 = 97;

/// Real-time requests of the haptic thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RtRequest {
    /// Lock all pages of the process in memory (a page fault takes longer than a tick).
    pub lock_memory: bool,
    /// SCHED_FIFO priority, 1..=97 ([`MAX_LOOP_FIFO_PRIORITY`]); 49..=80 is sensible.
    pub fifo_priority: Option<i32>,
    /// Pin the thread to this CPU.
    pub cpu: Option<usize>,
    /// Keep CPUs out of sleep states with a long exit latency.
    pub keep_awake: bool,
}

impl Default for RtRequest {
    fn default() -> Self {
        Self { lock_memory: true, fifo_priority: Some(DEFAULT_FIFO_PRIORITY), cpu: None, keep_awake: true }
    }
}

impl RtRequest {
    /// No requests: for tests and for shared machines.
    #[must_use]
    pub const fn none() -> Self {
        Self { lock_memory: false, fifo_priority: None, cpu: None, keep_awake: false }
    }
}

/// Outcome of one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The request was not made.
    NotRequested,
    /// Granted, and read back where the system permits it.
    Granted,
    /// Refused with this OS code; the advice is the fix.
    Refused {
        /// `errno` of the call; 0 on a platform without such a call.
        os_code: i32,
        /// What to change on this machine.
        advice: &'static str,
    },
}

impl Outcome {
    /// Whether the request was made and granted.
    #[must_use]
    pub const fn is_granted(self) -> bool {
        matches!(self, Self::Granted)
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotRequested => f.write_str("not asked"),
            Self::Granted => f.write_str("granted"),
            Self::Refused { os_code, advice } => {
                write!(f, "refused ({}): {advice}", std::io::Error::from_raw_os_error(*os_code))
            }
        }
    }
}

/// Scheduling policy of the thread as the kernel reports it afterwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// SCHED_FIFO at this priority.
    Fifo(i32),
    /// SCHED_RR at this priority.
    RoundRobin(i32),
    /// Ordinary time sharing.
    Other,
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fifo(priority) => write!(f, "SCHED_FIFO {priority}"),
            Self::RoundRobin(priority) => write!(f, "SCHED_RR {priority}"),
            Self::Other => f.write_str("SCHED_OTHER"),
        }
    }
}

/// Outcomes of all requests, and the policy read back from the kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RtReport {
    /// Locked memory.
    pub memory: Outcome,
    /// SCHED_FIFO.
    pub scheduler: Outcome,
    /// CPU pinning.
    pub affinity: Outcome,
    /// The CPU of the pinning, if granted.
    pub cpu: Option<usize>,
    /// CPUs kept out of deep sleep.
    pub awake: Outcome,
    /// Timer slack of 1 ns instead of 50 us; it matters without SCHED_FIFO.
    pub timer_slack: Outcome,
    /// Policy of the thread after the requests.
    pub policy: Policy,
}

impl fmt::Display for RtReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "scheduler    {} (runs as {})", self.scheduler, self.policy)?;
        writeln!(f, "memory lock  {}", self.memory)?;
        match self.cpu {
            Some(cpu) => writeln!(f, "CPU pinning  {} (CPU {cpu})", self.affinity)?,
            None => writeln!(f, "CPU pinning  {}", self.affinity)?,
        }
        writeln!(f, "CPUs awake   {}", self.awake)?;
        write!(f, "timer slack  {}", self.timer_slack)
    }
}

impl RtReport {
    /// The report in one line, for the start of a session.
    #[must_use]
    pub fn line(&self) -> String {
        let mut line = format!("haptic thread: {}", self.policy);
        if let Some(cpu) = self.cpu {
            line.push_str(&format!(", CPU {cpu}"));
        }
        let outcomes = [
            ("SCHED_FIFO", self.scheduler),
            ("memory lock", self.memory),
            ("CPU pinning", self.affinity),
            ("CPUs awake", self.awake),
        ];
        let named = |filter: fn(&Outcome) -> bool| -> String {
            let names = outcomes.iter().filter(|(_, outcome)| filter(outcome)).map(|(name, _)| *name);
            names.collect::<Vec<_>>().join(", ")
        };
        let granted = named(|outcome| outcome.is_granted());
        let refused = named(|outcome| matches!(outcome, Outcome::Refused { .. }));
        if !granted.is_empty() {
            line.push_str(&format!("; granted: {granted}"));
        }
        if !refused.is_empty() {
            line.push_str(&format!("; refused: {refused} (palpate doctor says how to fix it)"));
        }
        line
    }
}

/// Makes the requests for the calling thread. The guard keeps the memory locked and the CPUs awake.
#[must_use]
pub fn enter_real_time(request: &RtRequest) -> (RtReport, Held) {
    let memory = platform::lock_memory(request.lock_memory);
    let affinity = request.cpu.map_or(Outcome::NotRequested, platform::pin_to_cpu);
    let scheduler = request.fifo_priority.map_or(Outcome::NotRequested, platform::set_fifo);
    let (awake, awake_file) =
        if request.keep_awake { platform::hold_cpus_awake() } else { (Outcome::NotRequested, None) };
    let timer_slack = platform::shorten_timer_slack();
    let cpu = request.cpu.filter(|_| affinity.is_granted());
    let policy = platform::current_policy();
    let report = RtReport { memory, scheduler, affinity, cpu, awake, timer_slack, policy };
    (report, Held { memory: memory.is_granted(), _awake: awake_file })
}

/// Unlocks the memory and permits CPU sleep when dropped.
///
/// The lock is process-wide, and the work after a session (reports, plots) must not keep all its pages
/// resident.
#[derive(Debug)]
pub struct Held {
    memory: bool,
    _awake: Option<File>,
}

impl Drop for Held {
    fn drop(&mut self) {
        if self.memory {
            platform::unlock_memory();
        }
    }
}

pub(crate) mod latest;
mod linux;
mod process;
mod shared;
mod socket;
pub mod usb;

use linux as platform;
pub use linux::{allowed_cpus, cpu_ns, lower_priority, monotonic_ns, sleep_until_ns, timer_resolution_ns};
pub use process::{
    Ended, FDS, duplicate_non_blocking, outlive_signals, pidfd, receive_fds, send_fds, send_now,
    start_beside, wait_any, wait_exit, wait_readable, write,
};
pub use shared::SharedWords;
pub use socket::listen;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_requests_nothing_is_granted() {
        std::thread::spawn(|| {
            let (report, _lock) = enter_real_time(&RtRequest::none());
            assert_eq!(report.memory, Outcome::NotRequested);
            assert_eq!(report.scheduler, Outcome::NotRequested);
            assert_eq!(report.affinity, Outcome::NotRequested);
        })
        .join()
        .expect("the thread ends");
    }

    /// With any rights of this user, the report and the kernel must agree.
    #[test]
    fn a_granted_priority_is_the_one_read_back() {
        std::thread::spawn(|| {
            let (report, _lock) = enter_real_time(&RtRequest { lock_memory: false, ..RtRequest::default() });
            assert_eq!(report.scheduler.is_granted(), report.policy == Policy::Fifo(DEFAULT_FIFO_PRIORITY));
        })
        .join()
        .expect("the thread ends");
    }

    #[test]
    fn an_impossible_cpu_and_priority_are_refused_with_advice() {
        std::thread::spawn(|| {
            let request = RtRequest { fifo_priority: Some(1000), cpu: Some(1_000_000), ..RtRequest::none() };
            let (report, _lock) = enter_real_time(&request);
            assert!(!report.scheduler.is_granted() && !report.affinity.is_granted());
            let text = report.to_string();
            assert!(text.contains("rtprio") && text.contains("taskset"), "{text}");
            let line = report.line();
            assert!(line.contains("refused: SCHED_FIFO, CPU pinning") && !line.contains("memory"), "{line}");
        })
        .join()
        .expect("the thread ends");
    }

    #[test]
    fn the_sleep_never_ends_early() {
        for ahead_ns in [200_000, 1_000_000] {
            let deadline = monotonic_ns() + ahead_ns;
            sleep_until_ns(deadline);
            assert!(monotonic_ns() >= deadline);
        }
        let before = monotonic_ns();
        sleep_until_ns(before.saturating_sub(1_000_000));
        assert!(monotonic_ns() - before < 500_000_000);
    }
}
