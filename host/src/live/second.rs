//! A second session on the same body, as a process of its own: one that fails leaves the other one its device.

use super::partner::{LinkState, PartnerLink};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use nix::sys::prctl;
use nix::sys::signal::Signal;
use nix::unistd::getppid;
use std::io::{self, BufRead, BufReader, Read};
use std::os::fd::AsFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often a wait looks again.
const LOOK: Duration = Duration::from_millis(20);
/// A second session that nobody waits for is killed after this time.
const LAST_WAIT: Duration = Duration::from_secs(2);

/// Why there is no second session.
#[derive(Debug)]
pub enum SecondError {
    /// The stop flag was set.
    Stopped,
    /// It ended before its first tick: how, and its last line.
    Ended(ExitStatus, String),
    /// The process could not be started.
    Io(io::Error),
}

impl fmt::Display for SecondError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stopped => f.write_str("stopped before the second session was ready"),
            Self::Ended(how, line) if line.is_empty() => {
                write!(f, "the second session ended before its first tick ({how})")
            }
            Self::Ended(_, line) => write!(f, "second tool: {line}"),
            Self::Io(error) => write!(f, "cannot start the second session: {error}"),
        }
    }
}

impl core::error::Error for SecondError {}

impl From<io::Error> for SecondError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// The process of a second session. It ends when this is dropped.
#[derive(Debug)]
pub struct SecondSession {
    child: Child,
    state: LinkState,
    report: Option<JoinHandle<String>>,
    /// Gives the last line that it wrote before its first tick.
    lines: Option<JoinHandle<String>>,
}

impl SecondSession {
    /// Starts `command` with the link as its standard input. What it prints is its report; the lines that it writes to
    /// standard error go to `line`.
    ///
    /// # Errors
    ///
    /// [`SecondError::Io`].
    pub fn start(
        mut command: Command,
        line: impl Fn(&str) + Send + 'static,
    ) -> Result<(PartnerLink, Self), SecondError> {
        let (link, theirs) = PartnerLink::create()?;
        command.stdin(theirs).stdout(Stdio::piped()).stderr(Stdio::piped());
        // From here on an error drops the session, which ends the child.
        let child = command.spawn()?;
        let mut session = Self { child, state: link.state(), report: None, lines: None };
        let no_pipe = || io::Error::from(io::ErrorKind::BrokenPipe);
        let mut printed = session.child.stdout.take().ok_or_else(no_pipe)?;
        let written = BufReader::new(session.child.stderr.take().ok_or_else(no_pipe)?);
        let report = std::thread::Builder::new().name("palpate-second".into()).spawn(move || {
            let mut text = String::new();
            // What was read before an error counts.
            let _ = printed.read_to_string(&mut text);
            text
        })?;
        session.report = Some(report);
        let started = session.state.clone();
        let lines = std::thread::Builder::new().name("palpate-second-lines".into()).spawn(move || {
            // The last line before the first tick may be why there is none.
            let mut last = String::new();
            for next in written.lines().map_while(Result::ok) {
                if !last.is_empty() {
                    line(&std::mem::take(&mut last));
                }
                if started.is_ready() {
                    line(&next);
                } else {
                    last = next;
                }
            }
            last
        })?;
        session.lines = Some(lines);
        Ok((link, session))
    }

    /// Waits until its device is open.
    ///
    /// # Errors
    ///
    /// [`SecondError`].
    pub fn wait_ready(&mut self, stop: &AtomicBool) -> Result<(), SecondError> {
        while !self.state.is_ready() {
            if stop.load(Ordering::Relaxed) {
                return Err(SecondError::Stopped);
            }
            if let Some(how) = self.child.try_wait()? {
                let line = self.lines.take().and_then(|lines| lines.join().ok());
                return Err(SecondError::Ended(how, line.unwrap_or_default()));
            }
            std::thread::sleep(LOOK);
        }
        Ok(())
    }

    /// Ends its loop, as that of this session has ended.
    pub fn end_loop(&self) {
        self.state.end();
    }

    /// Waits for its report, and returns how it ended. The stop flag ends the wait, and the process.
    ///
    /// # Errors
    ///
    /// An error of the system.
    pub fn end(mut self, stop: &AtomicBool) -> io::Result<(ExitStatus, String)> {
        self.state.end();
        let how = loop {
            if let Some(how) = self.child.try_wait()? {
                break how;
            }
            if stop.load(Ordering::Relaxed) {
                break self.kill()?;
            }
            std::thread::sleep(LOOK);
        };
        let report = self.report.take().and_then(|report| report.join().ok());
        drop(self.lines.take().map(JoinHandle::join));
        Ok((how, report.unwrap_or_default()))
    }

    /// Waits for a moment, in which its loop zeroes its device, then kills it: the guard of a real device zeroes it.
    fn kill(&mut self) -> io::Result<ExitStatus> {
        let begun = Instant::now();
        while begun.elapsed() < LAST_WAIT {
            if let Some(how) = self.child.try_wait()? {
                return Ok(how);
            }
            std::thread::sleep(LOOK);
        }
        self.child.kill()?;
        self.child.wait()
    }
}

impl Drop for SecondSession {
    fn drop(&mut self) {
        self.state.end();
        // Nobody is left to tell.
        let _ = self.kill();
    }
}

/// The link of a process that a first session has started. `stop` is set when the loop of that session ends, unless the own one
/// has ended before.
///
/// # Errors
///
/// No session has started this process.
pub fn link_of_stdin(stop: Arc<AtomicBool>) -> io::Result<PartnerLink> {
    let link = PartnerLink::join(&io::stdin().as_fd().try_clone_to_owned()?)?;
    // The signal ends a session as the user does.
    prctl::set_pdeathsig(Signal::SIGTERM)?;
    let state = link.state();
    if getppid().as_raw() == 1 {
        // The first session was gone before it could be watched.
        state.end();
    }
    std::thread::Builder::new().name("palpate-first".into()).spawn(move || {
        while !state.has_ended() && !state.is_over() {
            std::thread::sleep(LOOK);
        }
        if !state.is_over() {
            stop.store(true, Ordering::SeqCst);
        }
    })?;
    Ok(link)
}
