//! The pace of the loop: absolute deadlines, and what has passed is skipped.
//!
//! One function for the haptic loop and for [`palpate doctor`](crate::doctor), so that what the doctor measures is what the hand gets.

use super::clock::Clock;
use super::haptic_loop::LoopConfig;
use core::sync::atomic::{AtomicBool, Ordering};

/// What is done once a period.
pub trait Paced {
    /// The time it goes by.
    type Clock: Clock;
    /// Why it cannot go on.
    type Error;

    /// Its clock.
    fn clock(&self) -> &Self::Clock;

    /// The work for deadline `index`; deadlines are `origin_ns + index * period`.
    fn tick(&mut self, index: u64, origin_ns: u64, deadline_ns: u64) -> Result<(), Self::Error>;

    /// Whether it is to end, for a reason that the caller's flag does not know.
    fn is_stopped(&self) -> bool {
        false
    }

    /// After tick `index` the next `skipped` deadlines had passed, the first of them `late_ns` ago. They get no tick.
    fn overrun(&mut self, index: u64, skipped: u64, late_ns: u64);
}

/// How the pace ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paces<E> {
    /// Every period has passed.
    Completed,
    /// The stop flag was set.
    Stopped,
    /// The work could not go on.
    Failed(E),
}

/// Calls `work` once a period, for a number of periods or until the flag is set.
///
/// A tick that ends after the next deadline makes it skip what has passed: a gap, never a burst of ticks that pretend to be a
/// period apart. Allocates nothing.
pub fn pace<W: Paced>(work: &mut W, config: LoopConfig, stop: &AtomicBool, periods: u64) -> Paces<W::Error> {
    let period_ns = u64::from(config.period_us.max(1)) * 1_000;
    let spin_ns = u64::from(config.spin_us) * 1_000;
    let origin_ns = work.clock().now_ns() + period_ns;
    let mut index = 0;
    while index < periods {
        if stop.load(Ordering::Relaxed) || work.is_stopped() {
            return Paces::Stopped;
        }
        let deadline_ns = origin_ns + index * period_ns;
        work.clock().wait_until(deadline_ns, spin_ns);
        if let Err(error) = work.tick(index, origin_ns, deadline_ns) {
            return Paces::Failed(error);
        }
        let now_ns = work.clock().now_ns();
        // The last deadline of this run that is not in the future any more.
        let passed = ((now_ns - origin_ns) / period_ns).min(periods - 1);
        if passed > index {
            work.overrun(index, passed - index, now_ns - (deadline_ns + period_ns));
        }
        index = passed.max(index) + 1;
    }
    Paces::Completed
}
