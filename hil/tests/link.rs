//! The driver of the device link on an emulated controller: what the contract does not ask of every device.

use palpate_core::{Method, Organ, Phase as Control, Vec3, vec3};
use palpate_hil::fault::Faults;
use palpate_hil::hosts::{self, Device};
use palpate_hil::link::WATCHDOG_US;
use palpate_hil::matrix::{Ended, Wrong};
use palpate_hil::rig::{Cut, Mishap, Rig, SerialRig, Wire};
use palpate_hil::session::{Session, golden_organ, press, with_loop};
use palpate_hil::{EmulatedLink, PtyTransport};
use palpate_host::DeviceErrorKind;
use palpate_host::device::DeviceState;
use palpate_host::device::link::{Link, LinkConfig, LinkError};
use palpate_host::device::profile::Profile;
use palpate_host::supervisor::DEFAULT_LIMIT_MS;
use palpate_link::DeviceFault;
use std::path::Path;
use std::time::Duration;

const FORCE_N: Vec3 = [0.5, -0.5, 1.5];

fn rig() -> SerialRig<EmulatedLink> {
    SerialRig::new(Wire::Memory, 3)
}

fn homed(rig: &mut SerialRig<EmulatedLink>) -> Session<'_> {
    let workspace = rig.profile().workspace;
    Session::homed(rig, workspace).expect("it homes")
}

fn forced(session: &mut Session<'_>) {
    for _ in 0..10 {
        session.tick(FORCE_N).expect("a sound link");
    }
    assert!(vec3::distance(session.rig.felt().force_n, FORCE_N) < 1e-3, "{:?}", session.rig.felt());
}

/// So many ticks that ask for a force; what came with the last one.
fn pushed(session: &mut Session<'_>, ticks: u32) -> Option<DeviceErrorKind> {
    (0..ticks).map(|_| session.tick(FORCE_N).err().map(|error| error.kind())).last().flatten()
}

#[test]
fn a_silent_host_is_zeroed_by_the_device_within_its_watchdog() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    forced(&mut session);
    let silent_us = session.now_us();
    session.pass(30_000);
    let off_us = session.rig.felt().off_since_us.expect("without a force");
    println!("silent host: zero {} us after its last tick", off_us - silent_us);
    assert!(off_us - silent_us <= u64::from(WATCHDOG_US), "{off_us}");
    // It comes back with its old force: the fault is latched, named, and told once.
    assert_eq!(pushed(&mut session, 50), Some(DeviceErrorKind::Faulted(DeviceFault::Watchdog)));
    assert!(session.device().was_zeroed() && !session.device().was_zeroed());
    assert_eq!(session.rig.felt().force_n, vec3::ZERO);
    // Only the user's reset begins another session.
    session.device().reset();
    pushed(&mut session, 10);
    assert!(vec3::distance(session.rig.felt().force_n, FORCE_N) < 1e-3);
}

#[test]
fn a_device_that_started_anew_is_a_fault_and_never_obeys_by_itself() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    forced(&mut session);
    session.rig.strike(Mishap::PowerCycle);
    let struck_us = session.now_us();
    // It cannot answer, for it knows of no session. What obeyed and is silent for twice its watchdog's time is given up.
    while !session.device().was_zeroed() {
        assert!(session.now_us() - struck_us <= 2 * u64::from(WATCHDOG_US) + 2_000, "not named yet");
        let _ = session.tick(FORCE_N);
    }
    println!("started anew: named after {} us", session.now_us() - struck_us);
    for tick in 2..2_000 {
        let exchanged = session.tick(FORCE_N);
        assert!(tick < 2 || !matches!(exchanged, Ok(Some(_))), "a sample of a device that knows no place");
        assert_eq!(session.rig.felt().force_n, vec3::ZERO, "tick {tick}");
    }
    assert!(!session.device().was_zeroed(), "the loop is told once");
    // Reset: a new session, which finds that it is not homed; homed, it takes the force that is then asked for.
    session.device().reset();
    pushed(&mut session, 10);
    assert_eq!((session.state(), session.rig.felt().force_n), (DeviceState::Unhomed, vec3::ZERO));
    pushed(&mut session, 150);
    assert_eq!(session.state(), DeviceState::Homed);
    assert!(vec3::distance(session.rig.felt().force_n, FORCE_N) < 1e-3);
}

#[test]
fn a_device_that_somebody_disabled_is_a_fault() {
    let mut rig = rig();
    let mut session = homed(&mut rig);
    let mut second = session.device().emergency_stop().expect("a second handle");
    forced(&mut session);
    second.zero().expect("the port is open");
    pushed(&mut session, 300);
    assert_eq!(session.rig.felt().force_n, vec3::ZERO, "it did not enable again by itself");
    assert!(session.device().was_zeroed());
    session.device().reset();
    pushed(&mut session, 10);
    assert!(vec3::distance(session.rig.felt().force_n, FORCE_N) < 1e-3);
}

/// Every fault that a device latches, and the driver's own: told once, named, and no force until reset, whatever is asked.
#[test]
fn no_fault_ends_by_itself() {
    type Strike = fn(&mut Session<'_>);
    let faults: [(&str, Strike, Option<DeviceFault>); 4] = [
        ("watchdog", |session| session.pass(30_000), Some(DeviceFault::Watchdog)),
        (
            "overspeed",
            |session| {
                session.rig.strike(Mishap::EncoderJump { axis: 0, by_m: 0.02 });
            },
            Some(DeviceFault::Overspeed),
        ),
        (
            "home lost",
            |session| {
                session.rig.strike(Mishap::LoseHoming);
            },
            Some(DeviceFault::HomeLost),
        ),
        (
            "power cycle",
            |session| {
                session.rig.strike(Mishap::PowerCycle);
            },
            None,
        ),
    ];
    for (name, strike, code) in faults {
        let mut rig = rig();
        let mut session = homed(&mut rig);
        forced(&mut session);
        strike(&mut session);
        let mut told = 0;
        for tick in 0..600 {
            let _ = session.tick(FORCE_N);
            assert!(tick < 2 || session.rig.felt().force_n == vec3::ZERO, "{name}: a force at tick {tick}");
            told += u32::from(session.device().was_zeroed());
        }
        assert_eq!(told, 1, "{name}");
        if let Some(code) = code {
            assert_eq!(pushed(&mut session, 1), Some(DeviceErrorKind::Faulted(code)), "{name}");
        }
    }
}

/// Answers of the old session are on their way when the user resets.
#[test]
fn an_answer_of_an_old_session_is_no_sample_of_the_new_one() {
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

/// A torque that has ended on the way must not come back in one step.
#[test]
fn a_force_that_was_let_go_comes_back_slowly() {
    for lost_ms in 1..=9 {
        let mut rig = rig();
        let mut session = homed(&mut rig);
        forced(&mut session);
        session.rig.set_faults(Faults { drop: 1.0, ..Faults::NONE }, Faults::NONE);
        pushed(&mut session, lost_ms);
        let let_go = session.rig.felt().off_since_us.is_some();
        session.rig.set_faults(Faults::NONE, Faults::NONE);
        session.rig.forget();
        pushed(&mut session, 10);
        let felt = session.rig.felt();
        println!("{lost_ms} ms lost: let go {let_go}, step {} N", felt.largest_step_n);
        assert!(felt.largest_step_n <= 1.001, "{lost_ms} ms lost: a step of {} N", felt.largest_step_n);
        // A loop holds its force as long: it must not fall and rise meanwhile.
        assert!(lost_ms > 4 || !let_go && felt.largest_step_n < 1e-3, "{lost_ms} ms lost: {felt:?}");
        // Beyond that the watchdog may have been first.
        assert!(lost_ms > 7 || vec3::distance(felt.force_n, FORCE_N) < 1e-3, "{lost_ms} ms lost: {felt:?}");
    }
}

/// The same with the loop, whose force is held for three ticks and then zero: it rides on, and steps by no more than its own limit.
#[test]
fn a_loop_whose_requests_are_lost_for_a_moment_rides_on_without_a_step() {
    let blob = golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("golden");
    for lost_ms in 1..=7 {
        let mut rig = rig();
        let felt = with_loop(&mut rig, &organ, Method::Energy, |bench| {
            let path = press(bench.rig, 0.006, 0.018);
            bench.rig.follow(path);
            bench.controls.arm();
            bench.run(900).expect("a sound link");
            assert!(vec3::norm(bench.rig.felt().force_n) > 2.0, "{:?}", bench.rig.felt());
            bench.rig.forget();
            bench.rig.set_faults(Faults { drop: 1.0, ..Faults::NONE }, Faults::NONE);
            bench.run(lost_ms).expect("a link");
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
            let records = bench.run(50).expect("a sound link");
            assert_eq!(records.last().map(|record| record.phase), Some(Control::Active), "{lost_ms} ms lost");
            bench.rig.felt()
        });
        let felt = felt.expect("it opens");
        println!("{lost_ms} ms lost under the loop: step {} N", felt.largest_step_n);
        assert!(felt.largest_step_n <= 1.001, "{lost_ms} ms lost: a step of {} N", felt.largest_step_n);
    }
}

/// Noise from the wire with the checksum ignored would be positions and forces nobody meant.
#[test]
fn damaged_answers_are_errors_and_never_samples() {
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
fn nobody_at_the_other_end_is_said_and_does_not_hang() {
    let (_silent, driver) = PtyTransport::pair().expect("a pseudo terminal");
    let profile = Profile::bundled("link").expect("bundled");
    let config = LinkConfig::of(&profile, Duration::from_millis(100)).expect("it states a capstan");
    let opened = Link::with_port(Box::new(driver), config);
    assert_eq!(opened.err(), Some(LinkError::Silent));
    let mut rig = rig();
    rig.unplug(Cut::Between);
    let workspace = rig.profile().workspace;
    assert!(rig.open(workspace).is_err(), "no cable, no port");
}

/// A real process, killed and stopped, without a supervisor. Between its last command and zero nobody acts but the device: the times are its own.
#[test]
fn a_killed_or_stopped_host_is_zeroed_by_the_device_itself() {
    for wrong in [Wrong::HostKilled, Wrong::HostPaused] {
        let run = hosts::run(
            Path::new(env!("CARGO_BIN_EXE_palpate-hil")),
            DEFAULT_LIMIT_MS,
            Device::Link,
            wrong,
            5,
        );
        println!(
            "{}: zero {:?} us, latched {:?} us after the last command",
            wrong.name(),
            run.zero_us,
            run.detected_us
        );
        assert_eq!((run.broken(), run.ended), (None, Ended::Watchdog), "{run:?}");
        assert!(run.largest_n > 0.4, "{run:?}");
    }
}
