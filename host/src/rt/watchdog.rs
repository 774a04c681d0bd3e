//! The watchdog thread: if the haptic loop stalls, it zeroes the device through a second path.
//!
//! ```text
//! loop:      beat -> (fired? send zero, drop the sample) -> exchange -> control
//! watchdog:  no beat for 20 ms? -> count a firing -> zero through the second path, once per limit
//! ```
//!
//! The watchdog reads a counter, not a time. It needs no common clock, and it cannot fire early, because it
//! sees a beat after the beat happened. A loop that resumes finds the firing, sends zero and latches a fault:
//! only reset and arm restore a force. A process that is killed or stopped as a whole has no watchdog either;
//! [`crate::supervisor`] covers that case.

use super::clock::Clock;
use crate::device::EmergencyStop;
use crate::sys::{self, MAX_LOOP_FIFO_PRIORITY, Policy, RtRequest};
use core::sync::atomic::{AtomicU64, Ordering};
use std::io;
use std::thread::{Builder, Scope, ScopedJoinHandle};

/// Default time without a beat after which it fires, ms: twice the age at which a sample becomes a fault.
pub const DEFAULT_LIMIT_MS: u32 = 20;
/// Checks per limit: it fires at most an eighth of the limit late.
const CHECKS_PER_LIMIT: u64 = 8;
/// Time between two attempts to send a zero, ns.
const RETRY_NS: u64 = 1_000_000;
/// Beat count of a loop that has ended.
const ENDED: u64 = u64::MAX;

/// Counters shared by loop and watchdog.
#[derive(Debug, Default)]
pub struct Heartbeat {
    /// Number of ticks started; 0 before the first.
    beats: AtomicU64,
    /// Number of firings of the watchdog.
    fired: AtomicU64,
}

impl Heartbeat {
    /// Called by the loop at the start of every tick with the number of ticks started. Returns the number of
    /// firings so far.
    #[inline]
    pub fn beat(&self, ticks: u64) -> u64 {
        self.beats.store(ticks, Ordering::Release);
        self.fired.load(Ordering::Acquire)
    }

    /// Called when the loop has ended and has stopped the device: the watchdog ends.
    pub fn end(&self) {
        self.beats.store(ENDED, Ordering::Release);
    }

    /// Number of firings of the watchdog.
    #[must_use]
    pub fn fired(&self) -> u64 {
        self.fired.load(Ordering::Acquire)
    }
}

/// Ends the heartbeat when dropped, at the end of a run or while a panic unwinds.
#[derive(Debug)]
pub struct EndOnDrop<'h>(pub Option<&'h Heartbeat>);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        if let Some(heartbeat) = self.0 {
            heartbeat.end();
        }
    }
}

/// The watchdog of one loop. Time is an argument, so that a test can control it.
pub struct Watchdog<'h> {
    heartbeat: &'h Heartbeat,
    path: Box<dyn EmergencyStop>,
    limit_ns: u64,
    beats: u64,
    /// Time at which the current count was first seen.
    since_ns: u64,
    /// Whether it has fired in this stall.
    has_fired: bool,
    /// Time of the last zero sent in this stall.
    zeroed_ns: Option<u64>,
}

impl core::fmt::Debug for Watchdog<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Watchdog").field("limit_ns", &self.limit_ns).finish_non_exhaustive()
    }
}

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WatchdogStatus {
    /// The loop has not started, or beats.
    Alive,
    /// Zero was sent through the second path.
    Zeroed,
    /// Sending zero failed; the next check tries again.
    ZeroFailed,
    /// Stalled, and zeroed less than one limit ago.
    Stalled,
    /// The loop has ended.
    Ended,
}

impl<'h> Watchdog<'h> {
    /// Watches `heartbeat` and zeroes through `path` after `limit_ns` without a beat.
    #[must_use]
    pub fn new(heartbeat: &'h Heartbeat, path: Box<dyn EmergencyStop>, limit_ns: u64) -> Self {
        Self {
            heartbeat,
            path,
            limit_ns: limit_ns.max(CHECKS_PER_LIMIT),
            beats: 0,
            since_ns: 0,
            has_fired: false,
            zeroed_ns: None,
        }
    }

    /// Checks the heartbeat. In a stall it sends zero once per limit, because a zero can be lost on the line.
    pub fn check(&mut self, now_ns: u64) -> WatchdogStatus {
        let beats = self.heartbeat.beats.load(Ordering::Acquire);
        if beats == ENDED {
            return WatchdogStatus::Ended;
        }
        if beats != self.beats || beats == 0 {
            (self.beats, self.since_ns) = (beats, now_ns);
            (self.has_fired, self.zeroed_ns) = (false, None);
            return WatchdogStatus::Alive;
        }
        let quiet_since_ns = self.zeroed_ns.unwrap_or(self.since_ns);
        if now_ns.saturating_sub(quiet_since_ns) < self.limit_ns {
            return if self.zeroed_ns.is_some() { WatchdogStatus::Stalled } else { WatchdogStatus::Alive };
        }
        if !core::mem::replace(&mut self.has_fired, true) {
            // Count before sending the zero: a loop that resumes now must not send its old force after the
            // zero and continue.
            self.heartbeat.fired.fetch_add(1, Ordering::AcqRel);
        }
        match self.path.zero() {
            // A full buffer or a late transfer: the next attempt may succeed.
            Err(error) if error.kind().is_transient() => return WatchdogStatus::ZeroFailed,
            // The device cannot be reached on this path now; the next limit tries again.
            Ok(()) | Err(_) => self.zeroed_ns = Some(now_ns),
        }
        WatchdogStatus::Zeroed
    }

    /// Checks until the loop has ended.
    fn run(mut self, clock: &impl Clock) {
        loop {
            let now_ns = clock.now_ns();
            let pause_ns = match self.check(now_ns) {
                WatchdogStatus::Ended => return,
                WatchdogStatus::ZeroFailed => RETRY_NS.min(self.limit_ns / CHECKS_PER_LIMIT),
                WatchdogStatus::Alive | WatchdogStatus::Zeroed | WatchdogStatus::Stalled => {
                    self.limit_ns / CHECKS_PER_LIMIT
                }
            };
            clock.wait_until(now_ns + pause_ns, 0);
        }
    }
}

/// One above the loop's priority, never 99: a runaway watchdog at 99 would block the kernel's own threads.
fn priority_above(loop_priority: i32) -> i32 {
    loop_priority.min(MAX_LOOP_FIFO_PRIORITY) + 1
}

/// Starts the watchdog on its own thread, one FIFO priority above the loop's (at most 98) if the loop
/// requests one and it is granted: a loop that spins for ever on the same CPU must not block it. Returns the
/// policy of the thread.
pub fn spawn<'scope, C: Clock + Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    watchdog: Watchdog<'scope>,
    clock: C,
    loop_priority: Option<i32>,
) -> io::Result<ScopedJoinHandle<'scope, Policy>> {
    Builder::new().name("palpate-watchdog".into()).spawn_scoped(scope, move || {
        let fifo_priority = loop_priority.map(priority_above);
        let (report, _) = sys::enter_real_time(&RtRequest { fifo_priority, ..RtRequest::none() });
        watchdog.run(&clock);
        report.policy
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{DeviceError, DeviceErrorKind};
    use std::sync::Arc;

    const LIMIT_NS: u64 = 20_000_000;

    struct Counted(Arc<AtomicU64>);

    impl EmergencyStop for Counted {
        fn zero(&mut self) -> Result<(), DeviceError> {
            self.0.fetch_add(1, Ordering::Relaxed);
            Ok(())
        }
    }

    fn watchdog(heartbeat: &Heartbeat) -> (Watchdog<'_>, Arc<AtomicU64>) {
        let zeros = Arc::new(AtomicU64::new(0));
        (Watchdog::new(heartbeat, Box::new(Counted(Arc::clone(&zeros))), LIMIT_NS), zeros)
    }

    #[test]
    fn the_watchdog_does_not_fire_while_the_loop_beats() {
        let heartbeat = Heartbeat::default();
        let (mut watchdog, zeros) = watchdog(&heartbeat);
        // Not started: opening and homing take time.
        assert!((0..1_000).all(|ms| watchdog.check(ms * 1_000_000) == WatchdogStatus::Alive));
        // A beat every 19 ms, a check every 2 ms.
        for ms in 1_000..5_000_u64 {
            heartbeat.beat(ms / 19);
            if ms % 2 == 0 {
                assert_eq!(watchdog.check(ms * 1_000_000), WatchdogStatus::Alive, "{ms}");
            }
        }
        assert_eq!((zeros.load(Ordering::Relaxed), heartbeat.fired()), (0, 0));
    }

    #[test]
    fn a_stall_fires_once_and_sends_zero_once_per_limit_until_a_beat() {
        let heartbeat = Heartbeat::default();
        let (mut watchdog, zeros) = watchdog(&heartbeat);
        heartbeat.beat(7);
        let looks: Vec<WatchdogStatus> = (100..=162).map(|ms| watchdog.check(ms * 1_000_000)).collect();
        let zeroed: Vec<usize> = (0..looks.len()).filter(|i| looks[*i] == WatchdogStatus::Zeroed).collect();
        assert_eq!(zeroed, [20, 40, 60], "not before the limit, then once per limit");
        assert_eq!((zeros.load(Ordering::Relaxed), heartbeat.beat(8)), (3, 1), "one stall is one firing");
        assert_eq!(watchdog.check(163_000_000), WatchdogStatus::Alive);
        assert_eq!(watchdog.check(182_000_000), WatchdogStatus::Alive);
        assert_eq!(watchdog.check(183_000_000), WatchdogStatus::Zeroed);
        assert_eq!(heartbeat.fired(), 2);
        heartbeat.end();
        assert_eq!(watchdog.check(10_000_000_000), WatchdogStatus::Ended);
        assert_eq!(heartbeat.fired(), 2);
    }

    /// A port whose buffer is full: the zero goes as soon as there is room, not one limit later.
    #[test]
    fn a_failed_zero_is_retried_immediately() {
        struct Full(Arc<AtomicU64>);

        impl EmergencyStop for Full {
            fn zero(&mut self) -> Result<(), DeviceError> {
                let tries = self.0.fetch_add(1, Ordering::Relaxed) + 1;
                if tries <= 3 { Err(DeviceError::new(DeviceErrorKind::Timeout)) } else { Ok(()) }
            }
        }

        let (heartbeat, tries) = (Heartbeat::default(), Arc::default());
        let mut watchdog = Watchdog::new(&heartbeat, Box::new(Full(Arc::clone(&tries))), LIMIT_NS);
        heartbeat.beat(7);
        let looks: Vec<WatchdogStatus> = (0..42).map(|ms| watchdog.check(ms * 1_000_000)).collect();
        assert_eq!(
            looks[20..25],
            [
                WatchdogStatus::ZeroFailed,
                WatchdogStatus::ZeroFailed,
                WatchdogStatus::ZeroFailed,
                WatchdogStatus::Zeroed,
                WatchdogStatus::Stalled
            ]
        );
        assert!(looks[..20].iter().all(|look| *look == WatchdogStatus::Alive));
        assert_eq!((tries.load(Ordering::Relaxed), heartbeat.fired()), (4, 1), "one stall is one firing");
    }

    #[test]
    fn its_priority_is_above_every_loop_and_below_the_kernel() {
        assert_eq!([1, 50, MAX_LOOP_FIFO_PRIORITY].map(priority_above), [2, 51, 98]);
        assert_eq!([98, 99, i32::MAX].map(priority_above), [98; 3]);
    }

    /// On real threads: a loop that hangs in its exchange is zeroed, and the thread ends with the heartbeat.
    #[test]
    fn the_thread_zeroes_a_stalled_loop_and_ends_with_it() {
        let heartbeat = Heartbeat::default();
        let (watchdog, zeros) = watchdog(&heartbeat);
        std::thread::scope(|scope| {
            let handle = spawn(scope, watchdog, crate::rt::MonotonicClock, None).expect("a thread starts");
            heartbeat.beat(1);
            // Waits for the event, however long it takes on a busy machine.
            while zeros.load(Ordering::Relaxed) == 0 {
                std::thread::yield_now();
            }
            heartbeat.end();
            assert_eq!(handle.join().expect("it ends"), Policy::Other);
        });
        assert_eq!(heartbeat.fired(), 1);
    }
}
