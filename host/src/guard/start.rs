//! Starts a guard, and notices its end.

use super::setup::{Ready, Setup};
use crate::device::fence::{Fence, GuardPath, Page, Wire};
use crate::sys::{self, Ended, Policy};
use core::fmt;
use core::sync::atomic::{AtomicU64, Ordering};
use std::io::{self, Read};
use std::net::Shutdown;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::process::{Child, Command};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Default time without a tick after which the guard zeroes the force, ms: the age at which a sample becomes a
/// fault.
pub const DEFAULT_LIMIT_MS: u32 = 10;

/// Longest wait for the guard's reply.
const READY_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest wait for the guard to exit, so that the device can be opened again.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);

/// How a guard is started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GuardOptions {
    /// Time without a tick after which it zeroes the force, ms.
    pub limit_ms: u32,
    /// SCHED_FIFO priority to request, above that of the loop.
    pub fifo_priority: Option<i32>,
    /// Whether to request locked memory.
    pub locks_memory: bool,
}

/// Status of a guard, for display.
#[derive(Debug)]
pub struct GuardStatus {
    /// Its process; `None` for a guard on a thread.
    pub pid: Option<u32>,
    /// Time without a tick after which it zeroes the force, ms.
    pub limit_ms: u32,
    /// Its scheduling policy.
    pub policy: Policy,
    fired: AtomicU64,
}

impl GuardStatus {
    /// Number of times that the fence was closed.
    #[must_use]
    pub fn fired(&self) -> u64 {
        self.fired.load(Ordering::Relaxed)
    }

    pub(super) fn count_firing(&self) {
        self.fired.fetch_add(1, Ordering::Relaxed);
    }
}

impl fmt::Display for GuardStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.pid {
            Some(pid) => write!(f, "pid {pid}")?,
            None => f.write_str("in this process")?,
        }
        write!(f, ", zero after {} ms, {}; fired {} times", self.limit_ms, self.policy, self.fired())
    }
}

/// A running guard.
#[derive(Debug)]
pub(super) struct Guard {
    socket: UnixStream,
    child: Option<Child>,
    ended: Ended,
    pub(super) status: Arc<GuardStatus>,
}

impl Guard {
    /// Starts `command` with one end of a socket pair as its standard input, and waits until it guards the
    /// device. `page` and `fence` are the shared page.
    pub(super) fn start(
        command: Command,
        options: GuardOptions,
        page: &OwnedFd,
        path: &GuardPath,
    ) -> io::Result<Self> {
        let (ours, child) = sys::start_beside(command, "haptic-guard")?;
        let ended = sys::pidfd(child.id())?;
        Self::handshake(ours, Some(child), ended, options, page, path)
    }

    /// Uses a guard that already waits at the other end of `socket`.
    pub(super) fn at(
        socket: UnixStream,
        options: GuardOptions,
        page: &OwnedFd,
        path: &GuardPath,
    ) -> io::Result<Self> {
        let ended = OwnedFd::from(socket.try_clone()?);
        Self::handshake(socket, None, ended, options, page, path)
    }

    fn handshake(
        mut socket: UnixStream,
        child: Option<Child>,
        ended: OwnedFd,
        options: GuardOptions,
        page: &OwnedFd,
        path: &GuardPath,
    ) -> io::Result<Self> {
        let GuardOptions { limit_ms, fifo_priority, locks_memory } = options;
        let setup = Setup { limit_ms, fifo_priority, locks_memory, wire: path.wire };
        let session = sys::pidfd(std::process::id())?;
        sys::send_fds(&socket, &setup.encode(), &[page.as_fd(), path.fd.as_fd(), session.as_fd()])?;
        socket.set_read_timeout(Some(READY_TIMEOUT))?;
        let mut bytes = [0; Ready::MAX_LEN];
        let count = socket.read(&mut bytes)?;
        let ready = Ready::decode(&bytes[..count]).ok_or(io::ErrorKind::UnexpectedEof)?;
        let policy = if ready.fifo_priority > 0 { Policy::Fifo(ready.fifo_priority) } else { Policy::Other };
        let pid = child.as_ref().map(Child::id);
        Ok(Self {
            socket,
            child,
            ended: Ended::watch(ended, "palpate-guarded")?,
            status: Arc::new(GuardStatus { pid, limit_ms, policy, fired: AtomicU64::new(0) }),
        })
    }

    /// Whether the guard has ended. Wait-free.
    pub(super) fn has_ended(&self) -> bool {
        self.ended.has_ended()
    }
}

impl Drop for Guard {
    /// Lets the guard zero the device once more and exit.
    fn drop(&mut self) {
        let _ = self.socket.shutdown(Shutdown::Both);
        if let Some(child) = &mut self.child {
            sys::wait_exit(child, EXIT_TIMEOUT);
        }
    }
}

/// A page, the session's side of it, and its descriptor for the guard.
pub(super) fn shared_fence() -> io::Result<(Fence, OwnedFd)> {
    let (page, fd) = Page::shared()?;
    Ok((Fence::new(page), fd))
}

/// Starts a guard without a device: a check of everything but the device. Returns the time until it is ready, and
/// its scheduling policy.
pub fn try_start(command: Command, options: GuardOptions) -> io::Result<(Duration, Policy)> {
    let begun = Instant::now();
    let (_fence, page) = shared_fence()?;
    let nothing = std::fs::File::options().write(true).open("/dev/null")?;
    let path = GuardPath { fd: nothing.into(), wire: Wire::Stream };
    let guard = Guard::start(command, options, &page, &path)?;
    Ok((begun.elapsed(), guard.status.policy))
}
