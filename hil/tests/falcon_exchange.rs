//! Exchanges of the Falcon's driver with the emulated device, reply by reply.

use crate::falcon_board::Board;
use palpate_core::{Sample, vec3};
use palpate_hil::falcon::LoaderFault;
use palpate_host::device::DeviceState;
use palpate_host::device::falcon::kinematics::CENTRE_M;
use palpate_host::device::falcon::packet::{ALL_HOMED, Lights, Request};
use palpate_host::device::falcon::{Falcon, FalconConfig, FalconError, Image, Mode};
use palpate_host::device::fence::{Fence, MAX_ZERO_MESSAGE};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_host::{Device, DeviceError, DeviceErrorKind};
use palpate_link::DeviceFault;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Consecutive rejected positions, or replies without the homed flags, after which the driver no longer
/// counts the device as homed.
const MAX_REJECTIONS: u32 = 3;
const MIN_UNHOMED: u32 = 3;

pub(crate) const POLLED: FalconConfig = FalconConfig {
    workspace: Workspace {
        axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        scale: 1.0,
        device_origin_m: [0.0; 3],
        model_origin_m: [0.0; 3],
    },
    max_force_n: 8.0,
    max_stiffness_n_m: 1_000.0,
    counts_per_n_m: [-10_000.0; 3],
    mode: Mode::Polled,
};

fn start(chip: &Arc<Board>) -> Falcon<Board> {
    Falcon::start(Arc::clone(chip), POLLED, None).expect("running")
}

/// A device after exchanges until its first sample, and the time of that.
fn homed(chip: &Arc<Board>) -> (Falcon<Board>, u64) {
    let mut falcon = start(chip);
    chip.home();
    assert_eq!(falcon.exchange(0, [0.0; 3]), Ok(None));
    assert!(falcon.exchange(1_000, [0.0; 3]).expect("a link").is_some());
    (falcon, 1_000)
}

fn kind(result: Result<Option<Sample>, DeviceError>) -> DeviceErrorKind {
    result.expect_err("an error").kind()
}

#[test]
fn a_sample_has_the_position_at_the_time_of_its_request() {
    let chip = Board::running();
    chip.falcon(|falcon| falcon.press(0b1010));
    let mut falcon = start(&chip);
    assert_eq!(falcon.state(), DeviceState::FirmwareLoaded);
    chip.home();
    assert_eq!(falcon.exchange(5_000, [0.0; 3]), Ok(None), "it does not wait");
    let sample = falcon.exchange(6_000, [0.0; 3]).expect("a link").expect("a sample");
    assert_eq!((sample.t_us, sample.buttons), (5_000, 0b1010));
    assert!(vec3::distance(sample.position_m, CENTRE_M.map(|m| m as f32)) < 60e-6);
    assert_eq!(falcon.state(), DeviceState::Homed);
}

#[test]
fn a_device_without_firmware_needs_it_and_loads_it() {
    let silent = Board::silent(None);
    let without = Falcon::start(Arc::clone(&silent), POLLED, None);
    assert_eq!(without.err(), Some(FalconError::NeedsFirmware));
    let image = Image::synthetic(100);
    let falcon = Falcon::start(Arc::clone(&silent), POLLED, Some(&image)).expect("loaded");
    assert_eq!(falcon.state(), DeviceState::FirmwareLoaded);
    assert_eq!(silent.loads(), 1);
    let running = Board::running();
    Falcon::start(Arc::clone(&running), POLLED, Some(&image)).expect("it answers");
    assert_eq!(running.loads(), 0, "not loaded twice");
}

/// A board that kept its power reports that it is homed. The homing of an earlier session is invalid, even of
/// a single axis.
#[test]
fn a_homing_of_an_earlier_session_is_cleared_or_refused() {
    let image = Image::synthetic(100);
    for homed in [ALL_HOMED, 1, 4] {
        let chip = Board::running();
        chip.set_homed(homed);
        let without = Falcon::start(Arc::clone(&chip), POLLED, None);
        assert_eq!(without.err(), Some(FalconError::HomedBefore), "{homed}");
        let mut falcon = Falcon::start(Arc::clone(&chip), POLLED, Some(&image)).expect("loaded again");
        assert_eq!(chip.loads(), 1);
        for tick in 0..20 {
            assert_eq!(falcon.exchange(1_000 * tick, [0.0, 0.0, 3.0]), Ok(None));
            assert_eq!((chip.last().motors, chip.last().homing), ([0; 3], true));
        }
        assert_eq!(falcon.state(), DeviceState::Unhomed);
        chip.home();
        let _ = falcon.exchange(20_000, [0.0; 3]);
        assert!(falcon.exchange(21_000, [0.0; 3]).expect("a link").is_some());
    }
    let keeping = Board::running_with(LoaderFault::StartsHomed);
    keeping.home();
    let refused = Falcon::start(Arc::clone(&keeping), POLLED, Some(&image));
    assert_eq!(refused.err(), Some(FalconError::HomedBefore), "it was loaded and still reports homing");
}

#[test]
fn there_is_no_force_and_no_sample_before_all_three_axes_are_homed() {
    let chip = Board::running();
    let mut falcon = start(&chip);
    for (tick, homed) in [0, 1, 3, 5, 6].into_iter().cycle().take(20).enumerate() {
        chip.set_homed(homed);
        assert_eq!(falcon.exchange(1_000 * tick as u64, [0.0, 0.0, 3.0]), Ok(None));
        let request = chip.last();
        assert_eq!((request.motors, request.homing), ([0; 3], true));
        assert_eq!(request.lights, Lights { red: true, ..Lights::default() });
    }
    assert_eq!(falcon.state(), DeviceState::Unhomed);
    chip.set_homed(ALL_HOMED);
    assert_eq!(falcon.exchange(20_000, [0.0; 3]), Ok(None), "this reply is to an earlier request");
    assert!(falcon.exchange(21_000, [0.0; 3]).expect("a link").is_some());
    assert_eq!(falcon.state(), DeviceState::Homed);
    let request = chip.last();
    assert_eq!((request.motors, request.homing), ([0; 3], false));
    assert_eq!(request.lights, Lights { blue: true, ..Lights::default() });
}

#[test]
fn a_force_reaches_the_motors_until_the_homed_flags_are_lost() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    falcon.exchange(now_us + 1_000, [0.0, 0.0, 2.0]).expect("a link");
    let request = chip.last();
    // Towards the user: the cranks turn up, and the scale is negative.
    assert!(request.motors[0] < -100 && request.motors == [request.motors[0]; 3], "{request:?}");
    assert_eq!(request.lights, Lights { green: true, ..Lights::default() });
    chip.set_homed(0b011);
    falcon.exchange(now_us + 2_000, [0.0, 0.0, 2.0]).expect("a link");
    assert_eq!(falcon.exchange(now_us + 3_000, [0.0, 0.0, 2.0]), Ok(None));
    assert_eq!(falcon.state(), DeviceState::Unhomed);
    assert_eq!((chip.last().motors, chip.last().homing), ([0; 3], true));
}

/// Homing resets the counts: the same position may have other counts, and this is not a jump.
#[test]
fn homing_again_resets_the_coordinates() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.set_homed(0);
    assert!(falcon.exchange(now_us + 1_000, [0.0; 3]).is_ok());
    for tick in 2..2 + u64::from(MIN_UNHOMED) {
        assert_eq!(falcon.exchange(now_us + 1_000 * tick, [0.0; 3]), Ok(None));
    }
    chip.home();
    chip.move_hand([0.03, -0.02, 0.14]);
    falcon.exchange(now_us + 6_000, [0.0; 3]).expect("a link");
    let sample = falcon.exchange(now_us + 7_000, [0.0; 3]).expect("a link").expect("a sample");
    assert!(vec3::distance(sample.position_m, [0.03, -0.02, 0.14]) < 60e-6);
}

#[test]
fn a_late_reply_has_the_time_of_its_request() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    // One is answered at once; the next reply is held.
    falcon.exchange(now_us + 1_000, [0.0; 3]).expect("a link");
    chip.hold();
    falcon.exchange(now_us + 2_000, [0.0; 3]).expect("a link");
    assert_eq!(falcon.exchange(now_us + 3_000, [0.0; 3]), Ok(None), "no reply yet, and nothing is sent");
    let sent = chip.count();
    assert_eq!(kind(falcon.exchange(now_us + 4_000, [0.0; 3])), DeviceErrorKind::Timeout);
    assert_eq!(chip.count(), sent + 1, "timed out, and the next is sent");
    // The second reply is lost.
    chip.release(1);
    let sample = falcon.exchange(now_us + 5_000, [0.0; 3]).expect("a link").expect("a sample");
    assert_eq!(sample.t_us, now_us + 2_000);
    // The other request is never answered: after a silence exchanges continue as before.
    chip.with(|script| script.holds = false);
    let mut samples = (6..12).filter_map(|tick| falcon.exchange(now_us + 1_000 * tick, [0.0; 3]).ok()?);
    assert!(samples.any(|sample| sample.t_us > now_us + 6_000 && sample.t_us < now_us + 11_000));
}

#[test]
fn a_force_is_zeroed_in_every_state_of_the_link() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.hold();
    falcon.exchange(now_us + 1_000, [1.0, 0.0, 0.0]).expect("a link");
    assert_ne!(chip.last().motors, [0; 3]);
    // No reply yet; the write fails as well and is repeated.
    chip.with(|script| script.failing_writes = 1);
    assert_eq!(kind(falcon.exchange(now_us + 1_500, [0.0; 3])), DeviceErrorKind::Timeout);
    assert_ne!(chip.last().motors, [0; 3]);
    let _ = falcon.exchange(now_us + 2_000, [0.0; 3]);
    assert_eq!(chip.last().motors, [0; 3]);
}

#[test]
fn stop_and_drop_send_zero_twice() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    let zeros = |act: &mut dyn FnMut()| {
        let before = chip.count();
        act();
        chip.with(|script| {
            assert!(script.requests[before..].iter().all(|request| request.motors == [0; 3]));
            script.requests.len() - before
        })
    };
    falcon.exchange(now_us + 1_000, [0.0, 4.0, 0.0]).expect("a link");
    assert_ne!(chip.last().motors, [0; 3]);
    assert_eq!(zeros(&mut || falcon.stop()), 2);
    let mut held = Some(falcon);
    assert_eq!(zeros(&mut || drop(held.take())), 2);
}

#[test]
fn no_force_passes_a_closed_fence_and_the_guards_message_is_two_zeros() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    let (fence, mut message) = (Fence::default(), [0; MAX_ZERO_MESSAGE]);
    assert!(falcon.guard_path(&fence).expect("memory").is_none(), "another process cannot reach it");
    let len = fence.page().zero_message(&mut message);
    let packets = message[..len].as_chunks::<16>();
    assert_eq!(packets.1.len(), 0);
    let motors: Vec<_> =
        packets.0.iter().map(|packet| Request::decode(packet).expect("a packet").motors).collect();
    assert_eq!(motors, [[0; 3]; 2]);
    let mut sent = |ms: u64| {
        falcon.exchange(now_us + 1_000 * ms, [0.0, 4.0, 0.0]).expect("a link");
        chip.last().motors
    };
    assert_ne!(sent(1), [0; 3]);
    fence.page().close();
    assert!((2..12).all(|ms| sent(ms) == [0; 3]));
    fence.open();
    assert_ne!(sent(12), [0; 3]);
}

#[test]
fn a_damaged_packet_gives_no_sample_and_the_next_one_does() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.hold();
    falcon.exchange(now_us + 1_000, [0.0; 3]).expect("a link");
    let transfer = chip.take_held().expect("a reply");
    let whole = &transfer[2..];
    assert_eq!(whole.len(), 16);
    // Split by the transfer: not damaged.
    chip.send(&whole[..9]);
    assert_eq!(falcon.exchange(now_us + 2_000, [0.0; 3]), Ok(None));
    chip.send(&whole[9..]);
    assert!(falcon.exchange(now_us + 2_500, [0.0; 3]).expect("a link").is_some());
    // Truncated: an error, then a pause, then a sample.
    chip.send(&[&whole[..5], b"\xFF"].concat());
    assert_eq!(kind(falcon.exchange(now_us + 3_000, [0.0; 3])), DeviceErrorKind::BadFrame);
    chip.with(|script| script.holds = false);
    let found =
        (4..12).any(|tick| falcon.exchange(now_us + 1_000 * tick, [0.0; 3]).is_ok_and(|s| s.is_some()));
    assert!(found, "exchanges continue");
}

#[test]
fn an_unreachable_position_is_an_error_without_a_sample() {
    for far in [[4000, -516, 900], [-100, -516, -900]] {
        let chip = Board::running();
        let (mut falcon, now_us) = homed(&chip);
        let good = chip.falcon(|falcon| falcon.firmware().expect("it runs").reported());
        chip.set_counts(far);
        falcon.exchange(now_us + 1_000, [0.0; 3]).expect("an earlier request");
        assert_eq!(kind(falcon.exchange(now_us + 2_000, [0.0; 3])), DeviceErrorKind::BadFrame, "{far:?}");
        chip.set_counts(good);
        let _ = falcon.exchange(now_us + 3_000, [0.0; 3]);
        let sample = falcon.exchange(now_us + 4_000, [0.0; 3]).expect("a link").expect("a sample");
        assert!(vec3::distance(sample.position_m, CENTRE_M.map(|m| m as f32)) < 60e-6);
    }
}

/// One or two damaged packets that look valid, while the hand rests or moves.
#[test]
fn single_unreachable_positions_are_skipped() {
    for wrong in 1..MAX_REJECTIONS as u64 {
        let chip = Board::running();
        let (mut falcon, mut now_us) = homed(&chip);
        let mut errors = 0;
        for tick in 1..200_u64 {
            now_us += 1_000;
            // 1 m/s, back and forth.
            let phase = (tick % 40) as f64;
            chip.move_hand([1e-3 * phase.min(40.0 - phase), 0.0, 0.12]);
            if tick % 10 < wrong {
                chip.jump(0, 0x100);
            }
            match falcon.exchange(now_us, [0.0, 0.0, 1.0]) {
                Ok(sample) => assert!(sample.is_some()),
                Err(error) => {
                    assert_eq!(error.kind(), DeviceErrorKind::BadFrame);
                    errors += 1;
                }
            }
            assert_eq!(falcon.state(), DeviceState::Homed);
        }
        assert!(errors > 15 * wrong, "{errors}");
    }
}

/// A rejected position is not accepted later, and repeated rejection is not a damaged packet: the motors are
/// zeroed at once, and the board's positions are rejected until it reports a loss of the homing and is homed
/// again.
#[test]
fn an_encoder_that_has_miscounted_ends_the_homing() {
    for counts in [75, -75, 150, 280, 560, -560] {
        for axis in 0..3 {
            // A reply in every tick, or in every second one.
            for period_us in [1_000, 2_000] {
                let chip = Board::running();
                let (mut falcon, mut now_us) = homed(&chip);
                let mut tick = |falcon: &mut Falcon<Board>| {
                    now_us += period_us;
                    falcon.exchange(now_us, [0.0, 0.0, 2.0])
                };
                for _ in 0..20 {
                    assert!(tick(&mut falcon).expect("a link").is_some());
                }
                assert_ne!(chip.last().motors, [0; 3]);
                chip.jump(axis, counts);
                let case = format!("{counts} on {axis}, every {period_us} us");
                assert!(tick(&mut falcon).expect("an earlier request").is_some());
                for _ in 1..MAX_REJECTIONS {
                    assert_eq!(kind(tick(&mut falcon)), DeviceErrorKind::BadFrame, "{case}");
                }
                assert_eq!(
                    kind(tick(&mut falcon)),
                    DeviceErrorKind::Faulted(DeviceFault::HomeLost),
                    "{case}"
                );
                for _ in 0..1_000 {
                    assert_eq!(
                        (falcon.state(), chip.last().motors),
                        (DeviceState::Unhomed, [0; 3]),
                        "{case}"
                    );
                    assert_eq!(tick(&mut falcon), Ok(None), "{case}");
                }
                // The old position again: the board reports that it is homed, and its positions are rejected.
                chip.jump(axis, -counts);
                falcon.reset();
                assert_eq!((tick(&mut falcon), tick(&mut falcon)), (Ok(None), Ok(None)), "{case}");
                // One reply fewer than needed to report the loss does not restore the homing. The first reply
                // of each group is to an earlier request.
                for (homed, ticks) in
                    [(0b011, 2), (ALL_HOMED, 2), (0, MIN_UNHOMED - 1), (ALL_HOMED, 4), (0, MIN_UNHOMED + 1)]
                {
                    chip.set_homed(homed);
                    for _ in 0..ticks {
                        assert_eq!(tick(&mut falcon), Ok(None), "{case}, {homed}");
                    }
                }
                chip.home();
                assert_eq!(tick(&mut falcon), Ok(None), "an earlier request");
                assert!(tick(&mut falcon).expect("a link").is_some(), "homed again");
            }
        }
    }
}

/// A damaged packet without the homed flags, and the next one with them: only the old position is accepted.
#[test]
fn a_damaged_flag_does_not_reset_the_position_check() {
    for unhomed in 1..MIN_UNHOMED {
        let chip = Board::running();
        let (mut falcon, mut now_us) = homed(&chip);
        let mut tick = |falcon: &mut Falcon<Board>| {
            now_us += 1_000;
            falcon.exchange(now_us, [0.0; 3])
        };
        chip.set_homed(0);
        assert!(tick(&mut falcon).expect("a link").is_some(), "an earlier request");
        for _ in 1..unhomed {
            assert_eq!(tick(&mut falcon), Ok(None));
        }
        chip.home();
        chip.jump(0, 280);
        assert_eq!((tick(&mut falcon), falcon.state()), (Ok(None), DeviceState::Unhomed));
        assert_eq!(kind(tick(&mut falcon)), DeviceErrorKind::BadFrame, "{unhomed}");
        chip.jump(0, -280);
        let _ = tick(&mut falcon);
        assert!(tick(&mut falcon).expect("a link").is_some(), "{unhomed}: the old position");
    }
}

#[test]
fn a_fast_hand_is_tracked() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    for tick in 1..20 {
        // 2 m/s.
        chip.move_hand([2e-3 * f64::from(tick), 0.0, 0.12]);
        assert!(falcon.exchange(now_us + 1_000 * tick as u64, [0.0; 3]).expect("a link").is_some());
    }
}

#[test]
fn a_pulled_cable_disconnects_the_device() {
    let chip = Board::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.unplug();
    assert_eq!(kind(falcon.exchange(now_us + 1_000, [0.0; 3])), DeviceErrorKind::Disconnected);
    assert_eq!(falcon.state(), DeviceState::Disconnected);
    falcon.stop();
}

#[test]
fn the_workspace_rotates_the_force_and_the_profile_limits_it() {
    let chip = Board::running();
    let profile = Profile::bundled("falcon").expect("bundled");
    let profile = Profile { max_stiffness_n_m: 600.0, ..profile };
    let mut falcon =
        Falcon::start(Arc::clone(&chip), FalconConfig::of(&profile, Mode::Polled), None).expect("running");
    chip.home();
    assert_eq!(falcon.exchange(0, [0.0; 3]), Ok(None));
    let sample = falcon.exchange(1_000, [0.0; 3]).expect("a link").expect("a sample");
    // The middle of the device is the model's origin; the workspace scale is three.
    assert!(vec3::norm(sample.position_m) < 3.0 * 60e-6, "{sample:?}");
    assert_eq!(falcon.info().max_force_n, 8.0);
    // The value of its profile, not a constant of the driver.
    assert!((falcon.info().max_stiffness_n_m - 600.0 / 3.0).abs() < 1e-3);
    falcon.exchange(2_000, [0.0, 0.0, 1e6]).expect("a link");
    let limited = chip.last().motors;
    falcon.exchange(3_000, [0.0, 0.0, 8.0]).expect("a link");
    assert_eq!(chip.last().motors, limited);
}

#[test]
fn homing_ends_when_the_session_is_stopped() {
    let chip = Board::running();
    let stop = AtomicBool::new(true);
    assert_eq!(start(&chip).home(&stop), Ok(false));
}
