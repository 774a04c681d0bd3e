//! Operating-system requests of the haptic thread: locked memory, SCHED_FIFO, affinity, timer slack, absolute sleep.
//!
//! The only module of this crate that may contain `unsafe`. Every request is best effort: the loop runs without any of
//! them, later and less evenly, so each answer is kept and shown instead of turning into an error.
#![allow(unsafe_code)]

use core::fmt;

/// Priority asked for by default: above ordinary threads and most kernel threads, well below the watchdog's 99.
pub const DEFAULT_FIFO_PRIORITY: i32 = 50;

/// What the haptic thread asks of the operating system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RtRequest {
    /// Keep every page of the process in memory (a page fault costs more than a tick).
    pub lock_memory: bool,
    /// SCHED_FIFO priority, 1..=99; 49..=80 is sensible.
    pub fifo_priority: Option<i32>,
    /// Pin the thread to this CPU.
    pub cpu: Option<usize>,
}

impl Default for RtRequest {
    fn default() -> Self {
        Self { lock_memory: true, fifo_priority: Some(DEFAULT_FIFO_PRIORITY), cpu: None }
    }
}

impl RtRequest {
    /// Asks for nothing: for tests and for machines shared with others.
    #[must_use]
    pub const fn nothing() -> Self {
        Self { lock_memory: false, fifo_priority: None, cpu: None }
    }
}

/// Answer to one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The caller did not want it.
    NotAsked,
    /// Done, and read back where the system allows it.
    Granted,
    /// Refused with this OS code; the advice says how to mend it.
    Refused {
        /// `errno` of the call, 0 where the platform has no such call.
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
            Self::NotAsked => f.write_str("not asked"),
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

/// Which requests were granted, and the policy read back from the kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RtReport {
    /// Locked memory.
    pub memory: Outcome,
    /// SCHED_FIFO.
    pub scheduler: Outcome,
    /// CPU pinning.
    pub affinity: Outcome,
    /// Timer slack of 1 ns instead of 50 us: matters when SCHED_FIFO is refused.
    pub timer_slack: Outcome,
    /// Policy of the thread after the requests.
    pub policy: Policy,
}

impl fmt::Display for RtReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "scheduler    {} (runs as {})", self.scheduler, self.policy)?;
        writeln!(f, "memory lock  {}", self.memory)?;
        writeln!(f, "CPU pinning  {}", self.affinity)?;
        write!(f, "timer slack  {}", self.timer_slack)
    }
}

/// Makes the requests for the calling thread; memory is locked for as long as the guard lives.
#[must_use]
pub fn enter_real_time(request: &RtRequest) -> (RtReport, MemoryLock) {
    let memory = platform::lock_memory(request.lock_memory);
    let affinity = request.cpu.map_or(Outcome::NotAsked, platform::pin_to_cpu);
    let scheduler = request.fifo_priority.map_or(Outcome::NotAsked, platform::set_fifo);
    let timer_slack = platform::shorten_timer_slack();
    let report = RtReport { memory, scheduler, affinity, timer_slack, policy: platform::current_policy() };
    (report, MemoryLock { held: memory.is_granted() })
}

/// Unlocks the process memory when dropped.
///
/// The lock is process-wide, and the work after a session (reports, plots) must not have to keep every page resident.
#[derive(Debug)]
pub struct MemoryLock {
    held: bool,
}

impl Drop for MemoryLock {
    fn drop(&mut self) {
        if self.held {
            platform::unlock_memory();
        }
    }
}

pub use platform::{monotonic_ns, sleep_until_ns};

#[cfg(target_os = "linux")]
mod platform {
    use super::{Outcome, Policy};
    use nix::errno::Errno;
    use nix::libc;
    use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
    use nix::sys::mman::{MlockAllFlags, mlockall, munlockall};
    use nix::sys::resource::{Resource, getrlimit};
    use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};
    use nix::unistd::Pid;

    const CALLING_THREAD: Pid = Pid::from_raw(0);

    fn refused(errno: Errno, advice: &'static str) -> Outcome {
        Outcome::Refused { os_code: errno as i32, advice }
    }

    fn is_root() -> bool {
        // SAFETY: geteuid takes nothing, cannot fail and touches no memory of ours.
        unsafe { libc::geteuid() == 0 }
    }

    /// Locks present pages, and future ones where no finite limit applies.
    ///
    /// With a finite RLIMIT_MEMLOCK, MCL_FUTURE would make a later allocation of the viewer fail, which aborts the
    /// process: worse than a page fault. So an ordinary user gets the present pages only.
    pub(super) fn lock_memory(wanted: bool) -> Outcome {
        if !wanted {
            return Outcome::NotAsked;
        }
        let unlimited =
            getrlimit(Resource::RLIMIT_MEMLOCK).is_ok_and(|(soft, _)| soft == libc::RLIM_INFINITY);
        let flags = if unlimited || is_root() {
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
        // Failure only means that pages stay resident until the process ends.
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
        // RESET_ON_FORK: a thread started from this one must not silently run as FIFO too.
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
        // SAFETY: `parameters` is a valid place for the answer and outlives the call.
        let answer = unsafe { libc::sched_getparam(0, &mut parameters) };
        match (answer, policy) {
            (0, libc::SCHED_FIFO) => Policy::Fifo(parameters.sched_priority),
            (0, libc::SCHED_RR) => Policy::RoundRobin(parameters.sched_priority),
            _ => Policy::Other,
        }
    }

    pub(super) fn shorten_timer_slack() -> Outcome {
        // SAFETY: PR_SET_TIMERSLACK takes one integer and touches the calling thread only.
        match unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1 as libc::c_ulong) } {
            0 => Outcome::Granted,
            _ => refused(Errno::last(), "needs a Linux kernel with PR_SET_TIMERSLACK"),
        }
    }

    /// CLOCK_MONOTONIC in nanoseconds.
    #[must_use]
    pub fn monotonic_ns() -> u64 {
        let time = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("CLOCK_MONOTONIC exists on every Linux");
        time.tv_sec() as u64 * 1_000_000_000 + time.tv_nsec() as u64
    }

    /// Sleeps until an absolute CLOCK_MONOTONIC time; returns at once if it has passed.
    ///
    /// Absolute, so that a late wake-up does not shift the deadlines after it, and an interrupted sleep just resumes.
    pub fn sleep_until_ns(deadline_ns: u64) {
        let request = nix::sys::time::TimeSpec::new(
            (deadline_ns / 1_000_000_000) as libc::time_t,
            (deadline_ns % 1_000_000_000) as libc::c_long,
        );
        while let Err(Errno::EINTR) =
            clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &request)
        {}
    }
}

#[cfg(not(target_os = "linux"))]
mod platform {
    //! Elsewhere the loop runs as an ordinary thread with relative sleeps: good for a demonstration, not for a device.
    use super::{Outcome, Policy};
    use std::sync::OnceLock;
    use std::time::{Duration, Instant};

    const UNSUPPORTED: Outcome = Outcome::Refused { os_code: 0, advice: "only built for Linux so far" };

    pub(super) fn lock_memory(wanted: bool) -> Outcome {
        if wanted { UNSUPPORTED } else { Outcome::NotAsked }
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

    /// Nanoseconds since the first call.
    #[must_use]
    pub fn monotonic_ns() -> u64 {
        static START: OnceLock<Instant> = OnceLock::new();
        START.get_or_init(Instant::now).elapsed().as_nanos() as u64
    }

    /// Sleeps until a time of [`monotonic_ns`].
    pub fn sleep_until_ns(deadline_ns: u64) {
        std::thread::sleep(Duration::from_nanos(deadline_ns.saturating_sub(monotonic_ns())));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_asked_nothing_granted() {
        std::thread::spawn(|| {
            let (report, _lock) = enter_real_time(&RtRequest::nothing());
            assert_eq!(report.memory, Outcome::NotAsked);
            assert_eq!(report.scheduler, Outcome::NotAsked);
            assert_eq!(report.affinity, Outcome::NotAsked);
        })
        .join()
        .expect("the thread ends");
    }

    /// Whatever the rights of this user, the report and the kernel must agree.
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
            let request = RtRequest { lock_memory: false, fifo_priority: Some(1000), cpu: Some(1_000_000) };
            let (report, _lock) = enter_real_time(&request);
            assert!(!report.scheduler.is_granted() && !report.affinity.is_granted());
            let text = report.to_string();
            assert!(text.contains("rtprio") && text.contains("taskset"), "{text}");
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
