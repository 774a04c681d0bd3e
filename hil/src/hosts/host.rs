//! A host process on the stage: started, spoken to, signalled, and waited for.

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long what must happen is waited for, however busy the machine.
pub const CERTAIN: Duration = Duration::from_secs(60);
/// How often a host is told to hold its force.
const TRIES: usize = 30;
/// How long one try may take.
const TRY: Duration = Duration::from_secs(3);
/// How long a force that may be there already is waited for.
const LOOK: Duration = Duration::from_micros(100);

/// A host process. Ends with this.
pub struct Host {
    child: Child,
    words: ChildStdin,
    lines: Arc<Mutex<Vec<String>>>,
    /// It says nothing any more.
    silent: Arc<AtomicBool>,
}

impl Host {
    /// Starts one.
    ///
    /// # Panics
    ///
    /// If it does not start.
    #[must_use]
    pub fn start(mut command: Command) -> Self {
        let mut child =
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts");
        let (words, said) = (child.stdin.take().expect("piped"), child.stdout.take().expect("piped"));
        let lines = Arc::new(Mutex::new(Vec::new()));
        let silent = Arc::new(AtomicBool::new(false));
        let (heard, ended) = (Arc::clone(&lines), Arc::clone(&silent));
        std::thread::spawn(move || {
            for line in BufReader::new(said).lines().map_while(Result::ok) {
                heard.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
            ended.store(true, Ordering::Relaxed);
        });
        Self { child, words, lines, silent }
    }

    /// Sends a signal.
    ///
    /// # Panics
    ///
    /// If it is not there.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it is there");
    }

    /// Says a word to it; one that is gone does not hear it.
    pub fn say(&self, word: &str) {
        let _ = (&self.words).write_all(format!("{word}\n").as_bytes());
    }

    /// From now on it resets nothing by itself, and its force is on the motors. An error is what did not come in a few tries. `has_force`
    /// looks whether the force gets there in some time.
    ///
    /// A watchdog on a busy machine may fire between its word and the look at the force; it then goes back, and holds anew.
    pub fn hold(&self, mut has_force: impl FnMut(Duration) -> bool) -> Result<(), &'static str> {
        let mut is_there = false;
        let _ = comes(CERTAIN, || {
            is_there = has_force(LOOK);
            is_there || self.silent.load(Ordering::Relaxed)
        });
        if !is_there {
            return Err("no force");
        }
        for _ in 0..TRIES {
            if has_force(TRY) {
                self.say("hold");
                if !comes(CERTAIN, || self.said("holds")) {
                    return Err("no word that the host holds");
                }
                if has_force(TRY) && !self.said("zeroed") {
                    return Ok(());
                }
                self.release()?;
            }
        }
        Err("no force that is held")
    }

    /// It resets again what a busy machine trips.
    pub fn release(&self) -> Result<(), &'static str> {
        self.say("again");
        if !comes(CERTAIN, || self.said("again")) {
            return Err("no word that the host goes back");
        }
        self.forget();
        Ok(())
    }

    /// Whether it has said this.
    #[must_use]
    pub fn said(&self, line: &str) -> bool {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).iter().any(|said| said == line)
    }

    /// Forgets what it has said of holding.
    fn forget(&self) {
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.retain(|line| !["holds", "again", "zeroed"].contains(&&line[..]));
    }

    /// Its supervisor, once it has said which; nothing if it does not in time.
    #[must_use]
    pub fn supervisor(&self) -> Option<Pid> {
        let mut found = None;
        let _ = comes(CERTAIN, || {
            let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
            found = lines.iter().find_map(|line| line.strip_prefix("supervisor ")?.parse().ok());
            found.is_some() || self.silent.load(Ordering::Relaxed)
        });
        found.map(Pid::from_raw)
    }

    /// Waits until it ends by itself; whether it ended well.
    ///
    /// # Panics
    ///
    /// If it is not ours to wait for.
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

/// Waits until something has happened.
///
/// # Panics
///
/// If it has not in [`CERTAIN`].
pub fn wait(what: &str, done: impl FnMut() -> bool) {
    assert!(comes(CERTAIN, done), "no {what}");
}

/// Whether something happens in time.
#[must_use]
pub fn comes(time: Duration, mut done: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while !done() {
        if begun.elapsed() >= time {
            return false;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    true
}

/// Whether a process is there.
#[must_use]
pub fn is_running(process: Pid) -> bool {
    // An ended one whose parent was killed may lie about as a zombie for a moment.
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    !stat.is_empty() && !stat.contains(") Z ")
}
