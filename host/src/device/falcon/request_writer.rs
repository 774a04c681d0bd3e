//! Sends requests, in the exchange or on a thread, so that no tick waits for a transfer.
//!
//! ```text
//! exchange -> slot (the newest request, wait-free) -> thread -> bulk out
//!          <- outcome (what was written, what failed) <-
//! ```
//!
//! A transfer to a chip with a full buffer blocks. The thread absorbs this: a request that is replaced by a
//! newer one before its write begins is never written, so a stall ends with the newest request and not with a
//! burst of old forces.

use super::ftdi::Ftdi;
use super::packet::Request;
use super::reply_reader::Mode;
use crate::device::fence::Fence;
use crate::device::{DeviceError, DeviceErrorKind};
use crate::sys::{self, RtRequest};
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Instant;

/// Timeout of a write on the thread or outside a tick; an undisturbed link takes a tenth of a millisecond.
pub(super) const WRITE_TIMEOUT: Duration = Duration::from_millis(2);
/// Timeout of a write within an exchange, for an emulator in memory: well below a tick.
const TICK_TIMEOUT: Duration = Duration::from_micros(200);
/// Time without progress after which the thread hangs, us: every attempt ends within 3 ms.
const STALL_US: u64 = 10_000;
/// Period at which an idle thread checks for its end.
const IDLE: Duration = Duration::from_millis(100);
/// Pause between two attempts to write a zero.
const RETRY: Duration = Duration::from_millis(1);

/// Number of polls with a yield before polling with a sleep.
const YIELD_POLLS: u32 = 100;
/// Period of polling with a sleep.
const POLL_PERIOD: Duration = Duration::from_micros(100);

/// A request with its number, from 1.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    number: u64,
    request: Request,
}

/// State of the requests.
#[derive(Debug, Clone, Copy, Default)]
struct Outcome {
    /// Number of the newest request whose write has begun.
    begun: u64,
    /// Bit i: request `begun` - i was skipped, because it was replaced by a newer one before its write began.
    skipped: u64,
    /// Number of the newest request that is written or given up.
    done: u64,
    /// Number of writes that failed with a transient error.
    failures: u64,
    /// The error after which nothing is written.
    lost: Option<DeviceError>,
}

impl Outcome {
    /// Begins the write of a request. The requests between it and the previous one are skipped.
    fn begin(&mut self, number: u64) {
        let newer = number - self.begun;
        if newer > 0 {
            let between = 1_u64.checked_shl((newer - 1).min(64) as u32).map_or(u64::MAX, |bit| bit - 1) << 1;
            self.skipped = self.skipped.checked_shl(newer.min(64) as u32).unwrap_or(0) | between;
            self.begun = number;
        }
    }
}

/// The writer in either mode.
#[derive(Debug)]
pub(super) enum RequestWriter {
    Direct,
    Threaded(Threaded),
}

/// The caller's side of the thread.
#[derive(Debug)]
pub(super) struct Threaded {
    slot: triple_buffer::Input<Slot>,
    /// Number of the newest request.
    number: u64,
    outcome: triple_buffer::Output<Outcome>,
    /// Failures already reported.
    failures: u64,
    /// Number of the newest begun request that is already processed.
    begun: u64,
    /// What the thread had done or failed to do, and when that last changed.
    progress: (u64, u64),
    progress_us: u64,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Sends a request in one piece: the device discards an incomplete packet.
pub(super) fn write_whole(ftdi: &impl Ftdi, request: &Request, timeout: Duration) -> Result<(), DeviceError> {
    let packet = request.encode();
    if ftdi.write(&packet, timeout)? < packet.len() {
        return Err(DeviceError::new(DeviceErrorKind::Timeout));
    }
    Ok(())
}

impl RequestWriter {
    /// Starts writing. Forces are held back while the guard's fence is closed.
    pub(super) fn start<F: Ftdi + 'static>(
        ftdi: &Arc<F>,
        mode: Mode,
        fence: &Arc<OnceLock<Fence>>,
    ) -> Result<Self, DeviceError> {
        let Mode::Threaded { fifo_priority } = mode else { return Ok(Self::Direct) };
        let (slot, newest) = triple_buffer::triple_buffer(&Slot::default());
        let (published, outcome) = triple_buffer::triple_buffer(&Outcome::default());
        let stop = Arc::new(AtomicBool::new(false));
        let writer = WriterThread {
            ftdi: Arc::clone(ftdi),
            newest,
            published,
            outcome: Outcome::default(),
            fence: Arc::clone(fence),
            stop: Arc::clone(&stop),
        };
        let write = move || {
            // Without the priority it still writes, but late under load.
            let _ = sys::enter_real_time(&RtRequest { fifo_priority, ..RtRequest::none() });
            writer.run();
        };
        let thread = std::thread::Builder::new().name("palpate-falcon-out".into()).spawn(write)?;
        Ok(Self::Threaded(Threaded {
            slot,
            number: 0,
            outcome,
            failures: 0,
            begun: 0,
            progress: (0, 0),
            progress_us: 0,
            stop,
            thread: Some(thread),
        }))
    }

    /// Sends a request, or passes it to the thread without waiting, locking or allocating.
    ///
    /// The thread repeats a zero until it is written or replaced by a newer request. A force that was not
    /// written in time is given up.
    pub(super) fn send(&mut self, ftdi: &impl Ftdi, request: Request) -> Result<(), DeviceError> {
        match self {
            Self::Direct => write_whole(ftdi, &request, TICK_TIMEOUT),
            Self::Threaded(threaded) => {
                threaded.submit(request);
                Ok(())
            }
        }
    }

    /// Requests that were replaced before they were written, found since the last call, oldest first: for
    /// each the number of requests sent after it. If a reply has been received, all requests replaced before
    /// its request have been reported.
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

    /// The thread's error since the last call. A thread that has ended is a lost device: the caller then
    /// writes past it. One that hangs in a transfer is [`DeviceErrorKind::Stalled`].
    pub(super) fn failure(&mut self, now_us: u64) -> Option<DeviceError> {
        let Self::Threaded(threaded) = self else { return None };
        let outcome = *threaded.outcome.read();
        if outcome.lost.is_some() {
            return outcome.lost;
        }
        if threaded.thread.as_ref().is_none_or(JoinHandle::is_finished) {
            return Some(DeviceError::new(DeviceErrorKind::Disconnected));
        }
        let failed = outcome.failures > core::mem::replace(&mut threaded.failures, outcome.failures);
        let progress = (outcome.done, outcome.failures);
        let moves = core::mem::replace(&mut threaded.progress, progress) != progress;
        if moves || outcome.done >= threaded.number {
            threaded.progress_us = now_us;
        }
        if now_us.saturating_sub(threaded.progress_us) >= STALL_US {
            return Some(DeviceError::new(DeviceErrorKind::Stalled));
        }
        failed.then(|| DeviceError::new(DeviceErrorKind::Timeout))
    }

    /// Waits until the thread is done with the newest request, or for the timeout.
    pub(super) fn flush(&mut self, timeout: Duration) {
        self.wait(timeout, |_| false);
    }

    /// Like `flush`, but ends when an attempt that began after this call has failed.
    pub(super) fn wait_attempted(&mut self, timeout: Duration) {
        let Self::Threaded(Threaded { outcome, .. }) = self else { return };
        // The next failure may belong to an attempt that began before this call.
        let refused = outcome.read().failures + 2;
        self.wait(timeout, |outcome| outcome.failures >= refused);
    }

    fn wait(&mut self, timeout: Duration, is_enough: impl Fn(&Outcome) -> bool) {
        let Self::Threaded(Threaded { outcome, number, .. }) = self else { return };
        let give_up = Instant::now() + timeout;
        for polls in 0_u32.. {
            let so_far = outcome.read();
            let is_over = so_far.done >= *number || so_far.lost.is_some() || is_enough(so_far);
            if is_over || Instant::now() >= give_up {
                return;
            }
            // A write takes a tenth of a millisecond, and in memory less than a sleep.
            if polls < YIELD_POLLS { std::thread::yield_now() } else { std::thread::sleep(POLL_PERIOD) }
        }
    }
}

impl Threaded {
    fn submit(&mut self, request: Request) {
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
            // It ends after at most one more write. If it has panicked, nothing is left to end.
            let _ = thread.join();
        }
    }
}

struct WriterThread<F: Ftdi> {
    ftdi: Arc<F>,
    newest: triple_buffer::Output<Slot>,
    published: triple_buffer::Input<Outcome>,
    outcome: Outcome,
    fence: Arc<OnceLock<Fence>>,
    stop: Arc<AtomicBool>,
}

impl<F: Ftdi> WriterThread<F> {
    fn run(mut self) {
        while self.outcome.lost.is_none() {
            let slot = *self.newest.read();
            if slot.number > self.outcome.done {
                self.outcome.begin(slot.number);
                // Publish before the write, so that this state is visible before a reply is.
                self.published.write(self.outcome);
                self.write(slot);
                self.published.write(self.outcome);
            } else if self.stop.load(Ordering::Relaxed) {
                return;
            } else {
                std::thread::park_timeout(IDLE);
            }
        }
    }

    fn write(&mut self, Slot { number, request }: Slot) {
        let is_zero = request.motors == [0; 3];
        // The last look before the write: this process may have been stopped since the tick began.
        if !is_zero && self.fence.get().is_some_and(Fence::is_closed) {
            self.outcome.done = number;
            return;
        }
        match write_whole(&*self.ftdi, &request, WRITE_TIMEOUT) {
            Ok(()) => self.outcome.done = number,
            Err(error) if error.kind().is_transient() => {
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
    fn a_request_replaced_before_its_write_is_skipped() {
        let mut outcome = Outcome::default();
        for (number, skipped) in
            [(1, 0), (2, 0), (2, 0), (4, 0b10), (5, 0b100), (8, 0b10_0110), (71, (1 << 63) - 2)]
        {
            outcome.begin(number);
            assert_eq!((outcome.begun, outcome.skipped), (number, skipped), "{number}");
        }
        outcome.begin(72);
        assert_eq!(outcome.skipped, u64::MAX << 2);
        outcome.begin(1_000);
        assert_eq!(outcome.skipped, u64::MAX << 1);
    }
}
