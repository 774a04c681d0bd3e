//! The Falcon's driver with threads of its own, on the emulated device in real time.

use crate::falcon_board::{Board, STALL, wait};
use crate::falcon_exchange::POLLED;
use palpate_host::device::falcon::{Falcon, FalconConfig, Mode};
use palpate_host::{Device, DeviceErrorKind};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// A homed device with threads.
fn threaded(chip: &Arc<Board>) -> Falcon<Board> {
    let config = FalconConfig { mode: Mode::Threaded { fifo_priority: None }, ..POLLED };
    let mut falcon = Falcon::start(Arc::clone(chip), config, None).expect("running");
    chip.home();
    assert_eq!(falcon.home(&AtomicBool::new(false)), Ok(true));
    falcon
}

#[test]
fn the_thread_reads_between_exchanges_and_ends_with_the_device() {
    let chip = Board::in_real_time();
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
    let chip = Board::in_real_time();
    let mut falcon = threaded(&chip);
    let started = Instant::now();
    let mut now_us = 0;
    let mut tick = |falcon: &mut Falcon<Board>, force_n| {
        now_us += 1_000;
        falcon.exchange(now_us, force_n)
    };
    while chip.last().motors == [0; 3] {
        let _ = tick(&mut falcon, [0.0, 0.0, 2.0]);
        assert!(started.elapsed() < STALL, "no force");
        std::thread::sleep(Duration::from_micros(500));
    }
    chip.with(|script| script.stalls = true);
    while chip.with(|script| script.stalled) == 0 {
        let _ = tick(&mut falcon, [0.0, 0.0, 2.0]);
        std::thread::sleep(Duration::from_micros(500));
    }
    let before = chip.count();
    let (mut timeouts, mut stalls) = (0, 0);
    for n in 0..40_u8 {
        // As in the stale-sample policy: the last force, then none.
        let force_n = if n < 4 { [0.0, 0.0, 2.0 + f32::from(n)] } else { [0.0; 3] };
        let exchanged = tick(&mut falcon, force_n);
        timeouts += u32::from(exchanged.is_err_and(|error| error.kind().is_transient()));
        stalls += u32::from(exchanged.is_err_and(|error| error.kind() == DeviceErrorKind::Stalled));
        assert_eq!(chip.with(|script| script.stalled), 1, "tick {n} waited for the write");
    }
    assert!(timeouts > 15, "{timeouts}: the loop receives timeout errors");
    assert!(stalls > 10, "{stalls}: after 10 ms the guard must write past the thread");
    chip.make_room();
    wait(|| chip.last().motors == [0; 3]);
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
        let chip = Board::in_real_time();
        let mut falcon = threaded(&chip);
        let mut now_us = 0;
        while chip.last().motors == [0; 3] {
            now_us += 2_000;
            let _ = falcon.exchange(now_us, [0.0, 0.0, 2.0]);
            std::thread::sleep(Duration::from_micros(500));
            assert!(started.elapsed() < STALL, "no force");
        }
        chip.with(|script| script.failing_writes = 30);
        if ends {
            falcon.stop();
        } else {
            let _ = falcon.exchange(now_us + 1_000, [0.0; 3]);
        }
        wait(|| chip.last().motors == [0; 3]);
        assert_eq!(chip.with(|script| script.failing_writes), 0);
    }
}

/// A request that was replaced before it was written has no reply: none is awaited, and the other replies
/// keep their ages.
#[test]
fn a_request_replaced_before_its_write_does_not_block_later_ones() {
    let chip = Board::in_real_time();
    let mut falcon = threaded(&chip);
    chip.with(|script| script.stalls = true);
    // Homing may have left a request whose reply is on its way.
    let mut now_us = 0;
    while chip.with(|script| script.stalled) == 0 {
        now_us += 2_000;
        let _ = falcon.exchange(now_us, [0.0, 0.0, 2.0]);
        std::thread::sleep(Duration::from_micros(500));
    }
    // While that one is being written, the second, overdue, waits in the slot; the third replaces it.
    let third_us = now_us + 6_000;
    for now_us in [third_us - 3_000, third_us] {
        let _ = falcon.exchange(now_us, [0.0, 0.0, 2.0]);
    }
    let before = chip.count();
    chip.make_room();
    wait(|| chip.count() == before + 2);
    // The clock stands still: no request is overdue, so an exchange without a reply sends none.
    let started = Instant::now();
    while !falcon
        .exchange(third_us + 1_000, [0.0, 0.0, 2.0])
        .is_ok_and(|sample| sample.is_some_and(|sample| sample.t_us == third_us))
    {
        assert!(started.elapsed() < STALL, "no reply to the third");
        std::thread::sleep(Duration::from_micros(500));
    }
    // No request is open: the exchange has sent the next one without a pause.
    wait(|| chip.count() == before + 3);
}
