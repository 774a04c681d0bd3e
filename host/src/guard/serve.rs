//! The guard's process: watches the session, and zeroes the device through its own descriptor.

use super::setup::{Ready, Setup};
use super::watch::{Action, Watch};
use crate::device::fence::{GuardPath, Page};
use crate::sys::{self, Policy, RtRequest};
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::time::Duration;

/// Wait for the session's first message.
const SETUP_TIMEOUT: Duration = Duration::from_secs(5);
/// Time for which the last zero is retried while the line does not accept it.
const FINAL_ZERO_TIMEOUT_NS: u64 = 10_000_000_000;
/// Number of times that the force of a session that died is zeroed: a zero can be lost on the line.
const FINAL_ZEROS: u32 = 5;
/// Pause between two attempts.
const RETRY: Duration = Duration::from_millis(1);

/// What a guard has done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GuardSummary {
    /// Silences of the loop that it has zeroed.
    pub silences: u64,
    /// Whether the session ended while its loop ran.
    pub abandoned: bool,
}

/// Guards the session whose socket is this process's standard input, until it ends. The force is zero on
/// return.
///
/// An error means that no session has started this process.
pub fn guard_stdin() -> io::Result<GuardSummary> {
    guard(sys::outlive_signals(c"haptic-guard")?)
}

/// As [`guard_stdin`], on a socket.
pub fn guard(mut socket: UnixStream) -> io::Result<GuardSummary> {
    socket.set_read_timeout(Some(SETUP_TIMEOUT))?;
    let mut bytes = [0; Setup::MAX_LEN];
    let (count, fds) = sys::receive_fds(&socket, &mut bytes)?;
    let [page, device, session] = <[OwnedFd; 3]>::try_from(fds).map_err(|_| ErrorKind::InvalidData)?;
    let setup = Setup::decode(&bytes[..count]).ok_or(ErrorKind::InvalidData)?;
    let page = Page::map(&page)?;
    let request = RtRequest {
        fifo_priority: setup.fifo_priority,
        keep_awake: false,
        lock_memory: setup.locks_memory,
        cpu: None,
    };
    let (report, _held) = sys::enter_real_time(&request);
    let fifo_priority = if let Policy::Fifo(priority) = report.policy { priority } else { 0 };
    page.beat_guard(sys::monotonic_ns());
    socket.write_all(&Ready { fifo_priority }.encode())?;
    let limit_ns = u64::from(setup.limit_ms) * 1_000_000;
    let mut server = Server {
        socket,
        session,
        path: GuardPath { fd: device, wire: setup.wire },
        page,
        watch: Watch::new(limit_ns),
        summary: GuardSummary::default(),
    };
    server.run();
    Ok(server.summary)
}

struct Server {
    socket: UnixStream,
    /// Readable when the session's process has ended.
    session: OwnedFd,
    path: GuardPath,
    page: Page,
    watch: Watch,
    summary: GuardSummary,
}

impl Server {
    fn run(&mut self) {
        loop {
            let now_ns = sys::monotonic_ns();
            self.page.beat_guard(now_ns);
            let beat_ns = self.page.loop_beat_ns();
            match self.watch.check(now_ns, beat_ns) {
                Action::Wait => {}
                action => {
                    if action == Action::CloseAndZero {
                        // Before the zero: a loop that resumes now must not send its old force after it.
                        self.page.close();
                        self.summary.silences += 1;
                    }
                    let is_refused = self.path.send_zero(&self.page).is_err_and(|error| !is_gone(&error));
                    self.watch.note_zero(now_ns, is_refused);
                }
            }
            let pause_ns = self.watch.pause_until_check_ns(now_ns, beat_ns);
            let ends = [self.session.as_fd(), self.socket.as_fd()];
            if sys::wait_any(ends, Duration::from_nanos(pause_ns)) && self.has_ended() {
                self.summary.abandoned = self.page.loop_beat_ns().is_some();
                self.page.close();
                self.zero_finally();
                return;
            }
        }
    }

    /// Whether the session has ended. It sends nothing after its first message.
    fn has_ended(&mut self) -> bool {
        if sys::wait_readable(self.session.as_fd(), Duration::ZERO) {
            return true;
        }
        if !sys::wait_readable(self.socket.as_fd(), Duration::ZERO) {
            return false;
        }
        !self.socket.read(&mut [0; 64]).is_ok_and(|count| count > 0)
    }

    /// The last zeros, each retried while the line does not accept it.
    fn zero_finally(&mut self) {
        let give_up_ns = sys::monotonic_ns() + FINAL_ZERO_TIMEOUT_NS;
        let mut left = if self.summary.abandoned { FINAL_ZEROS } else { 1 };
        while left > 0 && sys::monotonic_ns() < give_up_ns {
            self.page.beat_guard(sys::monotonic_ns());
            match self.path.send_zero(&self.page) {
                Ok(()) => left -= 1,
                Err(error) if is_gone(&error) => return,
                Err(_) => {}
            }
            if left > 0 {
                std::thread::sleep(RETRY);
            }
        }
    }
}

/// Whether the device or its cable is gone, so that no attempt can succeed.
fn is_gone(error: &io::Error) -> bool {
    use nix::errno::Errno;
    let gone = [Errno::ENODEV, Errno::ENXIO, Errno::EIO, Errno::EBADF, Errno::ESHUTDOWN, Errno::EPIPE];
    error.raw_os_error().is_some_and(|code| gone.contains(&Errno::from_raw(code)))
}
