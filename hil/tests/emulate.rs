//! `palpate-hil emulate` as a process on a pseudo terminal, with the real driver.

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_core::{Organ, Vec3, vec3};
use palpate_hil::session::golden_organ;
use palpate_host::device::DeviceState;
use palpate_host::device::link::{Link, LinkConfig};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::profile::Profile;
use palpate_host::{Device, sys};
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Longest wait for an event that must happen, on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(20);
const ORGAN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-like-core/golden/organ-514.blob");

/// The process, killed on drop.
struct Emulator(Child);

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the emulator, opens the driver on its terminal, requests a force while the hand is in the organ,
/// and ends the emulator with Ctrl-C.
fn renders_a_force(kind: &str, open: impl FnOnce(&str, &Profile) -> Box<dyn Device>) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate-hil"));
    command.args(["emulate", kind, "--organ", ORGAN]).stdout(Stdio::piped());
    let mut emulator = Emulator(command.spawn().expect("it starts"));
    let mut output = BufReader::new(emulator.0.stdout.take().expect("piped"));
    let mut line = || {
        let mut line = String::new();
        output.read_line(&mut line).expect("it prints a line");
        line.trim().to_owned()
    };
    let port = line();
    assert_eq!(line(), format!("palpate run {ORGAN} --device {kind}:{port}"));

    let blob = golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("golden");
    let node = &organ.spaces[0];
    let height_m =
        |at_m: Vec3| vec3::dot(vec3::sub(at_m, node.active.rest_position_m), node.active.outward_normal);
    let push_n = vec3::scale(node.active.outward_normal, 1.5);

    let profile = Profile::bundled(kind).expect("bundled");
    let mut device = open(&port, &profile);
    assert_eq!(device.state(), DeviceState::Homed);
    let (start, mut pressed, mut deepest_m, mut force_n) = (Instant::now(), false, 0.0f32, vec3::ZERO);
    // A device that was zeroed on a busy machine takes no force: enough commands must reach it.
    let mut sent = 0;
    while !pressed || deepest_m > -0.002 || sent < 10 {
        assert!(start.elapsed() < TIMEOUT, "button {pressed}, deepest {deepest_m} m");
        let now_us = start.elapsed().as_micros() as u64;
        // On a busy machine the link may fail or the watchdog may fire. Both are tolerated here.
        if let Ok(Some(sample)) = device.exchange(now_us, force_n) {
            sent += u32::from(force_n != vec3::ZERO && !device.was_zeroed());
            let height_m = height_m(sample.position_m);
            // The hand presses the button above the organ, and then moves in.
            pressed |= sample.buttons & 1 != 0 && height_m > 0.005;
            if pressed {
                deepest_m = deepest_m.min(height_m);
                force_n = if height_m < 0.0 { push_n } else { vec3::ZERO };
            }
        }
        if device.was_zeroed() {
            device.reset();
        }
        sys::sleep_until_ns(sys::monotonic_ns() + 1_000_000);
    }
    drop(device);

    kill(Pid::from_raw(emulator.0.id() as i32), Signal::SIGINT).expect("the process runs");
    let mut summary = String::new();
    output.read_to_string(&mut summary).expect("its summary");
    assert!(emulator.0.wait().expect("it ends").success(), "{summary}");
    println!("{kind}: {summary}");
    assert!(summary.contains("largest force 1.50 N; frames lost 0, "), "{summary}");
}

#[test]
fn an_emulated_link_renders_a_force_on_its_terminal() {
    renders_a_force("link", |port, profile| {
        let config = LinkConfig::of(profile, TIMEOUT).expect("it has a [capstan]");
        let mut device = Link::open(port, 1_000_000, config).expect("it answers");
        assert!(device.home(&AtomicBool::new(false)).expect("it is connected"));
        Box::new(device)
    });
}

#[test]
fn an_emulated_polhem_renders_a_force_on_its_terminal() {
    renders_a_force("polhem", |port, profile| {
        let config = PolhemConfig { workspace: profile.workspace, ..PolhemConfig::default() };
        Box::new(Polhem::open(port, config).expect("it wakes"))
    });
}

#[test]
fn invalid_arguments_are_refused() {
    for (arguments, word) in [
        (&["emulate", "link", "--faults", "2"][..], "--faults"),
        (&["emulate", "link", "--seconds=-1"], "--seconds"),
        (&["emulate", "link", "--profile", "polhem"], "capstan"),
        (&["emulate", "polhem", "--organ", "/no/such.blob"], "/no/such.blob"),
    ] {
        let ran =
            Command::new(env!("CARGO_BIN_EXE_palpate-hil")).args(arguments).output().expect("it starts");
        let output = String::from_utf8_lossy(&ran.stderr);
        assert!(!ran.status.success() && output.contains(word), "{arguments:?}: {output}");
    }
}
