//! The duration of a torque, the time of the watchdog, and wrapping or drifting clocks.

use palpate_link::is_newer;
use palpate_link::{DeviceFault, DeviceMessage, HostMessage, Outputs, Phase, message};

use super::bench::{Bench, TORQUE_UNM, WATCHDOG_US};

#[test]
fn the_torque_acts_for_as_long_as_it_is_valid() {
    let mut bench = Bench::enabled();
    assert_eq!(bench.step(100).torque_unm, [0; 3], "no command yet");
    let answer = bench.command(TORQUE_UNM, 3000);
    assert!(bench.answer_is(answer, true));
    assert_eq!(bench.step(0).torque_unm, TORQUE_UNM);
    assert_eq!(bench.step(2999).torque_unm, TORQUE_UNM);
    assert_eq!(bench.step(1).torque_unm, [0; 3]);
    // No fault yet: the next command has an effect.
    bench.command([1, 2, 3], 3000);
    assert_eq!(bench.step(0).torque_unm, [1, 2, 3]);
    let (session, seq) = bench.next();
    bench.receive(HostMessage::Disable { session, seq });
    assert_eq!(bench.step(0).torque_unm, [0; 3]);
    bench.enable();
    assert_eq!(bench.step(0).torque_unm, [0; 3], "the earlier torque does not return");
}

#[test]
fn the_watchdog_is_exact_to_the_microsecond() {
    let mut bench = Bench::enabled();
    bench.now_us += WATCHDOG_US - 1;
    bench.command(TORQUE_UNM, u16::MAX);
    assert_eq!(bench.step(WATCHDOG_US - 1).torque_unm, TORQUE_UNM);
    let mut late = bench.device.clone();
    assert_eq!(bench.step(1), Outputs::default());
    assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Watchdog));
    // A command in the microsecond of the fault is too late, even if no reading precedes it.
    let command = bench.command_of(TORQUE_UNM, 3000);
    let fault = DeviceMessage::Fault { code: DeviceFault::Watchdog };
    assert_eq!(late.receive(bench.now_us, &command), Some(fault));
    assert_eq!(late.step(bench.now_us, &bench.inputs), Outputs::default());
}

/// Repeated and late commands, a repeated Enable, and messages of another session do not reset the watchdog.
#[test]
fn only_a_command_with_an_effect_resets_the_watchdog() {
    type Feed = (bool, fn(&mut Bench));
    let feeds: [Feed; 6] = [
        (true, |b| assert!(b.command(TORQUE_UNM, 1).is_some())),
        (false, |b| assert!(b.command(TORQUE_UNM, 0).is_some())),
        (false, |b| assert!(b.enable().is_some())),
        (false, |b| {
            b.seq -= 1;
            b.command(TORQUE_UNM, 3000);
        }),
        (false, |b| {
            b.session ^= 1;
            b.command(TORQUE_UNM, 3000);
            b.session ^= 1;
        }),
        (false, |b| {
            let (session, seq) = b.next();
            // One microsecond is within the drift of the clocks.
            let t_host_us = (b.now_us - 3002) as u32;
            b.receive(HostMessage::Command {
                session,
                seq,
                t_host_us,
                torque_unm: TORQUE_UNM,
                valid_for_us: 3000,
            });
        }),
    ];
    for (index, (feeds, send)) in feeds.into_iter().enumerate() {
        let mut bench = Bench::enabled();
        bench.command(TORQUE_UNM, 3000);
        bench.step(WATCHDOG_US / 2);
        send(&mut bench);
        bench.step(WATCHDOG_US / 2);
        let phase = if feeds { Phase::Enabled } else { Phase::Faulted(DeviceFault::Watchdog) };
        assert_eq!(bench.device.phase(), phase, "case {index}");
    }
}

#[test]
fn numbers_wrap_round() {
    assert!(is_newer(1, 0) && is_newer(0, u32::MAX) && is_newer(0x8000_0000, 1) && is_newer(5, 0xffff_fff0));
    assert!(!is_newer(0, 0) && !is_newer(0, 1) && !is_newer(u32::MAX, 0) && !is_newer(0x8000_0001, 1));
    let mut bench = Bench::enabled();
    let mut last = [0; 3];
    for seq in [0x7fff_ffff_u32, 0xffff_fffe, 0xffff_ffff, 0, 1, 2] {
        bench.seq = seq.wrapping_sub(1);
        last = [last[0] + 1, 0, 0];
        let answer = bench.command(last, 3000);
        assert_eq!(bench.seq, seq);
        assert!(bench.answer_is(answer, true), "{seq:x}");
        for old in [seq, seq.wrapping_sub(1), seq.wrapping_sub(0x7fff_ffff), seq.wrapping_add(0x8000_0000)] {
            bench.seq = old.wrapping_sub(1);
            let answer = bench.command([99; 3], 3000);
            bench.seq = seq;
            assert!(bench.answer_is(answer, false), "{old:x} after {seq:x}");
        }
        assert_eq!(bench.step(1000).torque_unm, last);
    }
}

#[test]
fn times_wrap_round() {
    // Both 32-bit times wrap within this run, at different moments.
    let mut bench = Bench::linked();
    bench.now_us = (7 << 32) - 10_000;
    bench.step(0);
    bench.enable();
    for tick in 0..40_u32 {
        bench.now_us += 1000;
        let (session, seq) = bench.next();
        let t_host_us = 0xffff_f000_u32.wrapping_add(1000 * tick);
        let torque_unm = [tick as i32, 0, 0];
        let answer =
            bench.receive(HostMessage::Command { session, seq, t_host_us, torque_unm, valid_for_us: 1500 });
        assert!(bench.answer_is(answer, true), "{tick}");
        assert_eq!(bench.step(0).torque_unm, torque_unm);
        let (session, seq) = bench.next();
        match bench.receive(HostMessage::Enable { session, seq }) {
            Some(DeviceMessage::State { t_dev_us, encoders, buttons, flags, .. }) => {
                assert_eq!(u64::from(t_dev_us), bench.now_us & 0xffff_ffff);
                assert_eq!((encoders, buttons), (bench.inputs.encoders, bench.inputs.buttons));
                assert_eq!(flags, message::HOMED | message::ENABLED);
            }
            other => panic!("{other:?}"),
        }
    }
    assert!(bench.now_us > 7 << 32);
}

#[test]
fn a_state_carries_the_time_of_its_reading() {
    let mut bench = Bench::linked();
    bench.step(0);
    let read_us = bench.now_us as u32;
    bench.now_us += 700;
    let answer = bench.command([0; 3], 3000);
    assert!(
        matches!(answer, Some(DeviceMessage::State { t_dev_us, .. }) if t_dev_us == read_us),
        "{answer:?}"
    );
}

#[test]
fn transport_time_counts_as_lateness() {
    let mut bench = Bench::enabled();
    let mut send = |late_us: u32, valid_for_us| {
        bench.now_us += 1000;
        let (session, seq) = bench.next();
        // The host's clock is far ahead; the transport takes 400 us.
        let t_host_us = (bench.now_us as u32 - 400 - late_us).wrapping_add(3_000_000_000);
        let torque_unm = [late_us as i32 + 1, 0, 0];
        let answer =
            bench.receive(HostMessage::Command { session, seq, t_host_us, torque_unm, valid_for_us });
        let left = (0..9000).take_while(|&wait| {
            bench.device.clone().step(bench.now_us + wait, &bench.inputs).torque_unm == torque_unm
        });
        let left = left.count();
        (bench.answer_is(answer, true), left)
    };
    assert_eq!(send(0, 5000), (true, 5000));
    assert_eq!(send(4000, 5000), (true, 1000));
    assert_eq!(send(4999, 5000), (true, 1));
    assert_eq!(send(5000, 5000), (false, 0));
    assert_eq!(send(0, 5000), (true, 5000));
}

#[test]
fn a_host_clock_that_jumps_back_ends_in_a_fault() {
    let mut bench = Bench::enabled();
    let mut jump_us = 0;
    for tick in 0..20_u32 {
        bench.now_us += 1000;
        jump_us = if tick < 5 { 0 } else { 50_000 };
        let (session, seq) = bench.next();
        let t_host_us = bench.now_us as u32 - jump_us;
        bench.receive(HostMessage::Command {
            session,
            seq,
            t_host_us,
            torque_unm: TORQUE_UNM,
            valid_for_us: 3000,
        });
        let acts = bench.step(0).torque_unm != [0; 3];
        assert_eq!(acts, tick < 7, "{tick}");
    }
    assert!(jump_us > 0 && bench.device.phase() == Phase::Faulted(DeviceFault::Watchdog));
}

#[test]
fn another_host_may_have_another_clock() {
    let mut bench = Bench::enabled();
    for ahead_us in [1_000_000_000, 500_000_000_u32, 0] {
        let (session, seq) = bench.next();
        let t_host_us = (bench.now_us as u32).wrapping_add(ahead_us);
        let torque_unm = TORQUE_UNM;
        let command = HostMessage::Command { session, seq, t_host_us, torque_unm, valid_for_us: 3000 };
        let answer = bench.receive(command);
        assert!(bench.answer_is(answer, true), "{ahead_us}");
        let (session, seq) = bench.next();
        bench.receive(HostMessage::Disable { session, seq });
        bench.enable();
    }
}
