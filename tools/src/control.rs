//! Control of a session over a Unix socket: disarm, reset, status and end. For a session without a window,
//! whose user has no keys.
//!
//! A connection sends one line, the name of a [`Request`], and receives one line of JSON. No request arms: arming
//! is an act of the hand at the device. The threads of the socket only set flags that the loop reads.

use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use palpate_core::{Phase, vec3};
use palpate_host::rt::{Controls, SessionState, TickRecord};
use palpate_host::sys;
use serde_json::{Value, json};

use crate::failure::Failure;

/// The group that may move the motors: host/deploy/72-palpate.rules.
const GROUP: &str = "palpate";
/// Largest number of connections at a time.
const MAX_CONNECTIONS: usize = 8;
/// Longest line of a request, bytes, and longest wait for it.
const MAX_LINE: u64 = 512;
const LINE_TIMEOUT: Duration = Duration::from_secs(1);
/// Longest wait until the loop has applied a request; a slow picture delays the records.
const APPLY_TIMEOUT: Duration = Duration::from_secs(2);
const APPLY_CHECK: Duration = Duration::from_millis(1);
/// Longest wait of a client for the answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// What a user may request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Request {
    /// The state of the session
    Status,
    /// Zero the force until the device is armed again
    Disarm,
    /// Clear a latched fault; the session stays disarmed
    Reset,
    /// End the session with zero force
    End,
    /// Change a value of the scene of a live session: set KEY=VALUE
    Set,
}

impl Request {
    fn name(self) -> String {
        self.to_possible_value().expect("every request has a name").get_name().into()
    }

    fn from_line(line: &str) -> Result<Self, Value> {
        Self::from_str(line.trim(), false).map_err(|_| {
            json!({ "error": format!("no request `{}`; give status, disarm, reset or end, or set KEY=VALUE", line.trim()) })
        })
    }
}

/// The newest record, and the requests that the loop has applied so far.
#[derive(Debug, Clone, Copy, Default)]
struct Newest {
    record: Option<TickRecord>,
    disarmed: u64,
    reset: u64,
}

#[derive(Debug)]
struct Shared {
    controls: Arc<Controls>,
    stop: Arc<AtomicBool>,
    newest: Mutex<Newest>,
    connections: AtomicUsize,
    /// Settings of a live session that were requested, oldest first; `None` in other sessions.
    settings: Mutex<Option<VecDeque<String>>>,
}

/// The socket of a session. Its file is removed when it is dropped.
#[derive(Debug)]
pub(crate) struct Control {
    path: PathBuf,
    shared: Arc<Shared>,
}

impl Control {
    /// Listens at `path`; `stop` ends the session.
    pub(crate) fn start(path: &Path, stop: Arc<AtomicBool>) -> Result<Self, Failure> {
        let listener = sys::listen(path, GROUP).map_err(|error| match error.kind() {
            ErrorKind::AddrInUse => Failure::input(format!(
                "{}: another session is controlled there; end it, or give another --control",
                path.display()
            )),
            ErrorKind::AlreadyExists => Failure::input(format!(
                "{}: is there and is no socket; give --control the name of a new file",
                path.display()
            )),
            _ => Failure::file(path, &error),
        })?;
        let shared = Arc::new(Shared {
            controls: Arc::default(),
            stop,
            newest: Mutex::default(),
            connections: AtomicUsize::new(0),
            settings: Mutex::default(),
        });
        let of_thread = Arc::clone(&shared);
        let accepts = std::thread::Builder::new().name("palpate-control".into());
        accepts
            .spawn(move || accept(&listener, &of_thread))
            .map_err(|error| Failure::work(format!("cannot start a thread: {error}")))?;
        Ok(Self { path: path.into(), shared })
    }

    /// The flags of the loop.
    pub(crate) fn controls(&self) -> Arc<Controls> {
        Arc::clone(&self.shared.controls)
    }

    /// The next setting of a live session that was requested. From the first call on they are accepted.
    pub(crate) fn take_setting(&self) -> Option<String> {
        let mut settings = self.shared.settings.lock().unwrap_or_else(PoisonError::into_inner);
        settings.get_or_insert_default().pop_front()
    }

    /// Takes every record, outside the loop's thread.
    pub(crate) fn take(&self, record: &TickRecord) {
        let mut newest = self.shared.newest.lock().unwrap_or_else(PoisonError::into_inner);
        newest.record = Some(*record);
        newest.disarmed += u64::from(record.applied.disarm);
        newest.reset += u64::from(record.applied.reset);
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        // The next session replaces it if it stays.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn accept(listener: &UnixListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        let Ok(stream) = stream else {
            // Out of descriptors, for example: not without a pause.
            std::thread::sleep(LINE_TIMEOUT);
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS {
            shared.connections.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let of_thread = Arc::clone(shared);
        let serve = move || {
            // A client that went away needs no answer.
            let _ = serve(&stream, &of_thread);
            of_thread.connections.fetch_sub(1, Ordering::Relaxed);
        };
        if std::thread::Builder::new().name("palpate-control".into()).spawn(serve).is_err() {
            shared.connections.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

fn serve(stream: &UnixStream, shared: &Shared) -> io::Result<()> {
    stream.set_read_timeout(Some(LINE_TIMEOUT))?;
    stream.set_write_timeout(Some(LINE_TIMEOUT))?;
    let mut line = String::new();
    BufReader::new(stream.take(MAX_LINE)).read_line(&mut line)?;
    let answer = match line.trim().strip_prefix("set ") {
        Some(setting) => shared.set(setting.trim()),
        None => Request::from_line(&line).map_or_else(|refused| refused, |request| shared.answer(request)),
    };
    let mut stream = stream;
    writeln!(stream, "{answer}")
}

impl Shared {
    fn newest(&self) -> Newest {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Passes a setting on to a live session, which prints what came of it.
    fn set(&self, setting: &str) -> Value {
        let mut settings = self.settings.lock().unwrap_or_else(PoisonError::into_inner);
        match settings.as_mut() {
            Some(settings) => settings.push_back(setting.into()),
            None => return json!({ "error": "only a live session can change its scene" }),
        }
        json!({ "requested": setting })
    }

    /// Performs a request and returns the state after it.
    fn answer(&self, request: Request) -> Value {
        let before = self.newest();
        match request {
            Request::Status | Request::Set => {}
            Request::Disarm => self.controls.disarm(),
            Request::Reset => self.controls.reset(),
            Request::End => self.stop.store(true, Ordering::SeqCst),
        }
        let is_applied = |newest: &Newest| match request {
            Request::Disarm => newest.disarmed > before.disarmed,
            Request::Reset => newest.reset > before.reset,
            Request::Status | Request::End | Request::Set => true,
        };
        // Before its first tick the session is disarmed, and that tick applies the request.
        let give_up = Instant::now() + APPLY_TIMEOUT;
        while before.record.is_some() && !is_applied(&self.newest()) {
            if Instant::now() >= give_up {
                let mut status = status(self.newest().record.as_ref());
                status["error"] = "the loop has not applied the request".into();
                return status;
            }
            std::thread::sleep(APPLY_CHECK);
        }
        status(self.newest().record.as_ref())
    }
}

/// The state of a session as JSON. Before the first tick the device is being opened or homed.
fn status(record: Option<&TickRecord>) -> Value {
    let Some(record) = record else { return json!({ "state": "opening", "armed": false, "fault": null }) };
    let fault = if let Phase::SafeZero(fault) = record.phase { Some(fault.name()) } else { None };
    json!({
        "state": SessionState::of(record).to_string(),
        "armed": record.phase == Phase::Active,
        "fault": fault,
        "tick": record.tick,
        "time_s": record.t_us as f64 * 1e-6,
        "hand_force_n": vec3::norm(record.hand_force_n),
        "missed_deadlines": record.skipped_periods,
    })
}

/// Sends a request to the session that listens at `path`; its answer, a line of JSON. The flag is set if the
/// session did not do as requested.
pub(crate) fn request(path: &Path, request: Request, setting: Option<&str>) -> io::Result<(String, bool)> {
    let mut stream = UnixStream::connect(path)?;
    stream.set_read_timeout(Some(ANSWER_TIMEOUT))?;
    writeln!(stream, "{} {}", request.name(), setting.unwrap_or_default())?;
    let mut answer = String::new();
    BufReader::new(stream).read_line(&mut answer)?;
    let parsed: Value = serde_json::from_str(&answer).map_err(|_| ErrorKind::UnexpectedEof)?;
    Ok((answer.trim_end().into(), parsed.get("error").is_some()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::Fault;
    use palpate_host::rt::Applied;

    fn socket() -> (tempfile::TempDir, PathBuf, Arc<AtomicBool>, Control) {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, stop) = (folder.path().join("control"), Arc::<AtomicBool>::default());
        let control = Control::start(&path, Arc::clone(&stop)).expect("it listens");
        (folder, path, stop, control)
    }

    fn raw(path: &Path, line: &str) -> Value {
        let mut stream = UnixStream::connect(path).expect("it listens");
        stream.write_all(line.as_bytes()).expect("sent");
        let mut answer = String::new();
        BufReader::new(stream).read_line(&mut answer).expect("an answer");
        serde_json::from_str(&answer).expect("JSON")
    }

    #[test]
    fn a_session_is_asked_and_ended_over_its_socket() {
        let (_folder, path, stop, control) = socket();
        assert_eq!(raw(&path, "status\n")["state"], "opening");
        let record = TickRecord { tick: 7, phase: Phase::SafeZero(Fault::Stale), ..TickRecord::EMPTY };
        control.take(&record);
        let status = raw(&path, "status\n");
        assert_eq!((&status["state"], &status["fault"]), (&"safe zero: stale".into(), &"stale".into()));
        assert!(!stop.load(Ordering::SeqCst));
        assert!(raw(&path, "set a.b=1\n")["error"].as_str().is_some_and(|e| e.contains("live")));
        assert_eq!(control.take_setting(), None);
        assert_eq!(raw(&path, "set a.b=1\n")["requested"], "a.b=1");
        assert_eq!(control.take_setting().as_deref(), Some("a.b=1"));
        let (_, is_refused) = request(&path, Request::End, None).expect("an answer");
        assert!(!is_refused && stop.load(Ordering::SeqCst));
        drop(control);
        assert!(!path.exists());
    }

    #[test]
    fn no_request_arms_and_a_long_line_is_refused() {
        let (_folder, path, _stop, control) = socket();
        for line in ["arm\n", "\n", &"x".repeat(1_000)] {
            let error = raw(&path, line)["error"].as_str().expect("refused").to_owned();
            assert!(error.contains("status, disarm, reset or end"), "{error}");
        }
        drop(control);
    }

    /// The answer to a request is the state after a tick that has applied it.
    #[test]
    fn a_request_waits_for_the_loop() {
        let (_folder, path, _stop, control) = socket();
        control.take(&TickRecord { phase: Phase::Active, ..TickRecord::EMPTY });
        let (_, is_refused) = request(&path, Request::Disarm, None).expect("an answer");
        assert!(is_refused, "no loop runs");
        let asks = std::thread::spawn(move || request(&path, Request::Reset, None).expect("an answer"));
        std::thread::sleep(Duration::from_millis(50));
        assert!(!asks.is_finished());
        let applied = Applied { reset: true, ..Applied::default() };
        control.take(&TickRecord { applied, ..TickRecord::EMPTY });
        let (answer, is_refused) = asks.join().expect("no panic");
        assert!(!is_refused && answer.contains("\"armed\":false"), "{answer}");
    }
}
