//! `palpate run --device haply` on an emulated Inverse Service.

use std::fs::File;
use std::io::BufReader;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use palpate_core::vec3;
use palpate_hil::haply::{Held, Reply, Service, World, now_ns};
use palpate_record::Recording;

use super::guard::files_of;
use super::maker::{Push, SEEN, end, pressing, proxy_of, send};
use super::{device_thread, quiet, text};

/// Largest force of the bundled profile, N.
const LIMIT_N: f64 = 5.0;

/// The emulated device with a hand that presses the grip's button, then pushes and stays.
struct Hand {
    service: Arc<Service>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    folder: tempfile::TempDir,
}

impl Hand {
    fn new() -> Self {
        Self::of(World::default())
    }

    fn of(world: World) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        // Its threads have the priority of this one.
        let service = device_thread(move || Service::start(world).expect("free ports"));
        let service = Arc::new(service.join().expect("it starts"));
        let (ends, moved) = (Arc::new(AtomicBool::new(false)), service.clone());
        let has_ended = ends.clone();
        let thread = device_thread(move || {
            let mut push = Push::default();
            while !has_ended.load(Ordering::Relaxed) {
                moved.with(|world| {
                    let (down, tremor, button) = push.now(world.messages > SEEN, world.held().size_n() > 0.1);
                    // Not quite still: a hand trembles.
                    world.position_m[2] = 1e-3 * (8.0 - 24.0 * down + 0.2 * tremor);
                    world.button = button;
                });
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self { service, ends, thread: Some(thread), folder }
    }

    fn session_with(&self, address: &str, more: &[&str]) -> Child {
        let (blob, profile) = files_of(self.folder.path(), "haply");
        Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(["run", text(&blob), "--uncertified", "--profile", text(&profile)])
            .args(["--device", &format!("haply:{address}")])
            .args(["--headless", "--frame-rate", "0", "--seconds", "20"])
            .args(more)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it runs")
    }

    fn held(&self) -> Held {
        self.service.with(|world| world.held())
    }

    fn set(&self, change: impl FnOnce(&mut World)) {
        self.service.with(change);
    }

    /// A session, with more arguments, in which the hand feels the body.
    fn pressing(&self, more: &[&str]) -> Child {
        pressing(|| self.session_with(&self.service.address(), more), || self.held().size_n() >= 0.4)
    }

    /// There was no force from `limit_ms` after a time on, and there is none for 600 ms, although the hand still pushes.
    fn assert_stays_off(&self, what: &str, since_ns: u64, limit_ms: f64) {
        std::thread::sleep(Duration::from_millis(600));
        let held = self.held();
        let last_ms = (held.until_ns as f64 - since_ns as f64) * 1e-6;
        println!("{what}: the last force {last_ms:.1} ms after it");
        assert!(last_ms < limit_ms && held.size_n() == 0.0, "{what}: {last_ms} ms, {held:?}");
    }
}

impl Drop for Hand {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.take().expect("it runs").join().expect("no panic");
        let (largest_n, pipelined) = self.service.with(|world| (world.held().largest_n, world.pipelined));
        if !std::thread::panicking() {
            assert!(largest_n <= LIMIT_N && pipelined == 0, "{largest_n} N, {pipelined} messages in flight");
        }
    }
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Both names of a force's vector, replies in two segments, in two frames and in a long one, pings between them, and another
/// device first in the list.
#[test]
fn the_hand_feels_the_body_whatever_the_service_is_like() {
    for (version, has_envelope, is_split, reply) in [
        ("3.5.1", true, false, Reply::Once),
        ("3.1.4", false, true, Reply::Once),
        ("4.0.0", true, false, Reply::Ping),
        ("3.5.1", true, false, Reply::Twice),
        ("3.5.1", true, false, Reply::Fragmented),
        ("3.5.1", true, false, Reply::Long),
    ] {
        let _quiet = quiet();
        let hand =
            Hand::of(World { version: version.into(), has_envelope, is_split, reply, ..World::default() });
        let session = hand.pressing(&[]);
        hand.set(|world| world.other_first = true);
        std::thread::sleep(Duration::from_millis(100));
        assert!(hand.held().size_n() > 0.3, "{version} {reply:?}");
        let output = end(session);
        let said = stdout(&output);
        let name = format!("Haply inverse3 049D (Inverse Service {version})");
        assert!(said.contains(&name), "{said}{}", stderr(&output));
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(hand.held().force_n, [0.0; 3], "{version}");
    }
}

#[test]
fn commanded_and_reported_force_are_recorded() {
    let _quiet = quiet();
    let hand = Hand::new();
    let file = hand.folder.path().join("session.mcap");
    let session = hand.pressing(&["--record", text(&file)]);
    std::thread::sleep(Duration::from_millis(200));
    let output = end(session);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let recording = Recording::open(BufReader::new(File::open(&file).expect("there"))).expect("sound");
    let mut both = 0;
    for record in recording.map(|record| record.expect("sound")) {
        let Some(reported_n) = record.reported_n else { continue };
        // A tick or two lie between a command and its report.
        let off_n = vec3::distance(reported_n, record.hand_force_n);
        both += u32::from(vec3::norm(record.hand_force_n) > 0.3 && off_n < 0.2);
    }
    assert!(both > 100, "{both} ticks");
}

/// Killed or stopped: zero after 4 ms without a new force, 20 ms are allowed. A session that goes on stays without a force.
#[test]
fn a_session_that_is_killed_or_stopped_leaves_no_force() {
    for signal in [Signal::SIGKILL, Signal::SIGSTOP] {
        let _quiet = quiet();
        let hand = Hand::new();
        let session = hand.pressing(&[]);
        let at_ns = now_ns();
        send(&session, signal);
        hand.assert_stays_off(signal.as_str(), at_ns, 20.0);
        if signal == Signal::SIGSTOP {
            send(&session, Signal::SIGCONT);
            hand.assert_stays_off("continued", at_ns, 20.0);
            let output = end(session);
            assert!(stdout(&output).contains("watchdog"), "{}", stdout(&output));
        } else {
            session.wait_with_output().expect("it has ended");
        }
    }
}

#[test]
fn faults_of_device_and_service_are_latched() {
    type Make = fn(&Hand);
    let event: Make =
        |hand| hand.service.event("device-safety-triggered", "warning", "FOD stage changed: guard -> hard");
    let unready: Make = |hand| {
        hand.set(|world| world.flags.ready = false);
        std::thread::sleep(Duration::from_millis(30));
        hand.set(|world| world.flags.ready = true);
    };
    let no_power: Make = |hand| hand.set(|world| world.flags.power_supply = false);
    let gone: Make = |hand| {
        hand.set(|world| world.is_present = false);
        std::thread::sleep(Duration::from_millis(30));
        hand.set(|world| world.is_present = true);
    };
    for (what, make, news) in [
        ("event", event, "Haply device-safety-triggered: FOD stage changed: guard -> hard"),
        ("ready", unready, "is not ready"),
        ("power", no_power, "has no power"),
        ("gone", gone, "is gone; check its cable"),
    ] {
        let _quiet = quiet();
        let hand = Hand::new();
        let session = hand.pressing(&[]);
        let at_ns = now_ns();
        make(&hand);
        hand.assert_stays_off(what, at_ns, 10.0);
        let output = end(session);
        assert!(stderr(&output).contains(news), "{what}: {}", stderr(&output));
        let said = stdout(&output);
        assert!(said.contains("latched") || said.contains("not ready"), "{what}: {said}");
    }
}

/// With the name that it does not know, a service renders nothing and says nothing.
#[test]
fn a_service_that_ignores_the_force_is_found() {
    let _quiet = quiet();
    let hand = Hand::new();
    let session = hand.pressing(&[]);
    hand.set(|world| world.applies = false);
    std::thread::sleep(Duration::from_millis(200));
    let at_ns = now_ns();
    hand.set(|world| world.applies = true);
    hand.assert_stays_off("ignored", at_ns, 0.0);
    let output = end(session);
    assert!(
        stderr(&output).contains("the service does not apply the force (commanded"),
        "{}",
        stderr(&output)
    );
}

/// No zero can follow a command that has no reply, so the connection is ended.
#[test]
fn a_late_or_missing_reply_or_a_closed_connection_leaves_no_force() {
    for reply in [Reply::Late(50), Reply::Late(500), Reply::Never, Reply::Close] {
        let _quiet = quiet();
        let hand = Hand::new();
        let session = hand.pressing(&[]);
        let at_ns = now_ns();
        hand.set(|world| world.reply = reply);
        hand.assert_stays_off(&format!("{reply:?}"), at_ns, 20.0);
        let output = session.wait_with_output().expect("it ends");
        let said = stderr(&output);
        assert!(output.status.code() == Some(1) && said.contains("device lost"), "{reply:?}: {said}");
        assert!(said.contains("the connection to the Haply Inverse Service has ended"), "{reply:?}: {said}");
    }
}

/// Late by less than the fault: the touch goes on.
#[test]
fn replies_that_are_a_little_late_are_waited_for() {
    let _quiet = quiet();
    let hand = Hand::new();
    let session = hand.pressing(&[]);
    hand.set(|world| world.reply = Reply::Late(1));
    std::thread::sleep(Duration::from_millis(300));
    let held = hand.held();
    let output = end(session);
    assert!(held.size_n() > 0.2, "{held:?}: {}{}", stdout(&output), stderr(&output));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn a_session_whose_proxy_is_killed_ends_without_a_force() {
    let _quiet = quiet();
    let hand = Hand::new();
    let session = hand.pressing(&[]);
    let at_ns = now_ns();
    kill(proxy_of(&session), Signal::SIGKILL).expect("it runs");
    hand.assert_stays_off("killed proxy", at_ns, 20.0);
    let output = session.wait_with_output().expect("it ends");
    assert!(
        output.status.code() == Some(1) && stderr(&output).contains("device lost"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_device_that_cannot_be_used_is_one_line_with_the_fix() {
    type Change = fn(&mut World);
    let changes: [(Change, &str); 7] = [
        (|world| world.version = "2.4.0".into(), "2.4.0 is too old; install 3.0 or newer"),
        (|world| world.version = String::new(), "states no version"),
        (|world| world.is_present = false, "has no Inverse3; check cable and power"),
        (|world| world.flags.in_use = true, "end the other program"),
        (|world| world.flags.power_supply = false, "switch on its power supply"),
        (|world| world.flags.calibrated = false, "calibrate it in the Haply Hub"),
        (|world| world.flags.ready = false, "is not ready"),
    ];
    let refused = |hand: &Hand, address: &str, fix: &str| {
        let output = hand.session_with(address, &[]).wait_with_output().expect("it ends");
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert_eq!(said.lines().filter(|line| !line.contains("warning")).count(), 1, "one line, not: {said}");
        assert!(said.contains(fix), "{fix}: {said}");
        assert_eq!(hand.service.with(|world| world.messages), 0, "nothing is sent to the device");
    };
    for (change, fix) in changes {
        let mut world = World::default();
        change(&mut world);
        let hand = Hand::of(world);
        refused(&hand, &hand.service.address(), fix);
    }
    let hand = Hand::new();
    refused(&hand, "127.0.0.1:9", "start it (systemctl start haply-inverse-service)");
}
