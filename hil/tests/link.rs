//! The driver of the device link on an emulated controller: checks beyond the contract of all devices.

use palpate_core::{Method, Organ, Phase as Control, Vec3, vec3};
use palpate_hil::fault::{FaultKind, Faults};
use palpate_hil::hosts::{self, Device, Role};
use palpate_hil::link::WATCHDOG_US;
use palpate_hil::matrix::Ended;
use palpate_hil::rig::{Rig, SerialRig, Wire};
use palpate_hil::session::{Session, golden_organ, press, with_loop};
use palpate_hil::{EmulatedLink, PtyTransport};
use palpate_host::DeviceErrorKind;
use palpate_host::device::DeviceState;
use palpate_host::device::fence::Fence;
use palpate_host::device::link::{Link, LinkConfig, LinkError};
use palpate_host::device::nonblocking_port::NonBlockingPort;
use palpate_host::device::profile::Profile;
use palpate_host::guard::DEFAULT_LIMIT_MS;
use palpate_link::DeviceFault;
use std::path::Path;
use std::time::Duration;

const FORCE_N: Vec3 = [0.5, -0.5, 1.5];

fn rig() -> SerialRig<EmulatedLink> {
    SerialRig::new(Wire::Memory, 3)
}

fn homed(rig: &mut SerialRig<EmulatedLink>) -> Session<'_> {
    let workspace = rig.profile().workspace;
    Session::homed(rig, workspace).expect("homing succeeds")
}

fn forced(session: &mut Session<'_>) {
    for _ in 0..10 {
        session.tick(FORCE_N).expect("a fault-free link");
    }
    assert!(
        vec3::distance(session.rig.force_record().force_n, FORCE_N) < 1e-3,
        "{:?}",
        session.rig.force_record()
    );
}

/// Requests a force for some ticks. Returns the error of the last one.
fn pushed(session: &mut Session<'_>, ticks: u32) -> Option<DeviceErrorKind> {
    (0..ticks).map(|_| session.tick(FORCE_N).err().map(|error| error.kind())).last().flatten()
}

#[test]
fn a_silent_host_is_zeroed_by_the_devices_watchdog() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    forced(&mut session);
    let silent_us = session.now_us();
    session.pass(30_000);
    let off_us = session.rig.force_record().off_since_us.expect("without a force");
    println!("silent host: zero {} us after its last tick", off_us - silent_us);
    assert!(off_us - silent_us <= u64::from(WATCHDOG_US), "{off_us}");
    // The host resumes with its old force. The fault is latched, identified, and reported once.
    assert_eq!(pushed(&mut session, 50), Some(DeviceErrorKind::Faulted(DeviceFault::Watchdog)));
    assert!(session.device().was_zeroed() && !session.device().was_zeroed());
    assert_eq!(session.rig.force_record().force_n, vec3::ZERO);
    // Only the user's reset starts another session.
    session.device().reset();
    pushed(&mut session, 10);
    assert!(vec3::distance(session.rig.force_record().force_n, FORCE_N) < 1e-3);
}

#[test]
fn a_restarted_device_is_a_fault_and_renders_only_after_a_reset() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    forced(&mut session);
    session.rig.inject(FaultKind::PowerCycle);
    let fault_us = session.now_us();
    // The restarted device has no session and does not answer. The driver gives up after twice the time of
    // the watchdog.
    while !session.device().was_zeroed() {
        assert!(session.now_us() - fault_us <= 2 * u64::from(WATCHDOG_US) + 2_000, "not reported in time");
        let _ = session.tick(FORCE_N);
    }
    println!("restart: reported after {} us", session.now_us() - fault_us);
    for tick in 2..2_000 {
        let exchanged = session.tick(FORCE_N);
        assert!(tick < 2 || !matches!(exchanged, Ok(Some(_))), "a sample of a device that is not homed");
        assert_eq!(session.rig.force_record().force_n, vec3::ZERO, "tick {tick}");
    }
    assert!(!session.device().was_zeroed(), "reported once");
    // The reset starts a new session, in which the device is not homed. After homing it renders the requested
    // force.
    session.device().reset();
    pushed(&mut session, 10);
    assert_eq!((session.state(), session.rig.force_record().force_n), (DeviceState::Unhomed, vec3::ZERO));
    pushed(&mut session, 150);
    assert_eq!(session.state(), DeviceState::Homed);
    assert!(vec3::distance(session.rig.force_record().force_n, FORCE_N) < 1e-3);
}

#[test]
fn a_disabled_device_is_a_fault() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    let fence = Fence::default();
    let path = session.device().guard_path(&fence).expect("it is open");
    forced(&mut session);
    session.guard_zero(&fence, path.as_ref()).expect("the port is open");
    pushed(&mut session, 300);
    assert_eq!(session.rig.force_record().force_n, vec3::ZERO, "the driver must not enable it again");
    assert!(session.device().was_zeroed());
    session.device().reset();
    pushed(&mut session, 10);
    assert!(vec3::distance(session.rig.force_record().force_n, FORCE_N) < 1e-3);
    // The message names the new session.
    session.guard_zero(&fence, path.as_ref()).expect("the port is open");
    pushed(&mut session, 10);
    assert_eq!(session.rig.force_record().force_n, vec3::ZERO);
}

/// Each fault that the device latches, and the driver's own, is reported once. There is no force until a
/// reset, for any request.
#[test]
fn no_fault_ends_without_a_reset() {
    type Inject = fn(&mut Session<'_>);
    let faults: [(&str, Inject, Option<DeviceFault>); 4] = [
        ("watchdog", |session| session.pass(30_000), Some(DeviceFault::Watchdog)),
        (
            "overspeed",
            |session| {
                session.rig.jump_encoder(0, 0.02);
            },
            Some(DeviceFault::Overspeed),
        ),
        (
            "home lost",
            |session| {
                session.rig.inject(FaultKind::HomingLost);
            },
            Some(DeviceFault::HomeLost),
        ),
        (
            "power cycle",
            |session| {
                session.rig.inject(FaultKind::PowerCycle);
            },
            None,
        ),
    ];
    for (name, inject, code) in faults {
        let mut rig = rig();
        let mut session = homed(&mut rig);
        forced(&mut session);
        inject(&mut session);
        let mut reports = 0;
        for tick in 0..600 {
            let _ = session.tick(FORCE_N);
            assert!(
                tick < 2 || session.rig.force_record().force_n == vec3::ZERO,
                "{name}: a force at tick {tick}"
            );
            reports += u32::from(session.device().was_zeroed());
        }
        assert_eq!(reports, 1, "{name}");
        if let Some(code) = code {
            assert_eq!(pushed(&mut session, 1), Some(DeviceErrorKind::Faulted(code)), "{name}");
        }
    }
}

/// Replies of the old session are in flight when the user resets.
#[test]
fn a_reply_of_an_old_session_gives_no_sample_in_the_new_one() {
    for (lead, delay_us) in [(1, 1_500), (1, 4_000), (2, 8_000), (3, 15_000), (5, 40_000)] {
        let mut rig = rig();
        let mut session = homed(&mut rig);
        pushed(&mut session, 20);
        session.rig.set_faults(Faults::NONE, Faults { delay: 1.0, delay_us, ..Faults::NONE });
        pushed(&mut session, lead);
        session.rig.set_faults(Faults::NONE, Faults::NONE);
        session.device().reset();
        let reset_us = session.now_us();
        let mut sampled = 0;
        for _ in 0..100 {
            if let Ok(Some(sample)) = session.tick(vec3::ZERO) {
                sampled += 1;
                assert!(sample.t_us > reset_us, "late by {delay_us} us: {sample:?}, reset at {reset_us}");
            }
        }
        assert!(sampled > 10, "late by {delay_us} us: {sampled} samples of the new session");
    }
}

/// A torque that expired must not return in one step.
#[test]
fn an_expired_force_returns_at_the_slew_limit() {
    for lost_ms in 1..=9 {
        let mut rig = rig();
        let mut session = homed(&mut rig);
        forced(&mut session);
        session.rig.set_faults(Faults { drop: 1.0, ..Faults::NONE }, Faults::NONE);
        pushed(&mut session, lost_ms);
        let expired = session.rig.force_record().off_since_us.is_some();
        session.rig.set_faults(Faults::NONE, Faults::NONE);
        session.rig.reset_record();
        pushed(&mut session, 10);
        let felt = session.rig.force_record();
        println!("{lost_ms} ms lost: expired {expired}, step {} N", felt.largest_step_n);
        assert!(felt.largest_step_n <= 1.001, "{lost_ms} ms lost: a step of {} N", felt.largest_step_n);
        // The loop holds its force as long, so the force must not fall and rise meanwhile.
        assert!(lost_ms > 4 || !expired && felt.largest_step_n < 1e-3, "{lost_ms} ms lost: {felt:?}");
        // After a longer loss the watchdog may fire first.
        assert!(lost_ms > 7 || vec3::distance(felt.force_n, FORCE_N) < 1e-3, "{lost_ms} ms lost: {felt:?}");
    }
}

/// The same with the loop, which holds its force for three ticks and then sends zero. The loop recovers, and
/// its steps stay within the slew limit.
#[test]
fn a_loop_recovers_from_lost_requests_without_a_step() {
    let blob = golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("golden");
    for lost_ms in 1..=7 {
        let mut rig = rig();
        let felt = with_loop(&mut rig, &organ, Method::Energy, |bench| {
            let path = press(bench.rig, 0.006, 0.018);
            bench.rig.follow(path);
            bench.controls.arm();
            bench.run(900).expect("a fault-free link");
            assert!(vec3::norm(bench.rig.force_record().force_n) > 2.0, "{:?}", bench.rig.force_record());
            bench.rig.reset_record();
            bench.rig.set_faults(Faults { drop: 1.0, ..Faults::NONE }, Faults::NONE);
            bench.run(lost_ms).expect("a link");
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
            let records = bench.run(50).expect("a fault-free link");
            assert_eq!(records.last().map(|record| record.phase), Some(Control::Active), "{lost_ms} ms lost");
            bench.rig.force_record()
        });
        let felt = felt.expect("it opens");
        println!("{lost_ms} ms lost under the loop: step {} N", felt.largest_step_n);
        assert!(felt.largest_step_n <= 1.001, "{lost_ms} ms lost: a step of {} N", felt.largest_step_n);
    }
}

/// Without the checksum, corrupted bytes would give wrong positions and forces.
#[test]
fn corrupted_replies_are_errors_and_never_samples() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    let at_m = session.rig.position_m();
    session.rig.set_faults(Faults::NONE, Faults { corrupt: 1.0, ..Faults::NONE });
    let mut damaged = 0;
    for _ in 0..400 {
        match session.tick(vec3::ZERO) {
            Ok(Some(sample)) => assert!(vec3::distance(sample.position_m, at_m) < 1e-3, "{sample:?}"),
            Err(error) => damaged += u32::from(error.kind() == DeviceErrorKind::BadFrame),
            Ok(None) => {}
        }
    }
    assert!(damaged > 100, "{damaged}");
}

#[test]
fn a_silent_terminal_is_an_error_within_the_timeout() {
    let (_silent, driver) = PtyTransport::pair().expect("a pseudo terminal");
    let profile = Profile::bundled("link").expect("bundled");
    let config = LinkConfig::of(&profile, Duration::from_millis(100)).expect("it has a [capstan]");
    let port = NonBlockingPort::from_port(driver).expect("it is open");
    let opened = Link::with_port(Box::new(port), config);
    assert_eq!(opened.err(), Some(LinkError::Silent));
    let mut rig = rig();
    rig.inject(FaultKind::Replug);
    let workspace = rig.profile().workspace;
    assert!(rig.open(workspace).is_err(), "no cable, no port");
}

/// A real process is killed or stopped, without a guard. Only the device acts after its last command, so
/// the times are the device's.
#[test]
fn a_killed_or_stopped_host_is_zeroed_by_the_device() {
    for fault in [FaultKind::HostKilled, FaultKind::HostPaused] {
        let run = hosts::run(
            Path::new(env!("CARGO_BIN_EXE_palpate-hil")),
            DEFAULT_LIMIT_MS,
            Role::Unguarded,
            Device::Link,
            fault,
            5,
        );
        println!(
            "{}: zero {:?} us, latched {:?} us after the last command",
            fault, run.zero_us, run.detected_us
        );
        assert_eq!((run.violation(), run.ended), (None, Ended::Watchdog), "{run:?}");
        assert!(run.largest_n > 0.4, "{run:?}");
    }
}
