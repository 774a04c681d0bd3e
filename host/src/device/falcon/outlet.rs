//! What goes to the device: written by the caller, or by a thread, so that no tick waits for a transfer.
//!
//! ```text
//! exchange -> slot (the newest request, wait-free) -> thread -> bulk out
//!          <- outcome (what was written, what failed) <-
//! ```
//!
//! A transfer to a chip whose buffer is full waits for room. With a thread that is the thread's affair: what it has not begun to write when a newer
//! request comes is never written, so a stall ends with the newest request and not with a burst of old forces.

use super::ftdi::Ftdi;
use super::intake::Mode;
use super::packet::Request;
use crate::device::{DeviceError, DeviceErrorKind};
use crate::sys::{self, RtRequest};
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

/// Longest wait of a request that is written by a thread, or outside a tick; a healthy link takes a tenth of a millisecond.
pub(super) const WRITE_TIMEOUT: Duration = Duration::from_millis(2);
/// The same within an exchange, for an emulator in memory: well below a tick.
const TICK_TIMEOUT: Duration = Duration::from_micros(200);
/// How often an idle thread looks whether it is still wanted.
const IDLE: Duration = Duration::from_millis(100);
/// Between two tries to write a zero.
const RETRY: Duration = Duration::from_millis(1);

/// Looks at what became of a request before whoever waits for it sleeps in between.
const SPINS: u32 = 100;
/// Between two looks from then on.
const LOOK: Duration = Duration::from_micros(100);

/// A request with its number, from 1.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    number: u64,
    request: Request,
}

/// What became of the requests.
#[derive(Debug, Clone, Copy, Default)]
struct Outcome {
    /// The newest that was taken to be written.
    begun: u64,
    /// Bit i: request `begun` - i was not, because a newer one was there before.
    skipped: u64,
    /// The newest that was written, or given up.
    done: u64,
    /// Writes that failed in passing.
    failures: u64,
    /// Why nothing is written any more.
    lost: Option<DeviceError>,
}

impl Outcome {
    /// A request is taken to be written; what came between it and the one before is not.
    fn take(&mut self, number: u64) {
        let newer = number - self.begun;
        if newer > 0 {
            let between = 1_u64.checked_shl((newer - 1).min(64) as u32).map_or(u64::MAX, |bit| bit - 1) << 1;
            self.skipped = self.skipped.checked_shl(newer.min(64) as u32).unwrap_or(0) | between;
            self.begun = number;
        }
    }
}

/// Either way of writing.
#[derive(Debug)]
pub(super) enum Outlet {
    Direct,
    Threaded(Threaded),
}

/// The caller's end of the thread.
#[derive(Debug)]
pub(super) struct Threaded {
    slot: triple_buffer::Input<Slot>,
    /// Of the newest request.
    number: u64,
    outcome: triple_buffer::Output<Outcome>,
    /// Failures that were looked at.
    failures: u64,
    /// The newest of those taken that was looked at.
    begun: u64,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Sends a request in one piece: what is cut the device throws away.
pub(super) fn write_whole(ftdi: &impl Ftdi, request: &Request, timeout: Duration) -> Result<(), DeviceError> {
    let packet = request.encode();
    if ftdi.write(&packet, timeout)? < packet.len() {
        return Err(DeviceError::new(DeviceErrorKind::Timeout));
    }
    Ok(())
}

impl Outlet {
    /// Begins to write. A force is held back while `disturbed`: somebody else has just taken it away.
    pub(super) fn start<F: Ftdi + 'static>(
        ftdi: &Arc<F>,
        mode: Mode,
        disturbed: &Arc<AtomicBool>,
    ) -> Result<Self, DeviceError> {
        let Mode::Threaded { fifo_priority } = mode else { return Ok(Self::Direct) };
        let (slot, newest) = triple_buffer::triple_buffer(&Slot::default());
        let (told, outcome) = triple_buffer::triple_buffer(&Outcome::default());
        let stop = Arc::new(AtomicBool::new(false));
        let writer = Writer {
            ftdi: Arc::clone(ftdi),
            newest,
            told,
            outcome: Outcome::default(),
            disturbed: Arc::clone(disturbed),
            stop: Arc::clone(&stop),
        };
        let write = move || {
            // Refused, it still writes: only later under load.
            let _ = sys::enter_real_time(&RtRequest { fifo_priority, ..RtRequest::nothing() });
            writer.run();
        };
        let thread = std::thread::Builder::new().name("palpate-falcon-out".into()).spawn(write)?;
        Ok(Self::Threaded(Threaded {
            slot,
            number: 0,
            outcome,
            failures: 0,
            begun: 0,
            stop,
            thread: Some(thread),
        }))
    }

    /// Sends a request, or hands it to the thread, which waits for nothing, locks nothing and allocates nothing.
    ///
    /// A thread tries a zero again until it is written or something newer is there. A force that did not go in time is given up.
    pub(super) fn send(&mut self, ftdi: &impl Ftdi, request: Request) -> Result<(), DeviceError> {
        match self {
            Self::Direct => write_whole(ftdi, &request, TICK_TIMEOUT),
            Self::Threaded(threaded) => {
                threaded.hand_over(request);
                Ok(())
            }
        }
    }

    /// Requests that were replaced by newer ones before they were written, found out since the last look: how many were sent after each, oldest
    /// first. Whoever has seen a reply is told of all that was replaced before its request.
    pub(super) fn skipped(&mut self) -> impl Iterator<Item = u64> + use<> {
        let (mut skipped, mut begun, mut seen, mut number) = (0, 0, 0, 0);
        if let Self::Threaded(threaded) = self {
            let outcome = *threaded.outcome.read();
            (skipped, begun, number) = (outcome.skipped, outcome.begun, threaded.number);
            seen = core::mem::replace(&mut threaded.begun, begun);
        }
        (0..u64::from(u64::BITS).min(begun - seen))
            .rev()
            .filter(move |bit| skipped >> bit & 1 == 1)
            .map(move |bit| number - begun + bit)
    }

    /// What went wrong in the thread since the last look.
    pub(super) fn failure(&mut self) -> Option<DeviceError> {
        let Self::Threaded(Threaded { outcome, failures, .. }) = self else { return None };
        let Outcome { failures: failed, lost, .. } = *outcome.read();
        let before = core::mem::replace(failures, failed);
        lost.or_else(|| (failed > before).then(|| DeviceError::new(DeviceErrorKind::Timeout)))
    }

    /// Waits until the thread is done with the newest request, or for so long.
    pub(super) fn flush(&mut self, patience: Duration) {
        self.wait(patience, |_| false);
    }

    /// The same, but no longer than until a try that began after this call was refused.
    pub(super) fn wait_tried(&mut self, patience: Duration) {
        let Self::Threaded(Threaded { outcome, .. }) = self else { return };
        // The next refusal to be told of may be of a try that had begun before.
        let refused = outcome.read().failures + 2;
        self.wait(patience, |outcome| outcome.failures >= refused);
    }

    fn wait(&mut self, patience: Duration, is_enough: impl Fn(&Outcome) -> bool) {
        let Self::Threaded(Threaded { outcome, number, .. }) = self else { return };
        let give_up = Instant::now() + patience;
        for looks in 0_u32.. {
            let so_far = outcome.read();
            let is_over = so_far.done >= *number || so_far.lost.is_some() || is_enough(so_far);
            if is_over || Instant::now() >= give_up {
                return;
            }
            // A write takes a tenth of a millisecond, and in memory less than a sleep.
            if looks < SPINS { std::thread::yield_now() } else { std::thread::sleep(LOOK) }
        }
    }
}

impl Threaded {
    fn hand_over(&mut self, request: Request) {
        self.number += 1;
        self.slot.write(Slot { number: self.number, request });
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }
}

impl Drop for Threaded {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // At most one write later. If it has panicked there is nothing more to be ended.
            let _ = thread.join();
        }
    }
}

struct Writer<F: Ftdi> {
    ftdi: Arc<F>,
    newest: triple_buffer::Output<Slot>,
    told: triple_buffer::Input<Outcome>,
    outcome: Outcome,
    disturbed: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
}

impl<F: Ftdi> Writer<F> {
    fn run(mut self) {
        while self.outcome.lost.is_none() {
            let slot = *self.newest.read();
            if slot.number > self.outcome.done {
                self.outcome.take(slot.number);
                // Before the write: no reply is seen before this is.
                self.told.write(self.outcome);
                self.write(slot);
                self.told.write(self.outcome);
            } else if self.stop.load(Ordering::Relaxed) {
                return;
            } else {
                std::thread::park_timeout(IDLE);
            }
        }
    }

    fn write(&mut self, Slot { number, request }: Slot) {
        let is_zero = request.motors == [0; 3];
        if !is_zero && self.disturbed.load(Ordering::Acquire) {
            self.outcome.done = number;
            return;
        }
        match write_whole(&*self.ftdi, &request, WRITE_TIMEOUT) {
            Ok(()) => self.outcome.done = number,
            Err(error) if error.kind().is_passing() => {
                self.outcome.failures += 1;
                if is_zero && !self.stop.load(Ordering::Relaxed) {
                    std::thread::sleep(RETRY);
                } else {
                    self.outcome.done = number;
                }
            }
            Err(error) => self.outcome.lost = Some(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_replaced_before_it_is_taken_is_skipped() {
        let mut outcome = Outcome::default();
        for (number, skipped) in
            [(1, 0), (2, 0), (2, 0), (4, 0b10), (5, 0b100), (8, 0b10_0110), (71, (1 << 63) - 2)]
        {
            outcome.take(number);
            assert_eq!((outcome.begun, outcome.skipped), (number, skipped), "{number}");
        }
        outcome.take(72);
        assert_eq!(outcome.skipped, u64::MAX << 2);
        outcome.take(1_000);
        assert_eq!(outcome.skipped, u64::MAX << 1);
    }
}
