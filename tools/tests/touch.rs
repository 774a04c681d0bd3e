//! `palpate run --device touch`: a stand-in for the maker's library, through the loading path of a user's.

use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use palpate_maker_stub::{Cable, Field};

use super::maker::{Hand, end, killed_or_stopped, proxy_of};
use super::quiet;

#[test]
fn the_hand_feels_the_body_and_the_session_says_what_it_drives() {
    let _quiet = quiet();
    let hand = Hand::on("touch", "touch", 1e-3);
    let session = hand.pressing(&[]);
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

#[test]
fn a_session_that_is_killed_or_stopped_leaves_no_force() {
    killed_or_stopped(|| Hand::on("touch", "touch", 1e-3));
}

/// The library's amplifiers come back by themselves 0.3 s after an exceeded limit, and it resumes after a stall.
#[test]
fn the_force_stays_off_where_the_library_resumes() {
    for stalls in [false, true] {
        let _quiet = quiet();
        let hand = Hand::on("touch", "touch", 1e-3);
        let session = hand.pressing(&[]);
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
    let hand = Hand::on("touch", "touch", 1e-3);
    let session = hand.pressing(&[]);
    kill(proxy_of(&session), Signal::SIGKILL).expect("it runs");
    let output = session.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("device lost"), "{said}");
}

#[test]
fn a_device_that_is_not_there_or_in_use_is_one_line() {
    for (code, fix) in [(0x302_u64, "check cable and power"), (0x304, "end the other program")] {
        let hand = Hand::on("touch", "touch", 1e-3);
        hand.cable.set_whole(Field::Refused, code);
        let output = hand.session().wait_with_output().expect("it ends");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        let about: Vec<&str> = said.lines().filter(|line| line.contains("no Touch can be opened")).collect();
        assert!(about.len() == 1 && about[0].contains(fix), "{said}");
    }
}
