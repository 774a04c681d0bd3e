//! What the session and its guard share about the device: heartbeats, the fence, and the message that zeroes
//! the force.
//!
//! ```text
//! session -- loop beat, zero message --> page (shared memory) <-- guard beat, closings, zeros -- guard
//! ```
//!
//! The guard closes the fence before it writes to the device. A driver reads the fence before every write and
//! sends no force through a closed one, so a process that was stopped and resumes does not send its old force.
//! Only the user's reset opens it again.

use crate::sys::{self, SharedWords};
use core::sync::atomic::{AtomicU64, Ordering};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;

/// Longest zero message, bytes.
pub const MAX_ZERO_MESSAGE: usize = 192;
const MESSAGE_WORDS: usize = MAX_ZERO_MESSAGE / 8;

/// Words of the page.
const LOOP_BEAT: usize = 0;
const GUARD_BEAT: usize = 1;
const CLOSINGS: usize = 2;
const ZEROS: usize = 3;
/// Which of the two messages is valid.
const MESSAGE: usize = 4;
/// Each message is its length, then its bytes.
const MESSAGES: [usize; 2] = [5, 6 + MESSAGE_WORDS];
const WORDS: usize = MESSAGES[1] + 1 + MESSAGE_WORDS;

/// Beat of a loop that does not run.
const NOT_RUNNING: u64 = 0;

/// How the guard's bytes reach the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Wire {
    /// A terminal or a socket: write(2), non-blocking.
    Stream,
    /// A bulk pipe of a USB device file.
    UsbBulk {
        /// The endpoint.
        endpoint: u8,
    },
}

/// The guard's own way to the device: a duplicate of the open descriptor. The message that zeroes the force is
/// in the page.
#[derive(Debug)]
pub struct GuardPath {
    /// The descriptor.
    pub fd: OwnedFd,
    /// How bytes are written to it.
    pub wire: Wire,
}

/// Longest wait for one USB transfer.
const USB_TIMEOUT: Duration = Duration::from_millis(5);

impl GuardPath {
    /// Writes the message that zeroes the force. [`io::ErrorKind::WouldBlock`] or `TimedOut` if the line does
    /// not accept all of it now; it may be repeated from the start.
    pub fn send_zero(&self, page: &Page) -> io::Result<()> {
        let mut bytes = [0; MAX_ZERO_MESSAGE];
        let len = page.zero_message(&mut bytes);
        page.word(ZEROS).fetch_add(1, Ordering::AcqRel);
        let count = match self.wire {
            Wire::Stream => sys::write(self.fd.as_fd(), &bytes[..len])?,
            Wire::UsbBulk { endpoint } => {
                sys::usb::write_bulk(self.fd.as_fd(), endpoint, &bytes[..len], USB_TIMEOUT)?
            }
        };
        if count < len { Err(io::ErrorKind::WouldBlock.into()) } else { Ok(()) }
    }
}

/// The shared page, from either side.
#[derive(Debug)]
pub struct Page(SharedWords);

impl Page {
    /// A page that another process can map, and its descriptor.
    pub fn shared() -> io::Result<(Self, OwnedFd)> {
        let (words, fd) = SharedWords::create(c"palpate-guard", WORDS)?;
        Ok((Self(words), fd))
    }

    /// Maps a page that another process has made.
    pub fn map(fd: &OwnedFd) -> io::Result<Self> {
        SharedWords::map(fd, WORDS).map(Self)
    }

    fn word(&self, index: usize) -> &AtomicU64 {
        &self.0.words()[index]
    }

    /// Time of the loop's last tick, CLOCK_MONOTONIC, ns; `None` while no loop runs.
    #[must_use]
    pub fn loop_beat_ns(&self) -> Option<u64> {
        Some(self.word(LOOP_BEAT).load(Ordering::Acquire)).filter(|beat| *beat != NOT_RUNNING)
    }

    /// Notes a tick of the loop.
    pub fn beat_loop(&self, now_ns: u64) {
        self.word(LOOP_BEAT).store(now_ns.max(1), Ordering::Release);
    }

    /// No loop runs: silence is no fault.
    pub fn end_loop(&self) {
        self.word(LOOP_BEAT).store(NOT_RUNNING, Ordering::Release);
    }

    /// Time of the guard's last check, ns.
    #[must_use]
    pub fn guard_beat_ns(&self) -> u64 {
        self.word(GUARD_BEAT).load(Ordering::Acquire)
    }

    /// Notes a check of the guard.
    pub fn beat_guard(&self, now_ns: u64) {
        self.word(GUARD_BEAT).store(now_ns, Ordering::Release);
    }

    /// Closes the fence.
    pub fn close(&self) {
        self.word(CLOSINGS).fetch_add(1, Ordering::AcqRel);
    }

    /// How often the fence was closed.
    #[must_use]
    pub fn closings(&self) -> u64 {
        self.word(CLOSINGS).load(Ordering::Acquire)
    }

    fn zeros(&self) -> u64 {
        self.word(ZEROS).load(Ordering::Acquire)
    }

    /// The message that zeroes the force, into `bytes`; its length.
    pub fn zero_message(&self, bytes: &mut [u8; MAX_ZERO_MESSAGE]) -> usize {
        let at = MESSAGES[(self.word(MESSAGE).load(Ordering::Acquire) % 2) as usize];
        for (index, chunk) in bytes.chunks_exact_mut(8).enumerate() {
            chunk.copy_from_slice(&self.word(at + 1 + index).load(Ordering::Relaxed).to_le_bytes());
        }
        MAX_ZERO_MESSAGE.min(self.word(at).load(Ordering::Relaxed) as usize)
    }

    /// Replaces the message. The guard reads the old one or the new one, never a mixture of both.
    fn set_zero_message(&self, message: &[u8]) {
        let next = (self.word(MESSAGE).load(Ordering::Relaxed) + 1) % 2;
        let at = MESSAGES[next as usize];
        let message = &message[..message.len().min(MAX_ZERO_MESSAGE)];
        for (index, chunk) in message.chunks(8).enumerate() {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.word(at + 1 + index).store(u64::from_le_bytes(word), Ordering::Relaxed);
        }
        self.word(at).store(message.len() as u64, Ordering::Relaxed);
        self.word(MESSAGE).store(next, Ordering::Release);
    }
}

/// The session's side of the page. It is cheap to clone; all clones are one fence.
#[derive(Debug, Clone)]
pub struct Fence {
    page: Arc<Page>,
    /// Closings after which the user has reset.
    opened: Arc<AtomicU64>,
}

impl Default for Fence {
    /// A fence without a guard: it is open.
    fn default() -> Self {
        Self::new(Page(SharedWords::local(WORDS)))
    }
}

impl Fence {
    /// The fence of a page.
    #[must_use]
    pub fn new(page: Page) -> Self {
        Self { page: Arc::new(page), opened: Arc::default() }
    }

    /// The page.
    #[must_use]
    pub fn page(&self) -> &Page {
        &self.page
    }

    /// Whether no force may be sent.
    #[inline]
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.page.closings() != self.opened.load(Ordering::Acquire)
    }

    /// Opens it after the user's reset.
    pub fn open(&self) {
        self.opened.store(self.page.closings(), Ordering::Release);
    }

    /// Number of messages that the guard has written to the device. A driver that assigns replies to requests
    /// by their order must discard the replies to these.
    #[must_use]
    pub fn zeros(&self) -> u64 {
        self.page.zeros()
    }

    /// Sets the bytes that zero the device's force whatever it has received before, at most
    /// [`MAX_ZERO_MESSAGE`].
    pub fn set_zero_message(&self, message: &[u8]) {
        self.page.set_zero_message(message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::os::unix::net::UnixStream;

    #[test]
    fn only_a_reset_opens_a_closed_fence() {
        let fence = Fence::default();
        let driver = fence.clone();
        assert!(!driver.is_closed());
        fence.page().close();
        assert!(driver.is_closed() && fence.is_closed());
        fence.page().close();
        driver.open();
        assert!(!driver.is_closed() && !fence.is_closed(), "one reset, however often it was closed");
    }

    #[test]
    fn both_processes_see_one_page() {
        let (page, fd) = Page::shared().expect("shared memory");
        let fence = Fence::new(page);
        let other = Page::map(&fd).expect("the same memory");
        fence.page().beat_loop(7);
        other.close();
        assert!(other.loop_beat_ns() == Some(7) && fence.is_closed());
        fence.page().end_loop();
        assert_eq!(other.loop_beat_ns(), None);
    }

    #[test]
    fn the_zero_message_is_written_whole_or_it_would_block() {
        let (near, mut far) = UnixStream::pair().expect("sockets");
        near.set_nonblocking(true).expect("a setting");
        let (fence, path) = (Fence::default(), GuardPath { fd: near.into(), wire: Wire::Stream });
        fence.set_zero_message(b"zero");
        path.send_zero(fence.page()).expect("room");
        let mut bytes = [0; 4];
        far.read_exact(&mut bytes).expect("it arrives");
        assert_eq!((&bytes, fence.zeros()), (b"zero", 1));
        let refused = (0..1_000_000).find_map(|_| path.send_zero(fence.page()).err()).expect("it is full");
        assert_eq!(refused.kind(), io::ErrorKind::WouldBlock);
    }

    #[test]
    fn the_zero_message_changes_in_one_step() {
        let fence = Fence::default();
        let read = || {
            let mut bytes = [0; MAX_ZERO_MESSAGE];
            let len = fence.page().zero_message(&mut bytes);
            bytes[..len].to_vec()
        };
        assert_eq!(read(), b"");
        for message in [&b"first message"[..], b"2", &[9; MAX_ZERO_MESSAGE], &[3; 8]] {
            fence.set_zero_message(message);
            assert_eq!(read(), message);
        }
    }
}
