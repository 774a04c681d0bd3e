//! A second pair of eyes: if the haptic loop stands still, the device is zeroed past it.
//!
//! ```text
//! loop:      beat -> (fired? zero, drop the sample) -> exchange -> control          one store and one load a tick
//! watchdog:  beats the same for 20 ms? -> count a firing -> zero through the device's second path, again and again
//! ```
//!
//! It watches a counter, not a time: it needs no common clock, and it cannot fire early, because it sees a beat after it happened.
//! A loop that comes back finds the firing, sends zero itself and latches a fault: only reset and arm bring a force back.
//! What it cannot do: a process that is killed or stopped as a whole has no watchdog either. That is what [`crate::supervisor`] is for.

use super::clock::Clock;
use crate::device::EmergencyStop;
use crate::sys::{self, MAX_LOOP_FIFO_PRIORITY, Policy, RtRequest};
use core::sync::atomic::{AtomicU64, Ordering};
use std::io;
use std::thread::{Builder, Scope, ScopedJoinHandle};

/// Time without a beat after which it fires, by default, ms: twice the age at which a sample is a fault.
pub const DEFAULT_LIMIT_MS: u32 = 20;
/// Looks within the limit: it fires at the latest an eighth past it.
const LOOKS: u64 = 8;
/// Between two tries to send a zero that did not go, ns.
const RETRY_NS: u64 = 1_000_000;
/// The count of a loop that has ended.
const ENDED: u64 = u64::MAX;

/// What loop and watchdog share.
#[derive(Debug, Default)]
pub struct Heartbeat {
    /// Ticks begun; 0 before the first.
    beats: AtomicU64,
    /// Times the watchdog has fired.
    fired: AtomicU64,
}

impl Heartbeat {
    /// Told by the loop at the start of every tick, with the number of ticks begun. Returns how often the watchdog has fired so far.
    #[inline]
    pub fn beat(&self, ticks: u64) -> u64 {
        self.beats.store(ticks, Ordering::Release);
        self.fired.load(Ordering::Acquire)
    }

    /// The loop has ended and has zeroed the device itself: there is nothing left to watch.
    pub fn end(&self) {
        self.beats.store(ENDED, Ordering::Release);
    }

    /// How often the watchdog has fired.
    #[must_use]
    pub fn fired(&self) -> u64 {
        self.fired.load(Ordering::Acquire)
    }
}

/// Ends the heartbeat when dropped, be it at the end of a run or while a panic unwinds.
#[derive(Debug)]
pub struct EndOnDrop<'h>(pub Option<&'h Heartbeat>);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        if let Some(heartbeat) = self.0 {
            heartbeat.end();
        }
    }
}

/// The watchdog of one loop. Time is an argument, so that a test can turn it.
pub struct Watchdog<'h> {
    heartbeat: &'h Heartbeat,
    path: Box<dyn EmergencyStop>,
    limit_ns: u64,
    beats: u64,
    /// When that count was first seen.
    since_ns: u64,
    /// It has fired in this stall.
    has_fired: bool,
    /// When zero last went in this stall.
    zeroed_ns: Option<u64>,
}

impl core::fmt::Debug for Watchdog<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Watchdog").field("limit_ns", &self.limit_ns).finish_non_exhaustive()
    }
}

/// What a look came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// The loop has not begun, or beats.
    Well,
    /// Zero was sent past the loop.
    Zeroed,
    /// It was to be sent and did not go: it is tried again at once.
    Refused,
    /// Stalled, and zeroed a moment ago.
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
            limit_ns: limit_ns.max(LOOKS),
            beats: 0,
            since_ns: 0,
            has_fired: false,
            zeroed_ns: None,
        }
    }

    /// One look at the heartbeat. In a stall zero is sent once a limit, for one of them may be lost on the line.
    pub fn look(&mut self, now_ns: u64) -> Look {
        let beats = self.heartbeat.beats.load(Ordering::Acquire);
        if beats == ENDED {
            return Look::Ended;
        }
        if beats != self.beats || beats == 0 {
            (self.beats, self.since_ns) = (beats, now_ns);
            (self.has_fired, self.zeroed_ns) = (false, None);
            return Look::Well;
        }
        let quiet_since_ns = self.zeroed_ns.unwrap_or(self.since_ns);
        if now_ns.saturating_sub(quiet_since_ns) < self.limit_ns {
            return if self.zeroed_ns.is_some() { Look::Stalled } else { Look::Well };
        }
        if !core::mem::replace(&mut self.has_fired, true) {
            // Before the zero: a loop that wakes up now must not send its old force after it and go on.
            self.heartbeat.fired.fetch_add(1, Ordering::AcqRel);
        }
        match self.path.zero() {
            // A buffer that was full, a transfer that was late: the next may go.
            Err(error) if error.kind().is_passing() => return Look::Refused,
            // A device that cannot be reached this way cannot be helped; the next limit tries again.
            Ok(()) | Err(_) => self.zeroed_ns = Some(now_ns),
        }
        Look::Zeroed
    }

    /// Watches until the loop has ended.
    fn run(mut self, clock: &impl Clock) {
        loop {
            let now_ns = clock.now_ns();
            let pause_ns = match self.look(now_ns) {
                Look::Ended => return,
                Look::Refused => RETRY_NS.min(self.limit_ns / LOOKS),
                Look::Well | Look::Zeroed | Look::Stalled => self.limit_ns / LOOKS,
            };
            clock.wait_until(now_ns + pause_ns, 0);
        }
    }
}

/// One above the loop's, never 99: a watchdog that ran wild there would shut out the kernel's own.
fn priority_above(loop_priority: i32) -> i32 {
    loop_priority.min(MAX_LOOP_FIFO_PRIORITY) + 1
}

/// Starts the watchdog on a thread of its own, one FIFO priority above the loop's (98 at most) if the loop asks for one and it is granted: a
/// loop that spins for ever on the same CPU must not shut it out. Returns the policy it ran with.
pub fn spawn<'scope, C: Clock + Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    watchdog: Watchdog<'scope>,
    clock: C,
    loop_priority: Option<i32>,
) -> io::Result<ScopedJoinHandle<'scope, Policy>> {
    Builder::new().name("palpate-watchdog".into()).spawn_scoped(scope, move || {
        let fifo_priority = loop_priority.map(priority_above);
        let (report, _) = sys::enter_real_time(&RtRequest { fifo_priority, ..RtRequest::nothing() });
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
    fn a_loop_that_beats_is_left_alone_however_late_it_is() {
        let heartbeat = Heartbeat::default();
        let (mut watchdog, zeros) = watchdog(&heartbeat);
        // Not begun: opening and homing take their time.
        assert!((0..1_000).all(|ms| watchdog.look(ms * 1_000_000) == Look::Well));
        // A beat each 19 ms, looked at each 2 ms.
        for ms in 1_000..5_000_u64 {
            heartbeat.beat(ms / 19);
            if ms % 2 == 0 {
                assert_eq!(watchdog.look(ms * 1_000_000), Look::Well, "{ms}");
            }
        }
        assert_eq!((zeros.load(Ordering::Relaxed), heartbeat.fired()), (0, 0));
    }

    #[test]
    fn a_stall_is_one_firing_and_a_zero_each_limit_and_beats_end_it() {
        let heartbeat = Heartbeat::default();
        let (mut watchdog, zeros) = watchdog(&heartbeat);
        heartbeat.beat(7);
        let looks: Vec<Look> = (100..=162).map(|ms| watchdog.look(ms * 1_000_000)).collect();
        let zeroed: Vec<usize> = (0..looks.len()).filter(|i| looks[*i] == Look::Zeroed).collect();
        assert_eq!(zeroed, [20, 40, 60], "never before the limit, then once a limit");
        assert_eq!((zeros.load(Ordering::Relaxed), heartbeat.beat(8)), (3, 1), "one stall is one firing");
        assert_eq!(watchdog.look(163_000_000), Look::Well);
        assert_eq!(watchdog.look(182_000_000), Look::Well);
        assert_eq!(watchdog.look(183_000_000), Look::Zeroed);
        assert_eq!(heartbeat.fired(), 2);
        heartbeat.end();
        assert_eq!(watchdog.look(10_000_000_000), Look::Ended);
        assert_eq!(heartbeat.fired(), 2);
    }

    /// A port whose buffer is full: the zero goes as soon as there is room, and not a limit later.
    #[test]
    fn a_zero_that_did_not_go_is_tried_again_at_once() {
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
        let looks: Vec<Look> = (0..42).map(|ms| watchdog.look(ms * 1_000_000)).collect();
        assert_eq!(looks[20..25], [Look::Refused, Look::Refused, Look::Refused, Look::Zeroed, Look::Stalled]);
        assert!(looks[..20].iter().all(|look| *look == Look::Well));
        assert_eq!((tries.load(Ordering::Relaxed), heartbeat.fired()), (4, 1), "one stall is one firing");
    }

    #[test]
    fn it_is_above_every_loop_that_may_run_and_below_the_kernel() {
        assert_eq!([1, 50, MAX_LOOP_FIFO_PRIORITY].map(priority_above), [2, 51, 98]);
        assert_eq!([98, 99, i32::MAX].map(priority_above), [98; 3]);
    }

    /// On real threads: a loop that hangs in its exchange is zeroed past, and the thread ends with the heartbeat.
    #[test]
    fn the_thread_zeroes_a_hanging_loop_and_ends_with_it() {
        let heartbeat = Heartbeat::default();
        let (watchdog, zeros) = watchdog(&heartbeat);
        std::thread::scope(|scope| {
            let handle = spawn(scope, watchdog, crate::rt::MonotonicClock, None).expect("a thread starts");
            heartbeat.beat(1);
            // However long that takes on a busy machine.
            while zeros.load(Ordering::Relaxed) == 0 {
                std::thread::yield_now();
            }
            heartbeat.end();
            assert_eq!(handle.join().expect("it ends"), Policy::Other);
        });
        assert_eq!(heartbeat.fired(), 1);
    }
}
