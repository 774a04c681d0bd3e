//! The session's side of the start: it starts the solver's process, waits for the organ, and ends the process.

use super::channel::{self, LoopEnd, SolverView};
use super::message::{self, FromSession, FromSolver, Inbox};
use crate::blob_file::BlobFile;
use crate::sys::{self, Ended};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command};
use std::time::Duration;

/// How often a wait checks the stop flag.
const STOP_CHECK: Duration = Duration::from_millis(20);
/// Largest blob that is accepted, bytes: a damaged length must not cause a huge allocation.
const MAX_BLOB_LEN: u64 = 1 << 32;

/// Why there is no solver.
#[derive(Debug)]
pub enum StartError {
    /// The stop flag was set.
    Stopped,
    /// The solver refuses the scene: its line.
    Refused(String),
    /// The solver ended without an answer: how.
    Ended(String),
    /// The process could not be started, or it is not a solver of this version.
    Io(io::Error),
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stopped => f.write_str("stopped before the solver was ready"),
            Self::Refused(line) => f.write_str(line),
            Self::Ended(how) => write!(f, "the solver ended before it was ready ({how})"),
            Self::Io(error) if error.kind() == ErrorKind::InvalidData => {
                f.write_str("the solver is not of this version: build both again")
            }
            Self::Io(error) => write!(f, "cannot start the solver: {error}"),
        }
    }
}

impl core::error::Error for StartError {}

impl From<io::Error> for StartError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// A solver that is ready.
#[derive(Debug)]
pub struct Ready {
    /// The organ: surface and contacts, without tables of forces.
    pub blob: BlobFile,
    /// The end of the loop.
    pub for_loop: LoopEnd,
    /// The end of the viewer.
    pub view: SolverView,
    /// The process. The solver ends when it is dropped.
    pub process: SolverProcess,
}

/// The solver's process, or the thread at the other end of a socket.
#[derive(Debug)]
pub struct SolverProcess {
    inbox: Inbox,
    child: Option<Child>,
    ended: Ended,
}

/// Starts `command` as the solver and waits for the organ. Lines of progress go to `line` meanwhile.
///
/// The process has one end of a socket pair as its standard input, and its own process group: a Ctrl-C of the
/// terminal reaches the session only. The stop flag ends the wait, and the process, within 50 ms.
///
/// # Errors
///
/// [`StartError`]; the process has then ended.
pub fn start(command: Command, stop: &AtomicBool, line: impl FnMut(&str)) -> Result<Ready, StartError> {
    let (ours, child) = sys::start_beside(command, "palpate-solver")?;
    // From here on a failure drops the process, which ends it.
    let mut process = SolverProcess { inbox: Inbox::new(ours), child: Some(child), ended: Ended::default() };
    let pid = process.pid().expect("it was started");
    process.ended = Ended::watch(sys::pidfd(pid)?, "palpate-solver")?;
    process.wait(stop, line)
}

/// As [`start`], with a solver that is already at the other end of `socket`.
///
/// # Errors
///
/// [`StartError`].
pub fn start_at(socket: UnixStream, stop: &AtomicBool, line: impl FnMut(&str)) -> Result<Ready, StartError> {
    SolverProcess { inbox: Inbox::new(socket), child: None, ended: Ended::default() }.wait(stop, line)
}

impl SolverProcess {
    /// Waits for the organ.
    fn wait(mut self, stop: &AtomicBool, mut line: impl FnMut(&str)) -> Result<Ready, StartError> {
        loop {
            if stop.load(Ordering::Relaxed) {
                return Err(StartError::Stopped);
            }
            match self.inbox.next(STOP_CHECK) {
                Ok(None) => {}
                Ok(Some(FromSolver::Line(text))) => line(&text),
                Ok(Some(FromSolver::Refused(text))) => return Err(StartError::Refused(text)),
                Ok(Some(FromSolver::Ready { vertices, blob_len })) => {
                    let [memory, blob] = self.inbox.take_fds().ok_or_else(incompatible)?;
                    let (for_loop, view) = channel::join(&memory, vertices as usize, self.ended.clone())?;
                    let blob = read_blob(blob, blob_len)?;
                    return Ok(Ready { blob, for_loop, view, process: self });
                }
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                    return Err(StartError::Ended(self.how_it_ended()));
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn how_it_ended(&mut self) -> String {
        match self.child.as_mut().map(Child::wait) {
            Some(Ok(status)) => status.to_string(),
            Some(Err(error)) => error.to_string(),
            None => "closed its socket".into(),
        }
    }

    /// Its process; `None` for a solver on a thread.
    #[must_use]
    pub fn pid(&self) -> Option<u32> {
        self.child.as_ref().map(Child::id)
    }

    /// Whether it has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended.has_ended()
    }

    /// Sends a line, in words that the command defines; `false` if the solver has not read enough of those before
    /// it. It does not wait.
    ///
    /// # Errors
    ///
    /// The solver has ended.
    pub fn tell(&self, line: &str) -> io::Result<bool> {
        message::send_now(self.inbox.socket(), &FromSession::Line(message::short(line)))
    }

    /// The next line of the solver, if one arrives within `timeout`.
    ///
    /// # Errors
    ///
    /// The solver has ended, or it sends other bytes.
    pub fn next_line(&mut self, timeout: Duration) -> io::Result<Option<String>> {
        match self.inbox.next(timeout) {
            Ok(Some(FromSolver::Line(text) | FromSolver::Refused(text))) => Ok(Some(text)),
            Ok(Some(FromSolver::Ready { .. })) => Err(ErrorKind::InvalidData.into()),
            Ok(None) => Ok(None),
            Err(error) => {
                self.ended.note();
                Err(error)
            }
        }
    }
}

impl Drop for SolverProcess {
    /// Ends the solver at once: it drives no device, and what it stores survives a kill.
    fn drop(&mut self) {
        let _ = self.inbox.socket().shutdown(std::net::Shutdown::Both);
        if let Some(child) = &mut self.child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// The error of a process that is not a solver of this version.
fn incompatible() -> io::Error {
    ErrorKind::InvalidData.into()
}

fn read_blob(fd: OwnedFd, len: u64) -> Result<BlobFile, StartError> {
    let file = File::from(fd);
    if len > MAX_BLOB_LEN || file.metadata()?.len() != len {
        return Err(incompatible().into());
    }
    Ok(BlobFile::of_file(file)?)
}
