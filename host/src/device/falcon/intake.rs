//! What comes from the device: looked for in every exchange, or read by a thread that keeps a transfer waiting.

use super::ftdi::{Ftdi, PACKET_LEN};
use super::line::payload;
use super::packet::{Decoder, Reply};
use crate::device::{DeviceError, DeviceErrorKind};
use crate::sys::{self, RtRequest};
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use std::sync::Arc;
use std::thread::JoinHandle;

/// How replies are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Each exchange looks, without waiting: for an emulator in memory, whose time is that of the exchanges.
    Polled,
    /// A thread keeps a transfer waiting, so that a reply is taken as soon as it comes. It ends with the device.
    Threaded {
        /// Its priority under SCHED_FIFO, if that is granted; above the loop's, which may spin.
        fifo_priority: Option<i32>,
    },
}

/// All that has come since the device was opened.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tally {
    /// The last whole packet.
    pub newest: Option<Reply>,
    /// Whole packets.
    pub whole: u64,
    /// Damaged ones.
    pub damaged: u64,
    /// Why nothing comes any more.
    pub lost: Option<DeviceError>,
}

/// Longest wait of the thread for one transfer: what its end may take.
const THREAD_READ: Duration = Duration::from_millis(100);
/// Reads of one exchange: a babbling device must not hold the tick.
const POLLED_READS: usize = 8;
/// Room for one transfer.
const TRANSFER_LEN: usize = 4 * PACKET_LEN;

#[derive(Debug, Default)]
pub(super) struct Receiver {
    decoder: Decoder,
    tally: Tally,
}

impl Receiver {
    fn take(&mut self, transfer: &[u8]) {
        for bytes in payload(transfer) {
            let decoded = self.decoder.push(bytes);
            self.tally.newest = decoded.newest.or(self.tally.newest);
            self.tally.whole += u64::from(decoded.whole);
            self.tally.damaged += u64::from(decoded.damaged);
        }
    }

    /// One read; false if there is nothing more to read now.
    fn read(&mut self, ftdi: &impl Ftdi, timeout: Duration) -> bool {
        let mut transfer = [0; TRANSFER_LEN];
        match ftdi.read(&mut transfer, timeout) {
            Ok(count) => {
                self.take(transfer.get(..count).unwrap_or_default());
                count > 0
            }
            Err(error) if error.kind() == DeviceErrorKind::Timeout => false,
            Err(error) if error.kind().is_passing() => {
                self.tally.damaged += 1;
                false
            }
            Err(error) => {
                self.tally.lost = Some(error);
                false
            }
        }
    }
}

/// Either way of reading.
#[derive(Debug)]
pub(super) enum Intake {
    Polled(Receiver),
    Threaded { latest: triple_buffer::Output<Tally>, stop: Arc<AtomicBool>, thread: Option<JoinHandle<()>> },
}

impl Intake {
    /// Begins to read.
    pub(super) fn start<F: Ftdi + 'static>(ftdi: &Arc<F>, mode: Mode) -> Result<Self, DeviceError> {
        let Mode::Threaded { fifo_priority } = mode else { return Ok(Self::Polled(Receiver::default())) };
        let (mut newest, latest) = triple_buffer::triple_buffer(&Tally::default());
        let (ftdi, stop) = (Arc::clone(ftdi), Arc::new(AtomicBool::new(false)));
        let stopped = Arc::clone(&stop);
        let read = move || {
            // Refused, it still reads: only later under load.
            let _ = sys::enter_real_time(&RtRequest { fifo_priority, ..RtRequest::nothing() });
            let mut receiver = Receiver::default();
            while !stopped.load(Ordering::Relaxed) && receiver.tally.lost.is_none() {
                let before = (receiver.tally.whole, receiver.tally.damaged);
                let more = receiver.read(&*ftdi, THREAD_READ);
                if (receiver.tally.whole, receiver.tally.damaged) != before || receiver.tally.lost.is_some() {
                    newest.write(receiver.tally);
                }
                if !more {
                    // An emulator's read may come back at once.
                    std::thread::yield_now();
                }
            }
        };
        let thread = std::thread::Builder::new().name("palpate-falcon".into()).spawn(read)?;
        Ok(Self::Threaded { latest, stop, thread: Some(thread) })
    }

    /// What has come so far. Waits for nothing, locks nothing, allocates nothing.
    pub(super) fn look(&mut self, ftdi: &impl Ftdi) -> Tally {
        match self {
            Self::Polled(receiver) => {
                for _ in 0..POLLED_READS {
                    if !receiver.read(ftdi, Duration::ZERO) {
                        break;
                    }
                }
                receiver.tally
            }
            Self::Threaded { latest, .. } => *latest.read(),
        }
    }
}

impl Drop for Intake {
    fn drop(&mut self) {
        if let Self::Threaded { stop, thread, .. } = self {
            stop.store(true, Ordering::Relaxed);
            // At most one read later. If it has panicked there is nothing more to be ended.
            let _ = thread.take().map(JoinHandle::join);
        }
    }
}
