//! Tests `palpate run` on a Polhem and its guard, killed and stopped while the hand pushes on the organ. Only
//! the device is emulated.

#[path = "../../host/tests/common/synthetic.rs"]
mod synthetic;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_core::{Organ, Vec3, vec3};
use palpate_hil::{EmulatedPolhem, Handle, PtyTransport, Waypoint};
use palpate_precompute::certificate::{Certificate, Health, Origin, SpaceCertificate, Verdict};
use serialport::SerialPort;
use std::fs::Permissions;
use std::io::ErrorKind;
use std::ops::Range;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::{device_thread, quiet, run};

/// Time limit for repeated sessions. On a busy machine the loop may miss its deadlines and fault, and the
/// session is then started again.
const PATIENCE: Duration = Duration::from_secs(240);
/// Longest time until a session reaches contact: the hand pushes [`Device::TOUCHES`] after the first request.
const SESSION: Duration = Duration::from_secs(4);
/// Smallest force that counts as contact, N.
const LEANS_N: f32 = 0.5;
/// The target is 20 ms; the margin is for a shared machine.
const GENEROUS: Duration = Duration::from_millis(500);

/// A certificate that says no more than that the spaces are numerically sound.
fn sound(names: &[String]) -> Vec<u8> {
    let health = |name: &String| SpaceCertificate {
        active: name.clone(),
        health: Some(Health {
            verdict: Verdict::Green,
            reasons: Vec::new(),
            reachable: 100,
            min_jacobian: 0.5,
            inverted: 0,
            unstable: 0,
            unknown_stability: 0,
            switched: 0,
            at_rounding_floor: 0,
            residual_n: 1e-12,
            condition: None,
            loop_passed: None,
            loop_stalled: false,
        }),
        ..SpaceCertificate::default()
    };
    let origin = Origin {
        scene: "synthetic ellipsoid".into(),
        content_hash: String::new(),
        law: "spring".into(),
        solver: String::new(),
        max_force_n: None,
        radius_m: 0.04,
        spacing_m: 0.01,
        complete_cells: false,
        scattered: None,
    };
    let certificate =
        Certificate { origin, spaces: names.iter().map(health).collect(), discretisation: None };
    serde_json::to_vec(&certificate).expect("plain data")
}

/// Blob and profile. Device z is the outward normal of the first active node, and its origin is on the
/// surface there.
pub(super) fn files(folder: &Path) -> (PathBuf, PathBuf) {
    files_of(folder, "polhem")
}

/// A blob, and the bundled profile of a device whose z axis is the normal at the first active node, where its origin is.
pub(super) fn files_of(folder: &Path, device: &str) -> (PathBuf, PathBuf) {
    let bytes = synthetic::certified_organ(&synthetic::Shape::default(), sound);
    let organ: Organ<'_> = Organ::read(&bytes).expect("a sound blob");
    let (blob, toml) = (folder.join("organ.blob"), folder.join("leaning.toml"));
    std::fs::write(&blob, &*bytes).expect("a file");
    let active = &organ.spaces[0].active;
    std::fs::write(&toml, profile_at(device, active.rest_position_m, active.outward_normal)).expect("a file");
    (blob, toml)
}

/// The bundled profile of a device whose z axis is `normal` and whose origin is at a place of the model, m.
pub(super) fn profile_at(device: &str, origin_m: Vec3, normal: Vec3) -> String {
    let first = vec3::normalize_or_zero(vec3::cross([0.3, 0.9, 0.1], normal));
    let second = vec3::cross(normal, first);
    let axes = [0, 1, 2].map(|i: usize| [first[i], second[i], normal[i]]);
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/devices");
    let own = std::fs::read_to_string(own.join(device).with_extension("toml")).expect("the bundled profile");
    let (head, _) = own.split_once("[mapping]").unwrap_or((&own, ""));
    format!("{head}\n[mapping]\naxes = {axes:?}\nmodel_origin_m = {origin_m:?}\n")
}

/// The force on the motors, and the time of the last request with a force.
#[derive(Debug, Clone, Copy)]
pub(super) struct Felt {
    pub(super) force_n: Vec3,
    pub(super) requests: u64,
    pub(super) forced: Option<Instant>,
}

/// An emulated device that presses its button after the first request and then pushes on the organ
/// repeatedly.
pub(super) struct Device {
    felt: Arc<Mutex<Felt>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    port: String,
    _driver_end: serialport::TTYPort,
}

impl Device {
    /// Time of the first contact, and half of the period of contacts.
    const TOUCHES: Duration = Duration::from_millis(400);

    pub(super) fn new() -> Self {
        Self::pressing(100..200)
    }

    /// A device whose button is pressed during these requests.
    fn pressing(presses: Range<u64>) -> Self {
        let (mut link, driver_end) = PtyTransport::pair().expect("a pseudo terminal");
        let felt = Arc::new(Mutex::new(Felt { force_n: vec3::ZERO, requests: 0, forced: None }));
        let ends = Arc::new(AtomicBool::new(false));
        let (seen, stop) = (Arc::clone(&felt), Arc::clone(&ends));
        let serve = move || {
            let at = |i: u64| Waypoint {
                t_us: i * Self::TOUCHES.as_micros() as u64,
                position_m: [0.0, 0.0, if i.is_multiple_of(2) { 0.006 } else { -0.010 }],
            };
            let mut device = EmulatedPolhem::new(Handle::new((0..200).map(at).collect()));
            let mut begun = None;
            while !stop.load(Ordering::Relaxed) {
                device.set_info(i16::from(presses.contains(&device.requests())));
                // The motion starts with the first request.
                let now = begun.map_or(Duration::ZERO, |begun: Instant| begun.elapsed());
                match device.poll(now.as_micros() as u64, &mut link) {
                    // Nobody reads: the session was killed, and a real device would lose its reply.
                    Err(error) if error.kind() == ErrorKind::TimedOut => {}
                    polled => polled.expect("the terminal is open"),
                }
                if device.requests() > 0 {
                    begun.get_or_insert_with(Instant::now);
                }
                let mut felt = seen.lock().unwrap_or_else(PoisonError::into_inner);
                if device.requests() > felt.requests && device.force_n() != vec3::ZERO {
                    felt.forced = Some(Instant::now());
                }
                (felt.force_n, felt.requests) = (device.force_n(), device.requests());
                drop(felt);
                std::thread::sleep(Duration::from_micros(100));
            }
        };
        let port = driver_end.name().expect("a terminal has a name");
        Self { felt, ends, thread: Some(device_thread(serve)), port, _driver_end: driver_end }
    }

    pub(super) fn felt(&self) -> Felt {
        *self.felt.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, (blob, profile): &(PathBuf, PathBuf), more: &[&str]) -> Session {
        let blob = blob.to_str().expect("plain");
        self.session(&["run", blob, "--uncertified"], profile, more)
    }

    /// `palpate` with this command on the device.
    pub(super) fn session(&self, command: &[&str], profile: &Path, more: &[&str]) -> Session {
        let child = Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(command)
            .args(["--headless", "--frame-rate", "0", "--seconds", "30"])
            .args(["--device", &format!("polhem:{}", self.port), "--profile"])
            .arg(profile)
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("palpate starts");
        Session(Some(child))
    }

    /// Waits until the hand pushes on the organ; false after `SESSION`.
    pub(super) fn leans(&self) -> bool {
        let begun = Instant::now();
        while begun.elapsed() < SESSION {
            if vec3::norm(self.felt().force_n) > LEANS_N {
                return true;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        false
    }

    /// Time from the last request with a force until zero force.
    fn released(&self) -> Option<Duration> {
        let begun = Instant::now();
        while begun.elapsed() < GENEROUS {
            let felt = self.felt();
            if let (true, Some(forced)) = (felt.force_n == vec3::ZERO, felt.forced) {
                return Some(forced.elapsed());
            }
            std::thread::sleep(Duration::from_micros(200));
        }
        None
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

pub(super) struct Session(Option<Child>);

impl Session {
    pub(super) fn pid(&self) -> Pid {
        Pid::from_raw(self.0.as_ref().expect("it runs").id() as i32)
    }

    pub(super) fn has_ended(&mut self) -> bool {
        self.0.as_mut().expect("it runs").try_wait().expect("the state of a child").is_some()
    }

    pub(super) fn signal(&self, signal: Signal) {
        kill(self.pid(), signal).expect("it is there");
    }

    /// The process whose parent is the session.
    fn guard(&self) -> Option<Pid> {
        let parent = self.pid().to_string();
        std::fs::read_dir("/proc").ok()?.flatten().find_map(|entry| {
            let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
            let (before, after) = stat.rsplit_once(") ")?;
            (after.split(' ').nth(1) == Some(&parent))
                .then(|| before.split(' ').next()?.parse().ok().map(Pid::from_raw))?
        })
    }

    pub(super) fn end(mut self) -> Output {
        self.0.take().expect("it runs").wait_with_output().expect("it ends")
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if let Some(mut child) = self.0.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// A device in contact in a running session; earlier sessions may end in a fault.
fn leaning(files: &(PathBuf, PathBuf), more: &[&str]) -> (Device, Session) {
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        let device = Device::new();
        let session = device.run(files, more);
        if device.leans() {
            return (device, session);
        }
        session.signal(Signal::SIGINT);
        let output = session.end();
        eprintln!(
            "begun anew after: {}{}",
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
    }
    panic!("no session came to touch the organ");
}

#[test]
fn a_killed_session_is_zeroed_by_its_guard() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let (device, session) = leaning(&files, &[]);
    let guard = session.guard().expect("a child");
    // Only its session ends the guard; it ignores the user's signals.
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        kill(guard, signal).expect("it is there");
    }
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(session.guard(), Some(guard), "it lives as long as its session");
    session.signal(Signal::SIGKILL);
    let released = device.released().expect("zero");
    println!("palpate run killed: zero {:.1} ms after the last force", released.as_secs_f64() * 1e3);
}

#[test]
fn a_session_whose_guard_is_killed_zeroes_the_device_and_ends() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let (device, session) = leaning(&files, &[]);
    kill(session.guard().expect("a child"), Signal::SIGKILL).expect("it is there");
    let released = device.released().expect("zero");
    println!("guard killed: zero {:.1} ms after the last force", released.as_secs_f64() * 1e3);
    let output = session.end();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("the guard process has ended"), "{text}");
}

#[test]
fn a_session_names_its_guard_and_ends_both() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let (device, session) = leaning(&files, &["--guard-ms", "15"]);
    let guard = session.guard().expect("a child");
    session.signal(Signal::SIGINT);
    let output = session.end();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains(&format!("guard        pid {guard}, zero after 15 ms")), "{text}");
    assert_eq!(device.felt().force_n, vec3::ZERO);
    assert!(!Path::new(&format!("/proc/{guard}")).exists(), "the port is free again");
}

/// With the motors off all else is as usual: the device is armed and in contact, and forces are computed and
/// shown, but the motors receive none.
#[test]
fn with_the_motors_off_no_force_ever_leaves() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let patient = Instant::now();
    while patient.elapsed() < PATIENCE {
        let device = Device::new();
        let mut session = device.run(&files, &["--motors-off"]);
        let begun = Instant::now();
        while begun.elapsed() < SESSION {
            assert_eq!(device.felt().force_n, vec3::ZERO, "a force with the motors off");
            std::thread::sleep(Duration::from_micros(500));
        }
        session.signal(Signal::SIGINT);
        let output = session.0.take().expect("it runs").wait_with_output().expect("it ends");
        assert_eq!(device.felt().forced, None, "a request with a force");
        assert!(device.felt().requests > 500, "{:?}", device.felt());
        let (out, shown) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(shown.contains(" mm, buttons ") && shown.contains("; not sent "), "{shown}");
        // On a busy machine the loop may fault before contact; the session is then started again.
        let computed =
            out.lines().find_map(|line| line.split_once("on the body, ")?.1.split(' ').next()?.parse().ok());
        if computed.is_some_and(|newtons: f32| newtons > LEANS_N) {
            assert!(out.contains(", motors off"), "{out}");
            return;
        }
        eprintln!("begun anew after: {out}{shown}");
    }
    panic!("no session came to touch the organ");
}

#[test]
fn a_device_that_cannot_be_opened_is_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let (blob, _) = files(folder.path());
    for (device, begin, words) in [
        ("polhem:/dev/no-such-port", "palpate: /dev", ["/dev/no-such-port", "check port and power"]),
        ("touch:/nowhere/libHD.so", "palpate: OpenHaptics (libHD)", ["/nowhere/libHD.so", "install it"]),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
        let device = ["--uncertified", "--headless", "--device", device];
        let output = run(command.arg("run").arg(&blob).args(device));
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert_eq!(text.lines().filter(|line| line.starts_with(begin)).count(), 1, "{text}");
    }
}

/// The first session keeps the port locked.
#[test]
fn a_second_session_on_one_device_is_refused() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let (device, session) = leaning(&files, &[]);
    let output = device.run(&files, &[]).end();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains(&device.port) && text.contains("in use by another program; end it"), "{text}");
    session.signal(Signal::SIGINT);
    session.end();
}

/// One line on standard error besides those of the real-time rights and of --json, and exit code 2.
#[track_caller]
fn refused(output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    let last = text.lines().last().unwrap_or_default();
    assert!(last.starts_with("palpate: "), "{text}");
    for word in words {
        assert!(last.contains(word), "`{word}` in {last}");
    }
}

/// The button of a device is held before the session begins, and stays so.
#[test]
fn a_button_that_is_held_at_the_start_ends_the_session_without_a_force() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let device = Device::pressing(0..u64::MAX);
    let record = folder.path().join("held.mcap");
    let output = device.run(&files, &["--record", record.to_str().expect("plain")]).end();
    refused(&output, &["the button that arms is held", "release it"]);
    let felt = device.felt();
    assert!(felt.requests > 0 && felt.forced.is_none() && felt.force_n == vec3::ZERO, "{felt:?}");
    assert!(!record.exists());
}

/// D and R would have no window.
#[test]
fn a_device_with_motors_without_a_display_needs_headless() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let (blob, profile) = files(folder.path());
    let device = Device::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command.arg("run").arg(blob).args(["--uncertified", "--profile"]).arg(profile);
    command.args(["--device", &format!("polhem:{}", device.port)]).current_dir(&folder);
    let output = command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").output().expect("it runs");
    refused(&output, &["no window", "--headless"]);
    assert_eq!(device.felt().requests, 0, "the device was not opened");
}

/// As root a port of mode 000 can be opened, so the session runs as a user without rights.
#[test]
fn a_port_without_permission_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let (blob, profile) = files(folder.path());
    let port = folder.path().join("port");
    std::fs::write(&port, "").expect("written");
    std::fs::set_permissions(&port, Permissions::from_mode(0o000)).expect("owned");
    let program = folder.path().join("palpate");
    std::fs::copy(env!("CARGO_BIN_EXE_palpate"), &program).expect("copied");
    let mut command = Command::new(program);
    if nix::unistd::geteuid().is_root() {
        std::fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).expect("owned");
        command.uid(65_534).gid(65_534);
    }
    command.arg("run").arg(blob).args(["--uncertified", "--headless", "--frame-rate", "0", "--profile"]);
    command.arg(profile).args(["--device", &format!("polhem:{}", port.display())]).current_dir("/");
    let output = run(&mut command);
    refused(&output, &["not permitted", "Permissions"]);
}

/// Runs `palpate control` and returns its JSON and its exit code.
fn control(socket: &Path, request: &str) -> (serde_json::Value, Option<i32>) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    let output = command.arg("control").arg(socket).arg(request).output().expect("it runs");
    (serde_json::from_slice(&output.stdout).unwrap_or_default(), output.status.code())
}

/// A session without a window: asked, disarmed in contact, reset and ended over its socket.
#[test]
fn a_headless_session_is_disarmed_and_ended_over_its_socket() {
    let _quiet = quiet();
    let folder = tempfile::tempdir().expect("a folder");
    let files = files(folder.path());
    let socket = folder.path().join("control");
    let name = socket.to_str().expect("plain");
    let (device, session) = leaning(&files, &["--control", name]);
    let (status, code) = control(&socket, "status");
    assert_eq!((code, status["armed"].as_bool()), (Some(0), Some(true)), "{status}");
    let (status, code) = control(&socket, "disarm");
    assert_eq!((code, status["armed"].as_bool()), (Some(0), Some(false)), "{status}");
    assert!(device.released().is_some());
    // The hand goes on pushing; the button stays released.
    let quiet_from = Instant::now();
    std::thread::sleep(4 * Device::TOUCHES);
    assert!(device.felt().forced.is_none_or(|forced| forced < quiet_from), "{:?}", device.felt());
    let (status, code) = control(&socket, "reset");
    assert_eq!((code, status["state"].as_str()), (Some(0), Some("homed, not armed")), "{status}");
    assert_eq!(control(&socket, "arm").1, Some(2), "no request arms");
    let beside = Device::new().run(&files, &["--control", name]).end();
    refused(&beside, &["another session is controlled there"]);
    assert_eq!(control(&socket, "end").1, Some(0));
    let output = session.end();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!socket.exists());
    assert_eq!(control(&socket, "status").1, Some(2), "it has ended");
}

#[test]
fn no_user_starts_a_guard() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    let output = run(command.arg("guard").stdin(Stdio::null()));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && text.contains("started by `palpate run`"), "{text}");
}
