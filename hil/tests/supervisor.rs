//! The supervisor against emulated devices, in real time: hosts that are killed, stopped and hang.
//!
//! A host and its supervisor are processes: this test's own file, started again for one of the `process_` functions at the end. Only the order of
//! things is asserted, with bounds that a busy machine keeps; the times are printed (`--nocapture`).

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_core::{Vec3, vec3};
use palpate_hil::{EmulatedFalcon, EmulatedPolhem, FalconConfig, Handle, MemoryFtdi, PtyTransport};
use palpate_host::device::DeviceState;
use palpate_host::device::falcon::{self, Falcon};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::supervisor::{Supervised, serve, serve_stdin};
use palpate_host::sys::{self, Policy, RtRequest};
use palpate_host::{Device, DeviceErrorKind};
use serialport::SerialPort;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What the host process asks for, N.
const FORCE_N: Vec3 = [0.0, 0.0, 1.5];
/// How long what must happen is waited for, however busy the machine.
const CERTAIN: Duration = Duration::from_secs(20);
/// What the supervisor allows itself: its limit and a loaded machine's scheduling. The target is 20 ms.
const GENEROUS: Duration = Duration::from_millis(500);
const LIMIT_MS: u32 = 10;

/// What the device has felt.
#[derive(Debug, Clone, Copy)]
struct Felt {
    force_n: Vec3,
    /// Good requests so far.
    requests: u64,
    /// When the newest request that left a force on the motors was taken.
    forced: Option<Instant>,
    /// When the force last became zero.
    released: Option<Instant>,
}

/// A Polhem on a pseudo terminal, with a thread that serves it.
struct Bench {
    felt: Arc<Mutex<Felt>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    port: String,
    folder: tempfile::TempDir,
    /// Holds the terminal open.
    _driver_end: serialport::TTYPort,
}

impl Bench {
    fn new() -> Self {
        let (mut link, driver_end) = PtyTransport::pair().expect("a pseudo terminal");
        let felt = Felt { force_n: vec3::ZERO, requests: 0, forced: None, released: None };
        let (felt, ends) = (Arc::new(Mutex::new(felt)), Arc::new(AtomicBool::new(false)));
        let (seen, stop) = (Arc::clone(&felt), Arc::clone(&ends));
        let serve = move || {
            let mut device = EmulatedPolhem::new(Handle::new(Vec::new()));
            let begun = Instant::now();
            while !stop.load(Ordering::Relaxed) {
                device.poll(begun.elapsed().as_micros() as u64, &mut link).expect("the terminal is open");
                let now = Instant::now();
                let mut felt = seen.lock().unwrap_or_else(PoisonError::into_inner);
                let force_n = device.force_n();
                if device.requests() > felt.requests && force_n != vec3::ZERO {
                    felt.forced = Some(now);
                }
                if force_n == vec3::ZERO && felt.force_n != vec3::ZERO {
                    felt.released = Some(now);
                }
                (felt.force_n, felt.requests) = (force_n, device.requests());
                drop(felt);
                std::thread::sleep(Duration::from_micros(100));
            }
        };
        let port = driver_end.name().expect("a terminal has a name");
        let folder = tempfile::tempdir().expect("a folder");
        Self { felt, ends, thread: Some(std::thread::spawn(serve)), port, folder, _driver_end: driver_end }
    }

    fn felt(&self) -> Felt {
        *self.felt.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn host(&self, function: &str) -> Host {
        let mut command = process(function, &self.port, self.folder.path());
        Host(command.stdout(Stdio::null()).spawn().expect("this file starts"))
    }

    /// Waits until the device has the host's force on its motors, for a while on end.
    fn wait_for_force(&self) {
        wait("a force", || {
            let before = self.felt().requests;
            std::thread::sleep(Duration::from_millis(20));
            self.felt().force_n == FORCE_N && self.felt().requests > before
        });
    }

    /// From now on the host does not reset anything by itself.
    fn hold(&self) {
        std::fs::write(self.file("hold"), []).expect("a file");
        wait("the host holds", || self.file("holds").exists());
        self.wait_for_force();
    }

    fn supervisor(&self) -> Pid {
        let text = std::fs::read_to_string(self.file("supervisor")).expect("the host has written it");
        Pid::from_raw(text.parse().expect("a process id"))
    }

    /// Nothing but zero for so long, and requests all the while if `alive`.
    fn assert_zero_for(&self, time: Duration, alive: bool) {
        let (begun, before) = (Instant::now(), self.felt().requests);
        while begun.elapsed() < time {
            assert_eq!(self.felt().force_n, vec3::ZERO, "after {:?}", begun.elapsed());
            std::thread::sleep(Duration::from_micros(200));
        }
        if alive {
            assert!(self.felt().requests > before, "somebody still talks to the device");
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Ends with the test.
struct Host(Child);

impl Host {
    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.0.id() as i32), signal).expect("it is there");
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < CERTAIN, "no {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn is_running(process: Pid) -> bool {
    // An ended one whose parent was killed may lie about as a zombie for a moment.
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    !stat.is_empty() && !stat.contains(") Z ")
}

fn ms(from: Instant, to: Option<Instant>) -> f64 {
    to.expect("it happened").duration_since(from).as_secs_f64() * 1e3
}

#[test]
fn a_killed_host_is_zeroed_by_its_supervisor() {
    let mut worst: f64 = 0.0;
    for _ in 0..5 {
        let bench = Bench::new();
        let host = bench.host("process_host");
        bench.hold();
        let supervisor = bench.supervisor();
        let killed = Instant::now();
        host.signal(Signal::SIGKILL);
        wait("zero", || bench.felt().force_n == vec3::ZERO);
        let felt = bench.felt();
        let (after_kill, after_force) =
            (ms(killed, felt.released), ms(felt.forced.expect("forces came"), felt.released));
        println!(
            "host killed: zero {after_kill:.1} ms after the signal, {after_force:.1} ms after the last force"
        );
        worst = worst.max(after_force);
        assert!(felt.released.expect("zero") > killed, "the kill took it away, not a fault before it");
        wait("end of the supervisor", || !is_running(supervisor));
        bench.assert_zero_for(Duration::from_millis(100), false);
    }
    println!("host killed: worst of 5: {worst:.1} ms from the last force to zero");
    assert!(worst < GENEROUS.as_secs_f64() * 1e3, "{worst} ms");
}

/// The same without a supervisor: what takes the force away above is the supervisor and nothing else.
#[test]
fn a_killed_host_without_a_supervisor_leaves_the_force() {
    let bench = Bench::new();
    let host = bench.host("process_host_alone");
    bench.hold();
    host.signal(Signal::SIGKILL);
    let begun = Instant::now();
    while begun.elapsed() < GENEROUS {
        assert_eq!(bench.felt().force_n, FORCE_N, "the device has no watchdog");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_stopped_host_is_zeroed_and_stays_so_when_it_goes_on_until_reset() {
    let bench = Bench::new();
    let host = bench.host("process_host");
    bench.hold();
    let stopped = Instant::now();
    host.signal(Signal::SIGSTOP);
    wait("zero", || bench.felt().force_n == vec3::ZERO);
    let felt = bench.felt();
    let (after_stop, after_force) =
        (ms(stopped, felt.released), ms(felt.forced.expect("forces came"), felt.released));
    println!(
        "host stopped: zero {after_stop:.1} ms after the signal, {after_force:.1} ms after the last force"
    );
    assert!(felt.released.expect("zero") > stopped && after_force < GENEROUS.as_secs_f64() * 1e3);
    // Its requests go on, once a limit: a zero may be lost.
    bench.assert_zero_for(Duration::from_millis(200), true);
    assert!(!bench.file("zeroed").exists(), "the host sleeps");

    host.signal(Signal::SIGCONT);
    wait("word that it was zeroed", || bench.file("zeroed").exists());
    // The host sends its force as before, and nobody listens.
    bench.assert_zero_for(Duration::from_millis(300), true);
    assert!(is_running(bench.supervisor()));

    std::fs::write(bench.file("reset"), []).expect("a file");
    wait("the force again", || bench.felt().force_n == FORCE_N);
}

/// Nothing can zero then; the host knows at once, and that is all.
#[test]
fn a_killed_supervisor_ends_the_loop_and_leaves_the_force() {
    let bench = Bench::new();
    let mut host = bench.host("process_host");
    bench.hold();
    kill(bench.supervisor(), Signal::SIGKILL).expect("it is there");
    let ended = host.0.wait().expect("it ends by itself");
    assert!(ended.success());
    assert_eq!(std::fs::read_to_string(bench.file("end")).expect("its last word"), "Disconnected");
    assert_eq!(bench.felt().force_n, FORCE_N, "a hazard: docs/safety.md, section 6");
}

/// A supervisor that stood still itself does not obey what it missed, and does not blame the host.
#[test]
fn a_supervisor_that_was_stopped_obeys_the_present_only() {
    let bench = Bench::new();
    let _host = bench.host("process_host");
    bench.hold();
    let supervisor = bench.supervisor();
    kill(supervisor, Signal::SIGSTOP).expect("it is there");
    std::thread::sleep(Duration::from_millis(100));
    kill(supervisor, Signal::SIGCONT).expect("it is there");
    wait("requests", || {
        let before = bench.felt().requests;
        std::thread::sleep(Duration::from_millis(20));
        bench.felt().requests > before + 3
    });
    assert!(is_running(supervisor));
}

/// A Falcon in memory, so its supervisor is a thread; homed through it, and then its host hangs. Times are the emulated device's.
#[test]
fn a_falcon_is_zeroed_when_its_host_hangs() {
    let config = FalconConfig { firmware_runs: true, ..FalconConfig::default() };
    let ftdi = MemoryFtdi::in_real_time(EmulatedFalcon::new(config));
    let seen = ftdi.open_again().expect("it is plugged in");
    let (ours, theirs) = UnixDatagram::pair().expect("a socket pair");
    let open = move || {
        let config = falcon::FalconConfig { mode: falcon::Mode::Polled, ..falcon::FalconConfig::default() };
        Falcon::start(Arc::new(ftdi), config, None).map_err(|error| error.to_string())
    };
    let supervisor = std::thread::spawn(move || serve(&theirs, Policy::Other, open));
    let mut device = Supervised::with_socket(ours, LIMIT_MS).expect("it opens the device");
    assert_eq!(device.state(), DeviceState::FirmwareLoaded);
    assert!(device.home(&AtomicBool::new(false)).expect("it is there"), "the hand homes it");
    // A pause before the loop is no silence.
    std::thread::sleep(Duration::from_millis(100));
    assert!(!device.was_zeroed() && seen.falcon().felt().largest_unhomed_n == 0.0);

    let begun = Instant::now();
    let tick = |device: &mut Supervised| {
        std::thread::sleep(Duration::from_millis(1));
        let now_us = begun.elapsed().as_micros() as u64;
        let sample = device.exchange(now_us, FORCE_N);
        assert!(
            !matches!(sample, Ok(Some(sample)) if sample.t_us > now_us),
            "{sample:?}: of the time of homing"
        );
        seen.falcon().now_us()
    };
    let is_forced = || seen.falcon().felt().off_since_us.is_none();
    let mut last_us = 0;
    wait("a force", || {
        last_us = tick(&mut device);
        if device.was_zeroed() {
            device.reset();
        }
        is_forced()
    });
    wait("zero", || !is_forced());
    let off_us = seen.falcon().felt().off_since_us.expect("zero");
    println!(
        "host of a Falcon hangs: zero {:.1} ms after its last tick",
        off_us.saturating_sub(last_us) as f64 * 1e-3
    );
    assert!(off_us - last_us < GENEROUS.as_micros() as u64);
    for _ in 0..100 {
        tick(&mut device);
        assert!(!is_forced(), "a heartbeat and no more");
    }
    assert!(device.was_zeroed());
    wait("the force again", || {
        device.reset();
        tick(&mut device);
        is_forced()
    });
    drop(device);
    let served = supervisor.join().expect("no panic").expect("it was spoken to");
    assert!(served.silences > 0 && !is_forced(), "{served:?}");
}

fn process(function: &str, port: &str, folder: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("a test has a file"));
    command.args(["--ignored", "--exact", function]).env("TEST_PORT", port).env("TEST_FOLDER", folder);
    command
}

fn given(name: &str) -> String {
    std::env::var(name).expect("started by a test of this file")
}

/// A thousand times a second until the device is gone. Resets by itself what a busy machine trips, until it is told to hold.
fn render(mut device: impl Device) {
    let folder = PathBuf::from(given("TEST_FOLDER"));
    let (_, _held) =
        sys::enter_real_time(&RtRequest { lock_memory: false, keep_awake: false, ..RtRequest::default() });
    let begun = sys::monotonic_ns();
    for tick in 0_u64.. {
        sys::sleep_until_ns(begun + tick * 1_000_000);
        let now_us = (sys::monotonic_ns() - begun) / 1_000;
        match device.exchange(now_us, FORCE_N) {
            Err(error) if !error.kind().is_passing() => {
                std::fs::write(folder.join("end"), format!("{:?}", error.kind())).expect("a file");
                assert_eq!(error.kind(), DeviceErrorKind::Disconnected);
                return;
            }
            Ok(Some(sample)) => assert!(sample.t_us <= now_us),
            _ => {}
        }
        let holds = folder.join("hold").exists();
        if device.was_zeroed() {
            if holds && folder.join("holds").exists() {
                std::fs::write(folder.join("zeroed"), []).expect("a file");
            } else {
                device.reset();
            }
        }
        if holds && !folder.join("holds").exists() {
            std::fs::write(folder.join("holds"), []).expect("a file");
        }
        if folder.join("reset").exists() {
            device.reset();
        }
    }
}

#[test]
#[ignore = "a host process of the tests above"]
fn process_host() {
    let folder = PathBuf::from(given("TEST_FOLDER"));
    let supervisor = process("process_supervisor", &given("TEST_PORT"), &folder);
    let device =
        Supervised::start(supervisor, LIMIT_MS, &AtomicBool::new(false)).expect("it opens the device");
    let pid = device.supervision().pid.expect("a process");
    std::fs::write(folder.join("supervisor"), pid.to_string()).expect("a file");
    render(device);
}

#[test]
#[ignore = "a host process of the tests above"]
fn process_host_alone() {
    render(Polhem::open(&given("TEST_PORT"), PolhemConfig::default()).expect("it wakes"));
}

#[test]
#[ignore = "a supervisor process of the tests above"]
fn process_supervisor() {
    let (_, _held) = sys::enter_real_time(&RtRequest {
        fifo_priority: Some(51),
        keep_awake: false,
        ..RtRequest::default()
    });
    let open =
        || Polhem::open(&given("TEST_PORT"), PolhemConfig::default()).map_err(|error| error.to_string());
    let served = serve_stdin(Policy::Other, open).expect("a host");
    eprintln!("supervisor: {served:?}");
}
