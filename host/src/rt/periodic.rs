//! The periodic schedule of the loop: absolute deadlines; deadlines that have passed are skipped.
//!
//! The haptic loop and [`palpate doctor`](crate::doctor) share this function, so the doctor measures the
//! schedule that the loop uses.

use super::clock::Clock;
use super::config::LoopConfig;
use core::sync::atomic::{AtomicBool, Ordering};

/// A task that runs once per period.
pub trait PeriodicTask {
    /// The clock of the deadlines.
    type Clock: Clock;
    /// The error that ends the task.
    type Error;

    /// The clock.
    fn clock(&self) -> &Self::Clock;

    /// The work for deadline `index`; deadlines are `origin_ns + index * period`.
    fn tick(&mut self, index: u64, origin_ns: u64, deadline_ns: u64) -> Result<(), Self::Error>;

    /// Whether the task ends for a reason other than the caller's flag.
    fn is_stopped(&self) -> bool {
        false
    }

    /// Reports that after tick `index` the next `skipped` deadlines had passed, the first of them `late_ns`
    /// ago. They are skipped.
    fn overrun(&mut self, index: u64, skipped: u64, late_ns: u64);
}

/// Reason of the end of a periodic run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PeriodicEnd<E> {
    /// All periods have passed.
    Completed,
    /// The stop flag was set.
    Stopped,
    /// The task failed.
    Failed(E),
}

/// Calls `work` once per period, for a number of periods or until the flag is set.
///
/// If a tick ends after the next deadline, the deadlines that have passed are skipped: there is a gap and no
/// burst of ticks. Does not allocate.
pub fn run_periodic<W: PeriodicTask>(
    work: &mut W,
    config: LoopConfig,
    stop: &AtomicBool,
    periods: u64,
) -> PeriodicEnd<W::Error> {
    let period_ns = u64::from(config.period_us.max(1)) * 1_000;
    let spin_ns = u64::from(config.spin_us) * 1_000;
    let origin_ns = work.clock().now_ns() + period_ns;
    let mut index = 0;
    while index < periods {
        if stop.load(Ordering::Relaxed) || work.is_stopped() {
            return PeriodicEnd::Stopped;
        }
        let deadline_ns = origin_ns + index * period_ns;
        work.clock().wait_until(deadline_ns, spin_ns);
        if let Err(error) = work.tick(index, origin_ns, deadline_ns) {
            return PeriodicEnd::Failed(error);
        }
        let now_ns = work.clock().now_ns();
        // The last deadline of this run that has passed.
        let passed = ((now_ns - origin_ns) / period_ns).min(periods - 1);
        if passed > index {
            work.overrun(index, passed - index, now_ns - (deadline_ns + period_ns));
        }
        index = passed.max(index) + 1;
    }
    PeriodicEnd::Completed
}
