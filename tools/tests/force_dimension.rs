//! `palpate run --device omega`: a stand-in for libdrd, through the loading path of a user's.

use std::fs::File;
use std::io::{BufReader, Write};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use palpate_core::vec3;
use palpate_host::device::profile::Profile;
use palpate_maker_stub::{Cable, Field};
use palpate_record::Recording;
use serialport::SerialPort;

use super::guard::files_of;
use super::maker::{Hand, end, killed_or_stopped, pressing, proxy_of};
use super::{quiet, refused, text};

fn hand() -> Hand {
    Hand::on("omega", "omega", 1.0)
}

#[test]
fn the_hand_feels_the_body_and_the_session_says_what_it_drives() {
    let _quiet = quiet();
    let hand = hand();
    hand.cable.set_quantity(Field::Turn, 0.5);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("session.mcap");
    let session = hand.pressing(&["--record", text(&file)]);
    std::thread::sleep(Duration::from_millis(200));
    let output = end(session);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("omega.3 (Force Dimension 3.16.0)"), "{said}");
    assert_eq!(hand.cable.quantity(Field::MaxForce), 12.0);
    // The grip is turned by +0.5 rad about the device's z, which is the model's normal here.
    let recording = Recording::open(BufReader::new(File::open(&file).expect("there"))).expect("sound");
    let turned = recording.filter_map(|tick| tick.expect("sound").sample).last().expect("a sample");
    let axis = turned.orientation.xyz;
    let angle = 2.0 * vec3::norm(axis).atan2(turned.orientation.w);
    assert!((angle - 0.5).abs() < 1e-3, "{turned:?}");
    let normal = {
        let (_, profile) = files_of(folder.path(), "omega");
        let profile = Profile::load(text(&profile)).expect("sound");
        profile.workspace.axes.map(|row| row[2])
    };
    assert!(vec3::dot(axis, normal) > 0.99 * vec3::norm(axis), "{axis:?} about {normal:?}");
    assert_eq!((hand.force_n(), hand.cable.whole(Field::Motions)), (0.0, 0));
    // It has a watchdog and a velocity threshold: nothing to remark.
    assert!(!String::from_utf8_lossy(&output.stderr).contains("omega.3:"), "{output:?}");
}

#[test]
fn a_session_that_is_killed_or_stopped_leaves_no_force() {
    killed_or_stopped(hand);
}

/// Every call fails: the firmware's watchdog of 10 ms takes the force, which stays off when the cable works again.
#[test]
fn a_cable_that_fails_leaves_the_force_to_the_firmware() {
    let _quiet = quiet();
    let hand = hand();
    let session = hand.pressing(&[]);
    hand.cable.set_whole(Field::Failing, 2);
    std::thread::sleep(Duration::from_millis(100));
    let at_ns = Cable::now_ns();
    hand.cable.set_whole(Field::Failing, 0);
    std::thread::sleep(Duration::from_millis(300));
    println!("a cable that fails: the last force {:.1} ms before its end", -hand.last_force_ms(at_ns));
    assert!(hand.last_force_ms(at_ns) < -80.0 && hand.force_n() == 0.0, "{}", hand.last_force_ms(at_ns));
    let output = end(session);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("communication error (error 2)"), "{said}");
}

/// The process that holds the library, killed or stopped: the firmware's watchdog of 10 ms takes the force.
#[test]
fn a_proxy_that_is_killed_or_stopped_leaves_the_force_to_the_firmware() {
    for signal in [Signal::SIGKILL, Signal::SIGSTOP] {
        let _quiet = quiet();
        let hand = hand();
        let session = hand.pressing(&[]);
        let proxy = proxy_of(&session);
        let at_ns = Cable::now_ns();
        kill(proxy, signal).expect("it runs");
        std::thread::sleep(Duration::from_millis(400));
        let last_ms = hand.last_force_ms(at_ns);
        println!("proxy, {signal}: the last force {last_ms:.1} ms after it");
        assert!(last_ms < 20.0 && hand.force_n() == 0.0, "{signal}: {last_ms} ms, {} N", hand.force_n());
        if signal == Signal::SIGSTOP {
            // Its motors are off, and latched.
            kill(proxy, Signal::SIGCONT).expect("it runs");
            std::thread::sleep(Duration::from_millis(300));
            assert_eq!(hand.force_n(), 0.0);
            end(session);
        } else {
            let output = session.wait_with_output().expect("it ends");
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.code() == Some(1) && said.contains("device lost"), "{said}");
        }
    }
}

/// Another library, for example of another maker.
#[test]
fn a_library_without_the_functions_is_one_line() {
    for device in ["omega", "touch"] {
        let folder = tempfile::tempdir().expect("a folder");
        let (blob, profile) = files_of(folder.path(), device);
        let maps = std::fs::read_to_string("/proc/self/maps").expect("Linux");
        let libc = maps.split_whitespace().find(|word| word.ends_with("/libc.so.6")).expect("it is loaded");
        let device = format!("{device}:{libc}");
        let with = [
            "run",
            text(&blob),
            "--uncertified",
            "--profile",
            text(&profile),
            "--headless",
            "--device",
            &device,
        ];
        refused(&with, &["libc.so.6: it has no `", "install a newer version from its maker"]);
    }
}

/// Each cause for which the motors go off by themselves latches, with its words; nothing resumes.
#[test]
fn motors_that_go_off_stay_off() {
    for (cause, words) in [
        (1, "force button"),
        (2, "velocity threshold"),
        (3, "watchdog"),
        (4, "software"),
        (5, "USB connection"),
        (6, "dead man"),
    ] {
        let _quiet = quiet();
        let hand = hand();
        let session = hand.pressing(&[]);
        let at_ns = Cable::now_ns();
        hand.cable.set_whole(Field::OffCause, cause);
        hand.cable.set_whole(Field::Offs, 1);
        std::thread::sleep(Duration::from_millis(400));
        let last_ms = hand.last_force_ms(at_ns);
        let output = end(session);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(words), "{cause}: {said}");
        assert!(last_ms < 5.0 && hand.force_n() == 0.0, "{cause}: {last_ms} ms");
    }
}

/// Motors that are off until the session is armed: with --motors-off they stay off, also after the device's own button.
#[test]
fn the_motors_are_off_until_the_session_is_armed() {
    let _quiet = quiet();
    let hand = hand();
    let session = hand.session_with(&["--motors-off"]);
    let give_up = Instant::now() + Duration::from_secs(20);
    while hand.cable.whole(Field::Frames) < 4_000 {
        assert!(Instant::now() < give_up, "{} frames", hand.cable.whole(Field::Frames));
        assert_eq!(hand.cable.whole(Field::MotorsOn), 0);
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = end(session);
    assert!(String::from_utf8_lossy(&output.stdout).contains("motors off"), "{output:?}");
    let hand = self::hand();
    let session = hand.pressing(&[]);
    assert_eq!(hand.cable.whole(Field::MotorsOn), 1);
    hand.cable.set_whole(Field::OffCause, 1);
    hand.cable.set_whole(Field::Offs, 1);
    std::thread::sleep(Duration::from_millis(20));
    for _ in 0..200 {
        assert_eq!(hand.cable.whole(Field::MotorsOn), 0, "they come back by themselves");
        std::thread::sleep(Duration::from_millis(2));
    }
    end(session);
}

#[test]
fn positions_of_the_librarys_memory_are_not_samples() {
    let _quiet = quiet();
    let hand = hand();
    let session = hand.pressing(&[]);
    let at_ns = Cable::now_ns();
    hand.cable.set_whole(Field::Cached, 1);
    std::thread::sleep(Duration::from_millis(400));
    let last_ms = hand.last_force_ms(at_ns);
    let output = end(session);
    println!("without samples: the last force {last_ms:.1} ms after the last one");
    assert!(last_ms < 200.0 && hand.force_n() == 0.0, "{last_ms} ms");
    assert!(String::from_utf8_lossy(&output.stdout).contains("latched"), "{output:?}");
}

/// The arm of a device that has not found its position does not move without consent: here there is no terminal.
#[test]
fn what_does_not_serve_is_one_line_with_the_fix() {
    for (field, number, fix) in [
        (Field::Uninitialized, 1, "run its maker's initialisation, or start this on a terminal and consent"),
        (Field::Unpowered, 1, "omega.3 has no power; switch it on"),
        (Field::Kind, 104, "the device is a sigma.7; use --device sigma"),
        (Field::Refused, 20, "another program has the device; end it"),
        (
            Field::FixedWatchdog,
            250,
            "omega.3 keeps its watchdog at 31.2 ms instead of 10 ms; update its firmware",
        ),
        (Field::Refused, 2, "opening the device fails (communication error, error 2); check the cable"),
    ] {
        let hand = hand();
        hand.cable.set_whole(field, number);
        let output = hand.session().wait_with_output().expect("it ends");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert_eq!(said.lines().filter(|line| line.contains(fix)).count(), 1, "{said}");
        assert_eq!((hand.cable.whole(Field::Motions), hand.force_n()), (0, 0.0));
    }
}

/// At a terminal the user is asked first.
#[test]
fn an_arm_moves_by_itself_only_after_a_yes() {
    for (answer, code, motions) in [("no\n", 2, 0), ("yes\n", 0, 1)] {
        let hand = hand();
        hand.cable.set_whole(Field::Uninitialized, 1);
        let (mut keyboard, terminal) = serialport::TTYPort::pair().expect("a terminal");
        let name = terminal.name().expect("a name");
        let input = File::options().read(true).write(true).open(name).expect("it is there");
        keyboard.write_all(answer.as_bytes()).expect("typed");
        let session = || hand.session_at(input.try_clone().expect("open").into());
        let output = if code == 0 {
            end(pressing(session, || hand.force_n() >= 0.2))
        } else {
            session().wait_with_output().expect("it ends")
        };
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains("moves its arm by itself\nTake your hands off it."), "{said}");
        assert_eq!((output.status.code(), hand.cable.whole(Field::Motions)), (Some(code), motions), "{said}");
    }
}

#[test]
fn a_firmware_without_a_watchdog_is_told() {
    let _quiet = quiet();
    let hand = hand();
    hand.cable.set_whole(Field::Unwatched, 1);
    hand.cable.set_whole(Field::Unbraked, 1);
    let session = hand.pressing(&[]);
    let output = end(session);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("its firmware has no watchdog"), "{said}");
    assert!(
        said.contains("has switched off its brake at high speed; switch the device off and on"),
        "{said}"
    );
}
