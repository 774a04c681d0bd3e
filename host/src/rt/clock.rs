//! The clock of the loop: absolute waits on the real clock, or a virtual clock for tests and replays.

use crate::sys;
use core::sync::atomic::{AtomicU64, Ordering};

/// Time source of the haptic loop, in nanoseconds from an arbitrary origin.
pub trait Clock {
    /// Current time, ns.
    fn now_ns(&self) -> u64;

    /// Waits until `deadline_ns`; busy-waits the last `spin_ns`.
    fn wait_until(&self, deadline_ns: u64, spin_ns: u64);
}

impl<C: Clock + ?Sized> Clock for &C {
    fn now_ns(&self) -> u64 {
        (**self).now_ns()
    }

    fn wait_until(&self, deadline_ns: u64, spin_ns: u64) {
        (**self).wait_until(deadline_ns, spin_ns);
    }
}

/// CLOCK_MONOTONIC: sleep to just before the deadline, then spin.
///
/// The busy wait hides most of the timer's wake-up latency (measured in a VM: p99 falls from 64 us to under 1
/// us). It costs that much CPU time per tick.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&self) -> u64 {
        sys::monotonic_ns()
    }

    fn wait_until(&self, deadline_ns: u64, spin_ns: u64) {
        let wake_ns = deadline_ns.saturating_sub(spin_ns);
        if sys::monotonic_ns() < wake_ns {
            sys::sleep_until_ns(wake_ns);
        }
        while sys::monotonic_ns() < deadline_ns {
            core::hint::spin_loop();
        }
    }
}

/// A clock that jumps to each deadline: a run takes only the time of its computations.
#[derive(Debug, Default)]
pub struct VirtualClock {
    now_ns: AtomicU64,
}

impl VirtualClock {
    /// Advances the time, like a delay by the operating system.
    pub fn advance_ns(&self, by_ns: u64) {
        self.now_ns.fetch_add(by_ns, Ordering::Relaxed);
    }
}

impl Clock for VirtualClock {
    fn now_ns(&self) -> u64 {
        self.now_ns.load(Ordering::Relaxed)
    }

    fn wait_until(&self, deadline_ns: u64, _spin_ns: u64) {
        self.now_ns.fetch_max(deadline_ns, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_real_clock_does_not_return_before_the_deadline() {
        let clock = MonotonicClock;
        let deadline = clock.now_ns() + 2_000_000;
        clock.wait_until(deadline, 100_000);
        assert!(clock.now_ns() >= deadline);
    }

    #[test]
    fn the_virtual_clock_never_runs_backwards() {
        let clock = VirtualClock::default();
        clock.wait_until(5_000, 0);
        clock.advance_ns(10_000);
        clock.wait_until(6_000, 0);
        assert_eq!(clock.now_ns(), 15_000);
    }
}
