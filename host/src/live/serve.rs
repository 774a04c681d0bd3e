//! The solver's side of the start: it reports, gives the organ, and ends with the session.

use super::channel::{self, SolverEnd};
use super::message::{self, FromSession, FromSolver, Inbox};
use crate::sys::{self, Ended};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::prctl;
use nix::sys::signal::Signal;
use std::fs::File;
use std::io::{self, Seek, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::mpsc;
use std::time::Duration;

/// How often the thread that reads the socket returns to it.
const READ_CHECK: Duration = Duration::from_secs(1);

/// A solver that is starting. It ends with the session from its first moment.
#[derive(Debug)]
pub struct Service {
    socket: UnixStream,
    session: Ended,
    lines: mpsc::Receiver<String>,
}

impl Service {
    /// Serves the session whose socket is this process's standard input. The process exits when the session
    /// ends: the kernel closes the socket whatever ended it.
    ///
    /// # Errors
    ///
    /// No session has started this process.
    pub fn of_stdin() -> io::Result<Self> {
        let socket = UnixStream::from(io::stdin().as_fd().try_clone_to_owned()?);
        socket.peer_addr()?;
        // A process that is stopped when the session ends resumes, and exits.
        prctl::set_pdeathsig(Signal::SIGCONT)?;
        Self::serve(socket, || std::process::exit(0))
    }

    /// Serves the session at the other end of `socket`, on a thread of its process or of a test.
    ///
    /// # Errors
    ///
    /// The thread that reads the socket cannot be started.
    pub fn at(socket: UnixStream) -> io::Result<Self> {
        Self::serve(socket, || {})
    }

    fn serve(socket: UnixStream, at_end: impl FnOnce() + Send + 'static) -> io::Result<Self> {
        let session = Ended::default();
        let (to, lines) = mpsc::channel();
        let (mut inbox, ended) = (Inbox::new(socket.try_clone()?), session.clone());
        std::thread::Builder::new().name("palpate-session".into()).spawn(move || {
            loop {
                match inbox.next(READ_CHECK) {
                    // Nobody may want lines any more; the end of the session still counts.
                    Ok(Some(FromSession::Line(line))) => drop(to.send(line)),
                    Ok(None) => {}
                    Err(_) => break,
                }
            }
            ended.note();
            at_end();
        })?;
        Ok(Self { socket, session, lines })
    }

    /// Reports a line of progress.
    ///
    /// # Errors
    ///
    /// The session has ended.
    pub fn report(&self, line: &str) -> io::Result<()> {
        message::send(&self.socket, &FromSolver::Line(message::short(line)), &[])
    }

    /// Refuses the scene, with one line for the user.
    ///
    /// # Errors
    ///
    /// The session has ended.
    pub fn refuse(self, line: &str) -> io::Result<()> {
        message::send(&self.socket, &FromSolver::Refused(message::short(line)), &[])
    }

    /// Gives the organ to the session: the loop may begin. `vertices` is the number of vertices of its surface.
    ///
    /// # Errors
    ///
    /// The session has ended, or there is no memory.
    pub fn ready(self, blob: &[u8], vertices: usize) -> io::Result<Serving> {
        let (end, memory) = channel::create(vertices, self.session.clone())?;
        end.heart().beat(sys::monotonic_ns());
        let mut file = File::from(memfd_create(c"palpate-organ", MFdFlags::MFD_CLOEXEC)?);
        file.write_all(blob)?;
        file.rewind()?;
        let ready = FromSolver::Ready { vertices: vertices as u32, blob_len: blob.len() as u64 };
        message::send(&self.socket, &ready, &[memory.as_fd(), file.as_fd()])?;
        Ok(Serving { end, service: self })
    }
}

/// A solver whose session runs.
#[derive(Debug)]
pub struct Serving {
    /// The solver's end of the shared memory.
    pub end: SolverEnd,
    service: Service,
}

impl Serving {
    /// The next line of the session, if there is one.
    pub fn next_line(&self) -> Option<String> {
        self.service.lines.try_recv().ok()
    }

    /// Waits for a line of the session, for at most `timeout`.
    pub fn wait_line(&self, timeout: Duration) -> Option<String> {
        self.service.lines.recv_timeout(timeout).ok()
    }

    /// Sends a line to the session; `false` if the session has not read enough of those before it. It does not
    /// wait: a session that reads no lines must not stop the solver.
    ///
    /// # Errors
    ///
    /// The session has ended.
    pub fn report(&self, line: &str) -> io::Result<bool> {
        message::send_now(&self.service.socket, &FromSolver::Line(message::short(line)))
    }
}
