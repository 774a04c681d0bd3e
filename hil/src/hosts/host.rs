//! A host process of the testbed: start, commands, signals, and status lines.

use nix::errno::Errno;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest wait for an event that must happen, on a busy machine.
pub const MAX_WAIT: Duration = Duration::from_secs(60);
/// How often a host is asked to hold its force.
const MAX_TRIES: usize = 30;
/// Longest time of one try.
const TRY_TIMEOUT: Duration = Duration::from_secs(3);
/// Longest wait for a force that may be there already.
const POLL_PERIOD: Duration = Duration::from_micros(100);

/// A host process. It is killed on drop.
pub struct Host {
    child: Child,
    words: ChildStdin,
    lines: Arc<Mutex<Vec<String>>>,
    /// Its output has ended.
    silent: Arc<AtomicBool>,
}

impl Host {
    /// Starts a host process.
    ///
    /// # Panics
    ///
    /// If it does not start.
    #[must_use]
    pub fn start(mut command: Command) -> Self {
        let mut child =
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts");
        let (words, output) = (child.stdin.take().expect("piped"), child.stdout.take().expect("piped"));
        let lines = Arc::new(Mutex::new(Vec::new()));
        let silent = Arc::new(AtomicBool::new(false));
        let (printed, ended) = (Arc::clone(&lines), Arc::clone(&silent));
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                printed.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
            ended.store(true, Ordering::Relaxed);
        });
        Self { child, words, lines, silent }
    }

    /// Its process.
    #[must_use]
    pub fn pid(&self) -> Pid {
        Pid::from_raw(self.child.id() as i32)
    }

    /// Sends a signal.
    ///
    /// # Panics
    ///
    /// If the process has ended.
    pub fn signal(&self, signal: Signal) {
        send(self.pid(), signal).expect("the process runs");
    }

    /// Sends a command; one to an ended process is lost.
    pub fn send(&self, word: &str) {
        let _ = (&self.words).write_all(format!("{word}\n").as_bytes());
    }

    /// Asks the host to stop resetting by itself, with its force on the motors. `has_force` checks whether
    /// the force is on the motors within a time. Returns the missing event after some tries.
    ///
    /// On a busy machine a watchdog may fire between the host's reply and this check. The host then releases
    /// and holds again.
    pub fn hold(&self, mut has_force: impl FnMut(Duration) -> bool) -> Result<(), &'static str> {
        let mut is_there = false;
        let _ = happens_within(MAX_WAIT, || {
            is_there = has_force(POLL_PERIOD);
            is_there || self.silent.load(Ordering::Relaxed)
        });
        if !is_there {
            return Err("no force");
        }
        for _ in 0..MAX_TRIES {
            if has_force(TRY_TIMEOUT) {
                self.send("hold");
                if !happens_within(MAX_WAIT, || self.has_printed("holds")) {
                    return Err("the host has not confirmed that it holds");
                }
                if has_force(TRY_TIMEOUT) && !self.has_printed("zeroed") {
                    return Ok(());
                }
                self.release()?;
            }
        }
        Err("the force was not held")
    }

    /// The host resets by itself again.
    pub fn release(&self) -> Result<(), &'static str> {
        self.send("again");
        if !happens_within(MAX_WAIT, || self.has_printed("again")) {
            return Err("the host has not confirmed the release");
        }
        self.remove_status_lines();
        Ok(())
    }

    /// Whether the host has printed this line.
    #[must_use]
    pub fn has_printed(&self, line: &str) -> bool {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).iter().any(|printed| printed == line)
    }

    /// Removes the status lines about holding.
    fn remove_status_lines(&self) {
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.retain(|line| !["holds", "again", "zeroed"].contains(&&line[..]));
    }

    /// The pid of its guard, once the host has printed it; `None` after a timeout.
    #[must_use]
    pub fn guard(&self) -> Option<Pid> {
        let mut found = None;
        let _ = happens_within(MAX_WAIT, || {
            let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
            found = lines.iter().find_map(|line| line.strip_prefix("guard ")?.parse().ok());
            found.is_some() || self.silent.load(Ordering::Relaxed)
        });
        found.map(Pid::from_raw)
    }

    /// Waits until it ends by itself. Returns whether it succeeded.
    ///
    /// # Panics
    ///
    /// If the wait fails.
    pub fn end(&mut self) -> bool {
        self.child.wait().expect("it ends by itself").success()
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits for an event.
///
/// # Panics
///
/// If it does not happen within [`MAX_WAIT`].
pub fn wait(what: &str, done: impl FnMut() -> bool) {
    assert!(happens_within(MAX_WAIT, done), "no {what}");
}

/// Whether an event happens within a time.
#[must_use]
pub fn happens_within(time: Duration, mut done: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    while !done() {
        if start.elapsed() >= time {
            return false;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    true
}

/// Sends a signal to a process.
pub fn send(process: Pid, signal: Signal) -> Result<(), Errno> {
    kill(process, signal)
}

/// Whether a process runs.
#[must_use]
pub fn is_running(process: Pid) -> bool {
    // An ended process may remain as a zombie for a moment.
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    !stat.is_empty() && !stat.contains(") Z ")
}
