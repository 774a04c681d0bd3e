//! Receives replies, by polling in every exchange or on a thread that keeps a transfer pending.

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
    /// Each exchange polls without waiting: for an emulator in memory, whose time advances with the
    /// exchanges.
    Polled,
    /// A thread keeps a transfer pending, so a reply is read as soon as it arrives. The thread ends with the
    /// device.
    Threaded {
        /// Its priority under SCHED_FIFO, if granted; above that of the loop, which may spin.
        fifo_priority: Option<i32>,
    },
}

/// Counts of all packets since the device was opened.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ReplyCounts {
    /// The last valid packet.
    pub newest: Option<Reply>,
    /// Number of valid packets.
    pub whole: u64,
    /// Number of damaged packets.
    pub damaged: u64,
    /// The error after which nothing is received.
    pub lost: Option<DeviceError>,
}

/// Longest wait of the thread for one transfer; its end may take as long.
const THREAD_READ: Duration = Duration::from_millis(100);
/// Reads per exchange: a device that sends continuously must not delay the tick.
const POLLED_READS: usize = 8;
/// Size of one transfer.
const TRANSFER_LEN: usize = 4 * PACKET_LEN;

#[derive(Debug, Default)]
pub(super) struct Receiver {
    decoder: Decoder,
    counts: ReplyCounts,
}

impl Receiver {
    fn take(&mut self, transfer: &[u8]) {
        for bytes in payload(transfer) {
            let decoded = self.decoder.push(bytes);
            self.counts.newest = decoded.newest.or(self.counts.newest);
            self.counts.whole += u64::from(decoded.whole);
            self.counts.damaged += u64::from(decoded.damaged);
        }
    }

    /// Reads once; false if there is nothing more to read.
    fn read(&mut self, ftdi: &impl Ftdi, timeout: Duration) -> bool {
        let mut transfer = [0; TRANSFER_LEN];
        match ftdi.read(&mut transfer, timeout) {
            Ok(count) => {
                self.take(transfer.get(..count).unwrap_or_default());
                count > 0
            }
            Err(error) if error.kind() == DeviceErrorKind::Timeout => false,
            Err(error) if error.kind().is_transient() => {
                self.counts.damaged += 1;
                false
            }
            Err(error) => {
                self.counts.lost = Some(error);
                false
            }
        }
    }
}

/// The reader in either mode.
#[derive(Debug)]
pub(super) enum ReplyReader {
    Polled(Receiver),
    Threaded {
        latest: triple_buffer::Output<ReplyCounts>,
        stop: Arc<AtomicBool>,
        thread: Option<JoinHandle<()>>,
    },
}

impl ReplyReader {
    /// Starts reading.
    pub(super) fn start<F: Ftdi + 'static>(ftdi: &Arc<F>, mode: Mode) -> Result<Self, DeviceError> {
        let Mode::Threaded { fifo_priority } = mode else { return Ok(Self::Polled(Receiver::default())) };
        let (mut newest, latest) = triple_buffer::triple_buffer(&ReplyCounts::default());
        let (ftdi, stop) = (Arc::clone(ftdi), Arc::new(AtomicBool::new(false)));
        let stopped = Arc::clone(&stop);
        let read = move || {
            // Without the priority it still reads, but late under load.
            let _ = sys::enter_real_time(&RtRequest { fifo_priority, ..RtRequest::none() });
            let mut receiver = Receiver::default();
            while !stopped.load(Ordering::Relaxed) && receiver.counts.lost.is_none() {
                let before = (receiver.counts.whole, receiver.counts.damaged);
                let more = receiver.read(&*ftdi, THREAD_READ);
                if (receiver.counts.whole, receiver.counts.damaged) != before
                    || receiver.counts.lost.is_some()
                {
                    newest.write(receiver.counts);
                }
                if !more {
                    // An emulator's read may return immediately.
                    std::thread::yield_now();
                }
            }
        };
        let thread = std::thread::Builder::new().name("palpate-falcon".into()).spawn(read)?;
        Ok(Self::Threaded { latest, stop, thread: Some(thread) })
    }

    /// The counts so far. Does not wait, lock or allocate.
    pub(super) fn poll(&mut self, ftdi: &impl Ftdi) -> ReplyCounts {
        match self {
            Self::Polled(receiver) => {
                for _ in 0..POLLED_READS {
                    if !receiver.read(ftdi, Duration::ZERO) {
                        break;
                    }
                }
                receiver.counts
            }
            Self::Threaded { latest, .. } => *latest.read(),
        }
    }
}

impl Drop for ReplyReader {
    fn drop(&mut self) {
        if let Self::Threaded { stop, thread, .. } = self {
            stop.store(true, Ordering::Relaxed);
            // It ends after at most one more read. If it has panicked, nothing is left to end.
            let _ = thread.take().map(JoinHandle::join);
        }
    }
}
