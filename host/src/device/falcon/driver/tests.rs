use super::*;
use crate::device::falcon::Mode;
use crate::device::falcon::fake::{self, Fake};
use crate::device::falcon::kinematics::CENTRE_M;
use crate::device::falcon::usb::UsbError;
use crate::device::fence::MAX_ZERO_MESSAGE;
use crate::device::position_check::MAX_REJECTIONS;
use crate::device::profile::Profile;
use crate::device::workspace::Workspace;
use palpate_core::vec3;
use std::time::Instant;

const POLLED: FalconConfig = FalconConfig {
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

fn start(chip: &Arc<Fake>) -> Falcon<Fake> {
    Falcon::start(Arc::clone(chip), POLLED, None).expect("running")
}

/// A homed device with threads.
fn threaded(chip: &Arc<Fake>) -> Falcon<Fake> {
    let config = FalconConfig { mode: Mode::Threaded { fifo_priority: None }, ..POLLED };
    let mut falcon = Falcon::start(Arc::clone(chip), config, None).expect("running");
    chip.home();
    assert_eq!(falcon.home(&AtomicBool::new(false)), Ok(true));
    falcon
}

/// A device after exchanges until its first sample, and the time of that.
fn homed(chip: &Arc<Fake>) -> (Falcon<Fake>, u64) {
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
    let chip = Fake::running();
    chip.with(|script| script.reply.buttons = 0b1010);
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
    let silent = Fake::silent();
    let without = Falcon::start(Arc::clone(&silent), POLLED, None);
    assert_eq!(without.err(), Some(FalconError::NeedsFirmware));
    let image = Image::synthetic(100);
    let falcon = Falcon::start(Arc::clone(&silent), POLLED, Some(&image)).expect("loaded");
    assert_eq!(falcon.state(), DeviceState::FirmwareLoaded);
    silent.with(|script| assert_eq!((script.loads, &script.image[1..]), (1, image.bytes())));
    let running = Fake::running();
    Falcon::start(Arc::clone(&running), POLLED, Some(&image)).expect("it answers");
    assert_eq!(running.with(|script| script.loads), 0, "not loaded twice");
}

/// A board that kept its power reports that it is homed. The homing of an earlier session is invalid, even of
/// a single axis.
#[test]
fn a_homing_of_an_earlier_session_is_cleared_or_refused() {
    let image = Image::synthetic(100);
    for homed in [ALL_HOMED, 1, 4] {
        let chip = Fake::running();
        chip.with(|script| script.reply.homed = homed);
        let without = Falcon::start(Arc::clone(&chip), POLLED, None);
        assert_eq!(without.err(), Some(FalconError::HomedBefore), "{homed}");
        let mut falcon = Falcon::start(Arc::clone(&chip), POLLED, Some(&image)).expect("loaded again");
        assert_eq!(chip.with(|script| script.loads), 1);
        for tick in 0..20 {
            assert_eq!(falcon.exchange(1_000 * tick, [0.0, 0.0, 3.0]), Ok(None));
            assert_eq!((chip.last().motors, chip.last().homing), ([0; 3], true));
        }
        assert_eq!(falcon.state(), DeviceState::Unhomed);
        chip.home();
        let _ = falcon.exchange(20_000, [0.0; 3]);
        assert!(falcon.exchange(21_000, [0.0; 3]).expect("a link").is_some());
    }
    let keeping = Fake::running();
    keeping.with(|script| (script.keeps_homing, script.reply.homed) = (true, ALL_HOMED));
    let refused = Falcon::start(Arc::clone(&keeping), POLLED, Some(&image));
    assert_eq!(refused.err(), Some(FalconError::HomedBefore), "it was loaded and still reports homing");
}

#[test]
fn there_is_no_force_and_no_sample_before_all_three_axes_are_homed() {
    let chip = Fake::running();
    let mut falcon = start(&chip);
    for (tick, homed) in [0, 1, 3, 5, 6].into_iter().cycle().take(20).enumerate() {
        chip.with(|script| script.reply.homed = homed);
        assert_eq!(falcon.exchange(1_000 * tick as u64, [0.0, 0.0, 3.0]), Ok(None));
        let request = chip.last();
        assert_eq!((request.motors, request.homing), ([0; 3], true));
        assert_eq!(request.lights, Lights { red: true, ..Lights::default() });
    }
    assert_eq!(falcon.state(), DeviceState::Unhomed);
    chip.with(|script| script.reply.homed = ALL_HOMED);
    assert_eq!(falcon.exchange(20_000, [0.0; 3]), Ok(None), "this reply is to an earlier request");
    assert!(falcon.exchange(21_000, [0.0; 3]).expect("a link").is_some());
    assert_eq!(falcon.state(), DeviceState::Homed);
    let request = chip.last();
    assert_eq!((request.motors, request.homing), ([0; 3], false));
    assert_eq!(request.lights, Lights { blue: true, ..Lights::default() });
}

#[test]
fn a_force_reaches_the_motors_until_the_homed_flags_are_lost() {
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    falcon.exchange(now_us + 1_000, [0.0, 0.0, 2.0]).expect("a link");
    let request = chip.last();
    // Towards the user: the cranks turn up, and the scale is negative.
    assert!(request.motors[0] < -100 && request.motors == [request.motors[0]; 3], "{request:?}");
    assert_eq!(request.lights, Lights { green: true, ..Lights::default() });
    chip.with(|script| script.reply.homed = 0b011);
    falcon.exchange(now_us + 2_000, [0.0, 0.0, 2.0]).expect("a link");
    assert_eq!(falcon.exchange(now_us + 3_000, [0.0, 0.0, 2.0]), Ok(None));
    assert_eq!(falcon.state(), DeviceState::Unhomed);
    assert_eq!((chip.last().motors, chip.last().homing), ([0; 3], true));
}

/// Homing resets the counts: the same position may have other counts, and this is not a jump.
#[test]
fn homing_again_resets_the_coordinates() {
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.with(|script| script.reply.homed = 0);
    assert!(falcon.exchange(now_us + 1_000, [0.0; 3]).is_ok());
    for tick in 2..2 + u64::from(MIN_UNHOMED_REPLIES) {
        assert_eq!(falcon.exchange(now_us + 1_000 * tick, [0.0; 3]), Ok(None));
    }
    chip.with(|script| {
        script.reply.homed = ALL_HOMED;
        script.move_hand([0.03, -0.02, 0.14]);
    });
    falcon.exchange(now_us + 6_000, [0.0; 3]).expect("a link");
    let sample = falcon.exchange(now_us + 7_000, [0.0; 3]).expect("a link").expect("a sample");
    assert!(vec3::distance(sample.position_m, [0.03, -0.02, 0.14]) < 60e-6);
}

#[test]
fn a_late_reply_has_the_time_of_its_request() {
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    // One is answered at once; the next reply is held.
    falcon.exchange(now_us + 1_000, [0.0; 3]).expect("a link");
    chip.with(|script| script.holds = true);
    falcon.exchange(now_us + 2_000, [0.0; 3]).expect("a link");
    assert_eq!(falcon.exchange(now_us + 3_000, [0.0; 3]), Ok(None), "no reply yet, and nothing is sent");
    let sent = chip.with(|script| script.requests.len());
    assert_eq!(kind(falcon.exchange(now_us + 4_000, [0.0; 3])), DeviceErrorKind::Timeout);
    assert_eq!(chip.with(|script| script.requests.len()), sent + 1, "timed out, and the next is sent");
    chip.with(|script| {
        script.held.truncate(1);
        script.release();
    });
    let sample = falcon.exchange(now_us + 5_000, [0.0; 3]).expect("a link").expect("a sample");
    assert_eq!(sample.t_us, now_us + 2_000);
    // The other request is never answered: after a silence exchanges continue as before.
    chip.with(|script| script.holds = false);
    let mut samples = (6..12).filter_map(|tick| falcon.exchange(now_us + 1_000 * tick, [0.0; 3]).ok()?);
    assert!(samples.any(|sample| sample.t_us > now_us + 6_000 && sample.t_us < now_us + 11_000));
}

#[test]
fn a_force_is_zeroed_in_every_state_of_the_link() {
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.with(|script| script.holds = true);
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
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    let zeros = |act: &mut dyn FnMut()| {
        let before = chip.with(|script| script.requests.len());
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
    let chip = Fake::running();
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
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    let whole = chip.with(|script| script.reply.encode());
    chip.with(|script| script.holds = true);
    falcon.exchange(now_us + 1_000, [0.0; 3]).expect("a link");
    // Split by the transfer: not damaged.
    chip.with(|script| script.queue(&whole[..9]));
    assert_eq!(falcon.exchange(now_us + 2_000, [0.0; 3]), Ok(None));
    chip.with(|script| script.queue(&whole[9..]));
    assert!(falcon.exchange(now_us + 2_500, [0.0; 3]).expect("a link").is_some());
    // Truncated: an error, then a pause, then a sample.
    chip.with(|script| script.queue(&[&whole[..5], b"\xFF"].concat()));
    assert_eq!(kind(falcon.exchange(now_us + 3_000, [0.0; 3])), DeviceErrorKind::BadFrame);
    chip.with(|script| script.holds = false);
    let found =
        (4..12).any(|tick| falcon.exchange(now_us + 1_000 * tick, [0.0; 3]).is_ok_and(|s| s.is_some()));
    assert!(found, "exchanges continue");
}

#[test]
fn an_unreachable_position_is_an_error_without_a_sample() {
    for far in [[4000, -516, 900], [-100, -516, -900]] {
        let chip = Fake::running();
        let (mut falcon, now_us) = homed(&chip);
        let good = chip.with(|script| core::mem::replace(&mut script.reply.encoders, far));
        falcon.exchange(now_us + 1_000, [0.0; 3]).expect("an earlier request");
        assert_eq!(kind(falcon.exchange(now_us + 2_000, [0.0; 3])), DeviceErrorKind::BadFrame, "{far:?}");
        chip.with(|script| script.reply.encoders = good);
        let _ = falcon.exchange(now_us + 3_000, [0.0; 3]);
        let sample = falcon.exchange(now_us + 4_000, [0.0; 3]).expect("a link").expect("a sample");
        assert!(vec3::distance(sample.position_m, CENTRE_M.map(|m| m as f32)) < 60e-6);
    }
}

/// One or two damaged packets that look valid, while the hand rests or moves.
#[test]
fn single_unreachable_positions_are_skipped() {
    for wrong in 1..MAX_REJECTIONS as u64 {
        let chip = Fake::running();
        let (mut falcon, mut now_us) = homed(&chip);
        let mut errors = 0;
        for tick in 1..200_u64 {
            now_us += 1_000;
            // 1 m/s, back and forth.
            let phase = (tick % 40) as f64;
            chip.with(|script| script.move_hand([1e-3 * phase.min(40.0 - phase), 0.0, 0.12]));
            if tick % 10 < wrong {
                chip.with(|script| script.reply.encoders[0] += 0x100);
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
                let chip = Fake::running();
                let (mut falcon, mut now_us) = homed(&chip);
                let mut tick = |falcon: &mut Falcon<Fake>| {
                    now_us += period_us;
                    falcon.exchange(now_us, [0.0, 0.0, 2.0])
                };
                for _ in 0..20 {
                    assert!(tick(&mut falcon).expect("a link").is_some());
                }
                assert_ne!(chip.last().motors, [0; 3]);
                chip.with(|script| script.reply.encoders[axis] += counts);
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
                chip.with(|script| script.reply.encoders[axis] -= counts);
                falcon.reset();
                assert_eq!((tick(&mut falcon), tick(&mut falcon)), (Ok(None), Ok(None)), "{case}");
                // One reply fewer than needed to report the loss does not restore the homing. The first reply
                // of each group is to an earlier request.
                for (homed, ticks) in [
                    (0b011, 2),
                    (ALL_HOMED, 2),
                    (0, MIN_UNHOMED_REPLIES - 1),
                    (ALL_HOMED, 4),
                    (0, MIN_UNHOMED_REPLIES + 1),
                ] {
                    chip.with(|script| script.reply.homed = homed);
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
    for unhomed in 1..MIN_UNHOMED_REPLIES {
        let chip = Fake::running();
        let (mut falcon, mut now_us) = homed(&chip);
        let mut tick = |falcon: &mut Falcon<Fake>| {
            now_us += 1_000;
            falcon.exchange(now_us, [0.0; 3])
        };
        chip.with(|script| script.reply.homed = 0);
        assert!(tick(&mut falcon).expect("a link").is_some(), "an earlier request");
        for _ in 1..unhomed {
            assert_eq!(tick(&mut falcon), Ok(None));
        }
        chip.with(|script| {
            script.reply.homed = ALL_HOMED;
            script.reply.encoders[0] += 280;
        });
        assert_eq!((tick(&mut falcon), falcon.state()), (Ok(None), DeviceState::Unhomed));
        assert_eq!(kind(tick(&mut falcon)), DeviceErrorKind::BadFrame, "{unhomed}");
        chip.with(|script| script.reply.encoders[0] -= 280);
        let _ = tick(&mut falcon);
        assert!(tick(&mut falcon).expect("a link").is_some(), "{unhomed}: the old position");
    }
}

#[test]
fn a_fast_hand_is_tracked() {
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    for tick in 1..20 {
        // 2 m/s.
        chip.with(|script| script.move_hand([2e-3 * f64::from(tick), 0.0, 0.12]));
        assert!(falcon.exchange(now_us + 1_000 * tick as u64, [0.0; 3]).expect("a link").is_some());
    }
}

#[test]
fn a_pulled_cable_disconnects_the_device() {
    let chip = Fake::running();
    let (mut falcon, now_us) = homed(&chip);
    chip.with(|script| script.unplugged = true);
    assert_eq!(kind(falcon.exchange(now_us + 1_000, [0.0; 3])), DeviceErrorKind::Disconnected);
    assert_eq!(falcon.state(), DeviceState::Disconnected);
    falcon.stop();
}

#[test]
fn the_workspace_rotates_the_force_and_the_profile_limits_it() {
    let chip = Fake::running();
    let profile = crate::device::profile::Profile::bundled("falcon").expect("bundled");
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
fn the_thread_reads_between_exchanges_and_ends_with_the_device() {
    let chip = Fake::running();
    let config = FalconConfig { mode: Mode::Threaded { fifo_priority: None }, ..POLLED };
    let mut falcon = Falcon::start(Arc::clone(&chip), config, None).expect("running");
    let stop = AtomicBool::new(false);
    chip.home();
    assert_eq!(falcon.home(&stop), Ok(true));
    let (mut samples, started) = (0, Instant::now());
    while samples < 50 {
        let now_us = started.elapsed().as_micros() as u64;
        if let Ok(Some(sample)) = falcon.exchange(now_us, [0.5, 0.0, 0.0]) {
            assert!(sample.t_us < now_us);
            samples += 1;
        }
        assert!(started.elapsed() < Duration::from_secs(20), "{samples} samples");
        std::thread::sleep(Duration::from_micros(500));
    }
    drop(falcon);
    assert_eq!(chip.last().motors, [0; 3]);
    // The threads held references to the chip.
    assert_eq!(Arc::strong_count(&chip), 1);
}

/// A chip without room: no exchange waits for it. When there is room it receives the newest request, not all
/// that were sent in between.
#[test]
fn an_exchange_does_not_wait_for_a_blocked_write() {
    let chip = Fake::running();
    let mut falcon = threaded(&chip);
    let started = Instant::now();
    let mut now_us = 0;
    let mut tick = |falcon: &mut Falcon<Fake>, force_n| {
        now_us += 1_000;
        falcon.exchange(now_us, force_n)
    };
    let settle = |done: &dyn Fn() -> bool| {
        while !done() {
            assert!(started.elapsed() < fake::STALL, "the event does not happen");
            std::thread::sleep(Duration::from_micros(200));
        }
    };
    while chip.last().motors == [0; 3] {
        let _ = tick(&mut falcon, [0.0, 0.0, 2.0]);
        assert!(started.elapsed() < fake::STALL, "no force");
        std::thread::sleep(Duration::from_micros(500));
    }
    chip.with(|script| script.stalls = true);
    while chip.with(|script| script.stalled) == 0 {
        let _ = tick(&mut falcon, [0.0, 0.0, 2.0]);
        std::thread::sleep(Duration::from_micros(500));
    }
    let before = chip.with(|script| script.requests.len());
    let mut timeouts = 0;
    for n in 0..40_u8 {
        // As in the stale-sample policy: the last force, then none.
        let force_n = if n < 4 { [0.0, 0.0, 2.0 + f32::from(n)] } else { [0.0; 3] };
        let exchanged = tick(&mut falcon, force_n);
        timeouts += u32::from(exchanged.is_err_and(|error| error.kind() == DeviceErrorKind::Timeout));
        assert_eq!(chip.with(|script| script.stalled), 1, "tick {n} waited for the write");
    }
    assert!(timeouts > 15, "{timeouts}: the loop receives timeout errors");
    chip.make_room();
    settle(&|| chip.last().motors == [0; 3]);
    // The blocked one and the newest.
    let written = chip.with(|script| script.requests.split_off(before));
    assert!(written.len() <= 2, "a burst: {written:?}");
}

/// A failed zero is repeated until it is written, even without further exchanges: by the thread, and at the
/// end.
#[test]
fn a_failed_zero_is_repeated_until_it_is_written() {
    let started = Instant::now();
    for ends in [false, true] {
        let chip = Fake::running();
        let mut falcon = threaded(&chip);
        let wait = |done: &dyn Fn() -> bool| {
            while !done() {
                assert!(started.elapsed() < fake::STALL, "the event does not happen");
                std::thread::sleep(Duration::from_micros(200));
            }
        };
        let mut now_us = 0;
        while chip.last().motors == [0; 3] {
            now_us += 2_000;
            let _ = falcon.exchange(now_us, [0.0, 0.0, 2.0]);
            std::thread::sleep(Duration::from_micros(500));
            assert!(started.elapsed() < fake::STALL, "no force");
        }
        chip.with(|script| script.failing_writes = 30);
        if ends {
            falcon.stop();
        } else {
            let _ = falcon.exchange(now_us + 1_000, [0.0; 3]);
        }
        wait(&|| chip.last().motors == [0; 3]);
        assert_eq!(chip.with(|script| script.failing_writes), 0);
    }
}

/// A request that was replaced before it was written has no reply: none is awaited, and the other replies
/// keep their ages.
#[test]
fn a_request_replaced_before_its_write_does_not_block_later_ones() {
    let chip = Fake::running();
    let mut falcon = threaded(&chip);
    let started = Instant::now();
    let wait = |done: &dyn Fn() -> bool| {
        while !done() {
            assert!(started.elapsed() < fake::STALL, "the event does not happen");
            std::thread::sleep(Duration::from_micros(200));
        }
    };
    chip.with(|script| script.stalls = true);
    // While the first is being written, the second, overdue, waits in the slot; the third replaces it.
    for now_us in [1_000, 3_000, 5_000] {
        let _ = falcon.exchange(now_us, [0.0, 0.0, 2.0]);
        wait(&|| chip.with(|script| script.stalled) == 1);
    }
    let before = chip.with(|script| script.requests.len());
    chip.make_room();
    wait(&|| chip.with(|script| script.requests.len()) == before + 2);
    let seen = falcon.seen.whole;
    while falcon.reply_reader.poll(&*chip).whole < seen + 2 {
        assert!(started.elapsed() < fake::STALL, "no replies");
        std::thread::sleep(Duration::from_micros(200));
    }
    let sample = falcon.exchange(6_000, [0.0, 0.0, 2.0]).expect("a link");
    assert_eq!(sample.map(|sample| sample.t_us), Some(5_000), "the reply to the third");
    // No request is open: the exchange has sent the next one without a pause.
    wait(&|| chip.with(|script| script.requests.len()) == before + 3);
}

#[test]
fn homing_ends_when_the_session_is_stopped() {
    let chip = Fake::running();
    let stop = AtomicBool::new(true);
    assert_eq!(start(&chip).home(&stop), Ok(false));
}

#[test]
fn errors_are_one_line_and_name_the_fix() {
    let disconnected = DeviceError::new(DeviceErrorKind::Disconnected);
    for error in [
        FalconError::Device(disconnected),
        FalconError::NeedsFirmware,
        FalconError::HomedBefore,
        FalconError::Usb(UsbError::NotFound),
    ] {
        let text = error.to_string();
        assert!(!text.contains('\n') && text.contains("; "), "{text}");
    }
}
