//! `palpate run --device touch`: a stand-in for the maker's library, through the loading path of a user's.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_hd_stub::{Cable, Field, VARIABLE};

use super::guard::files_of;
use super::{quiet, text};

/// The stand-in, which cargo builds for these tests.
fn library() -> PathBuf {
    let tests = std::env::current_exe().expect("a test");
    let library = tests.parent().expect("a folder").join("libpalpate_hd_stub.so");
    assert!(library.exists(), "{}", library.display());
    library
}

/// The device behind the stand-in with a hand that presses its button, then pushes and stays.
struct Hand {
    cable: Arc<Cable>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    folder: tempfile::TempDir,
}

impl Hand {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let cable = Arc::new(Cable::create(&folder.path().join("device")).expect("a file"));
        let (ends, moved) = (Arc::new(AtomicBool::new(false)), cable.clone());
        let has_ended = ends.clone();
        let thread = std::thread::spawn(move || {
            let mut begun: Option<Instant> = None;
            while !has_ended.load(Ordering::Relaxed) {
                if begun.is_none() && moved.whole(Field::Frames) > 100 {
                    begun = Some(Instant::now());
                }
                let s = begun.map_or(0.0, |begun| begun.elapsed().as_secs_f64());
                let height_mm = 8.0 - 14.0 * (s - 0.8).clamp(0.0, 1.0);
                // Not quite still: a hand trembles.
                moved.set_quantity(Field::Position(2), height_mm + 0.2 * (40.0 * s).sin());
                moved.set_whole(Field::Buttons, u64::from((0.3..0.5).contains(&s)));
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self { cable, ends, thread: Some(thread), folder }
    }

    fn session(&self) -> Child {
        let (blob, profile) = files_of(self.folder.path(), "touch");
        Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(["run", text(&blob), "--uncertified", "--profile", text(&profile)])
            .args(["--device", &format!("touch:{}", text(&library()))])
            .args(["--headless", "--frame-rate", "0", "--seconds", "20"])
            .env(VARIABLE, self.folder.path().join("device"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it runs")
    }

    /// Size of the force on the motors, N.
    fn force_n(&self) -> f64 {
        let squares = (0..3).map(|axis| self.cable.quantity(Field::Force(axis)).powi(2));
        squares.sum::<f64>().sqrt()
    }

    /// Waits until the hand feels the body.
    fn wait_pressing(&self) {
        let give_up = Instant::now() + Duration::from_secs(20);
        while self.force_n() < 0.2 {
            assert!(Instant::now() < give_up, "no force: {} frames", self.cable.whole(Field::Frames));
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Milliseconds from a time to the last frame with a force; negative before it.
    fn last_force_ms(&self, since_ns: u64) -> f64 {
        (self.cable.whole(Field::Forced) as f64 - since_ns as f64) * 1e-6
    }
}

impl Drop for Hand {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.take().expect("it runs").join().expect("no panic");
    }
}

fn send(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
}

fn end(child: Child) -> Output {
    send(&child, Signal::SIGINT);
    child.wait_with_output().expect("it ends")
}

/// The process that holds the library: a child of the session with its name.
fn proxy_of(child: &Child) -> Pid {
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

#[test]
fn the_hand_feels_the_body_and_the_session_says_what_it_drives() {
    let _quiet = quiet();
    let hand = Hand::new();
    let session = hand.session();
    hand.wait_pressing();
    let output = end(session);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        said.contains("Touch emulated (OpenHaptics 3.4.0)"),
        "{said}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(hand.force_n(), 0.0);
}

/// Killed or stopped: zero after 4 ms without a new force, 20 ms are allowed. A session that goes on stays without a force.
#[test]
fn a_session_that_is_killed_or_stopped_leaves_no_force() {
    for signal in [Signal::SIGKILL, Signal::SIGSTOP] {
        let _quiet = quiet();
        let hand = Hand::new();
        let session = hand.session();
        hand.wait_pressing();
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

/// The library's amplifiers come back by themselves 0.3 s after an exceeded limit, and it resumes after a stall.
#[test]
fn the_force_stays_off_where_the_library_resumes() {
    for stalls in [false, true] {
        let _quiet = quiet();
        let hand = Hand::new();
        let session = hand.session();
        hand.wait_pressing();
        let at_ns = Cable::now_ns();
        if stalls {
            hand.cable.set_whole(Field::Stalled, 1);
            std::thread::sleep(Duration::from_millis(100));
            hand.cable.set_whole(Field::Stalled, 0);
        } else {
            hand.cable.set_whole(Field::Error, 0x203);
            hand.cable.set_whole(Field::Errors, 1);
        }
        std::thread::sleep(Duration::from_millis(600));
        let last_ms = hand.last_force_ms(at_ns);
        println!("stall {stalls}: the last force {last_ms:.1} ms after it");
        assert!(last_ms < 10.0 && hand.force_n() == 0.0, "{stalls}: {last_ms} ms, {} N", hand.force_n());
        let output = end(session);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(stalls || said.contains("the velocity limit is exceeded (0x203)"), "{said}");
        assert!(String::from_utf8_lossy(&output.stdout).contains("latched"), "{output:?}");
    }
}

#[test]
fn a_session_whose_proxy_is_killed_ends() {
    let _quiet = quiet();
    let hand = Hand::new();
    let session = hand.session();
    hand.wait_pressing();
    kill(proxy_of(&session), Signal::SIGKILL).expect("it runs");
    let output = session.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("device lost"), "{said}");
}

#[test]
fn a_device_that_is_not_there_or_in_use_is_one_line() {
    for (code, fix) in [(0x302_u64, "check cable and power"), (0x304, "end the other program")] {
        let hand = Hand::new();
        hand.cable.set_whole(Field::Refused, code);
        let output = hand.session().wait_with_output().expect("it ends");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        let about: Vec<&str> = said.lines().filter(|line| line.contains("no Touch can be opened")).collect();
        assert!(about.len() == 1 && about[0].contains(fix), "{said}");
    }
}
