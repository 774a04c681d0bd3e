//! A hand on a stand-in for the library of a maker, and a session that drives it through the loading path of a user's.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_maker_stub::{Cable, Field, VARIABLE};

use super::guard::files_of;
use super::{device_thread, quiet, text};

/// The stand-in, which cargo builds for these tests.
pub(super) fn library() -> PathBuf {
    let tests = std::env::current_exe().expect("a test");
    let library = tests.parent().expect("a folder").join("libpalpate_maker_stub.so");
    assert!(library.exists(), "{}", library.display());
    library
}

/// Frames or messages, two a tick, after which a session has seen that the button is up.
pub(super) const SEEN: u64 = 400;

/// What a hand does that presses its button, then pushes for a second and stays. A session that starts slowly has not
/// seen the button: a hand that feels nothing goes back, and begins again.
#[derive(Debug, Default)]
pub(super) struct Push {
    begun: Option<Instant>,
    has_felt: bool,
}

impl Push {
    /// It begins to go back, and it begins again, s.
    const BACK_S: f64 = 2.9;
    const AGAIN_S: f64 = 4.0;

    /// The share of the way down now, a tremor from -1 to 1, and whether the button is down. `is_seen`: a session reads
    /// the device.
    pub(super) fn now(&mut self, is_seen: bool, feels: bool) -> (f64, f64, bool) {
        if self.begun.is_none() && is_seen {
            self.begun = Some(Instant::now());
        }
        let mut s = self.begun.map_or(0.0, |begun| begun.elapsed().as_secs_f64());
        self.has_felt |= feels && s < Self::BACK_S;
        if s > Self::AGAIN_S && !self.has_felt {
            (self.begun, s) = (Some(Instant::now()), 0.0);
        }
        let back = if self.has_felt { 0.0 } else { (s - Self::BACK_S).clamp(0.0, 1.0) };
        ((s - 0.8).clamp(0.0, 1.0) - back, (40.0 * s).sin(), (0.3..0.5).contains(&s))
    }
}

/// Size of the force on the motors, N.
fn force_n(cable: &Cable) -> f64 {
    (0..3).map(|axis| cable.quantity(Field::Force(axis)).powi(2)).sum::<f64>().sqrt()
}

/// The device behind the stand-in with a hand that presses its button, then pushes and stays.
pub(super) struct Hand {
    pub(super) cable: Arc<Cable>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    folder: tempfile::TempDir,
    /// As `--device` names it, and its bundled profile.
    names: [&'static str; 2],
}

impl Hand {
    /// A Touch counts in millimetres, other devices in metres.
    pub(super) fn on(device: &'static str, profile: &'static str, unit_m: f64) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let cable = Arc::new(Cable::create(&folder.path().join("device")).expect("a file"));
        let (ends, moved) = (Arc::new(AtomicBool::new(false)), cable.clone());
        let has_ended = ends.clone();
        let thread = device_thread(move || {
            let mut push = Push::default();
            while !has_ended.load(Ordering::Relaxed) {
                let (down, tremor, button) =
                    push.now(moved.whole(Field::Frames) > SEEN, force_n(&moved) > 0.1);
                let height_m = 0.008 - 0.014 * down;
                // Not quite still: a hand trembles.
                moved.set_quantity(Field::Position(2), (height_m + 0.2e-3 * tremor) / unit_m);
                moved.set_whole(Field::Buttons, u64::from(button));
                // The device's firmware outlives the process that commands it. A Touch has no watchdog here.
                let _ = moved.is_watched_off();
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self { cable, ends, thread: Some(thread), folder, names: [device, profile] }
    }

    pub(super) fn session(&self) -> Child {
        self.spawn(Stdio::null(), &[])
    }

    /// A session with this input.
    pub(super) fn session_at(&self, input: Stdio) -> Child {
        self.spawn(input, &[])
    }

    /// A session with more arguments.
    pub(super) fn session_with(&self, more: &[&str]) -> Child {
        self.spawn(Stdio::null(), more)
    }

    fn spawn(&self, input: Stdio, more: &[&str]) -> Child {
        let [device, profile] = self.names;
        let (blob, profile) = files_of(self.folder.path(), profile);
        Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(["run", text(&blob), "--uncertified", "--profile", text(&profile)])
            .args(["--device", &format!("{device}:{}", text(&library()))])
            .args(["--headless", "--frame-rate", "0", "--seconds", "20"])
            .args(more)
            .env(VARIABLE, self.folder.path().join("device"))
            .stdin(input)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it runs")
    }

    /// Size of the force on the motors, N.
    pub(super) fn force_n(&self) -> f64 {
        force_n(&self.cable)
    }

    /// A session, with more arguments, in which the hand feels the body.
    pub(super) fn pressing(&self, more: &[&str]) -> Child {
        pressing(|| self.session_with(more), || self.force_n() >= 0.2)
    }

    /// Milliseconds from a time to the last frame with a force; negative before it.
    pub(super) fn last_force_ms(&self, since_ns: u64) -> f64 {
        (self.cable.whole(Field::Forced) as f64 - since_ns as f64) * 1e-6
    }
}

impl Drop for Hand {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.take().expect("it runs").join().expect("no panic");
    }
}

/// Begins a session, and waits until its hand feels the body. A session that a pause of the machine has ended is begun
/// again: its fault is correct, and a virtual machine can pause at any time.
pub(super) fn pressing(begin: impl Fn() -> Child, feels: impl Fn() -> bool) -> Child {
    for _ in 0..3 {
        let mut session = begin();
        let give_up = Instant::now() + Duration::from_secs(20);
        while Instant::now() < give_up {
            if feels() {
                return session;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let said = said_by(&mut session);
        session.wait().expect("it ends");
        assert!(was_paused(&said), "no force: {said}");
        println!("begun again after a pause of the machine: {said}");
    }
    panic!("no force: the machine paused in each of three sessions");
}

/// Did a session end with the fault that a pause causes, and did its loop wake up more than 2 ms late?
fn was_paused(said: &str) -> bool {
    let late = said.lines().find_map(|line| line.strip_prefix("wake-up late"));
    let worst = late.and_then(|late| late.trim_end_matches(" us").rsplit(' ').next()?.parse::<f64>().ok());
    (said.contains("FAULT stale") || said.contains("FAULT watchdog"))
        && worst.is_some_and(|worst_us| worst_us > 2000.0)
}

pub(super) fn send(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
}

pub(super) fn end(child: Child) -> Output {
    send(&child, Signal::SIGINT);
    child.wait_with_output().expect("it ends")
}

/// Ends a session, and returns what it has said.
fn said_by(session: &mut Child) -> String {
    send(session, Signal::SIGINT);
    let mut said = String::new();
    session.stderr.take().expect("a pipe").read_to_string(&mut said).expect("text");
    session.stdout.take().expect("a pipe").read_to_string(&mut said).expect("text");
    said
}

/// The process that holds the library or the connection: a child of the session with its name.
pub(super) fn proxy_of(child: &Child) -> Pid {
    let is_proxy = |folder: &Path| {
        let status = std::fs::read_to_string(folder.join("status")).unwrap_or_default();
        let has = |line: &str| status.lines().any(|of| of.split_whitespace().eq(line.split_whitespace()));
        has("Name: haptic-device") && has(&format!("PPid: {}", child.id()))
    };
    let all = std::fs::read_dir("/proc").expect("Linux").flatten().map(|entry| entry.path());
    let found =
        all.filter(|folder| is_proxy(folder)).find_map(|folder| folder.file_name()?.to_str()?.parse().ok());
    Pid::from_raw(found.expect("a proxy"))
}

/// Killed or stopped: zero after 4 ms without a new force, 20 ms are allowed. A session that goes on stays without a force.
pub(super) fn killed_or_stopped(hand: impl Fn() -> Hand) {
    for signal in [Signal::SIGKILL, Signal::SIGSTOP] {
        let _quiet = quiet();
        let hand = hand();
        let session = hand.pressing(&[]);
        let at_ns = Cable::now_ns();
        send(&session, signal);
        std::thread::sleep(Duration::from_millis(300));
        let last_ms = hand.last_force_ms(at_ns);
        println!("{signal}: the last force {last_ms:.1} ms after it");
        assert!(last_ms < 20.0 && hand.force_n() == 0.0, "{signal}: {last_ms} ms, {} N", hand.force_n());
        if signal == Signal::SIGSTOP {
            send(&session, Signal::SIGCONT);
            std::thread::sleep(Duration::from_millis(500));
            assert!(hand.last_force_ms(at_ns) < 20.0, "it resumes without a force");
            let output = end(session);
            let said = String::from_utf8_lossy(&output.stdout);
            assert!(said.contains("watchdog"), "{said}");
        } else {
            session.wait_with_output().expect("it has ended");
        }
    }
}
