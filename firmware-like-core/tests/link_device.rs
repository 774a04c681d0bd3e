//! The device's side of the link: torque only where every rule is kept, and never again after a fault without a handshake.

use palpate_core::link::guard::{Lateness, SpeedWatch, clamp_torque, is_newer};
use palpate_core::link::{
    Device, DeviceFault, DeviceInfo, DeviceMessage, DeviceProfile, FrameReader, HostMessage, Inputs,
    MAX_FRAME, Outputs, Phase, VERSION, device::ProfileError, encode, message,
};
use proptest::prelude::*;

const WATCHDOG_US: u64 = 10_000;
const LIMIT_UNM: [u32; 3] = [500_000, 400_000, 250_000];
const TORQUE_UNM: [i32; 3] = [100_000, -200_000, 50];

fn profile() -> DeviceProfile {
    DeviceProfile {
        info: DeviceInfo {
            dof: 3,
            counts_per_turn: [4096; 3],
            torque_limit_unm: LIMIT_UNM,
            watchdog_us: WATCHDOG_US as u16,
            serial: 17,
            firmware: 1,
        },
        max_speed_counts_per_s: 20_000,
        boot: 0,
    }
}

/// A device, and a host that keeps its books.
struct Bench {
    device: Device,
    now_us: u64,
    inputs: Inputs,
    session: u32,
    seq: u32,
}

impl Bench {
    fn new() -> Self {
        let device = Device::new(profile()).expect("a good profile");
        let inputs = Inputs { encoders: [5, -6, 7], buttons: 2, homed: true, fault: false };
        let mut bench = Self { device, now_us: 5_000_000, inputs, session: 0, seq: 0 };
        assert_eq!(bench.step(0), Outputs::default());
        bench
    }

    fn linked() -> Self {
        let mut bench = Self::new();
        bench.hello();
        bench
    }

    fn unhomed() -> Self {
        let mut bench = Self::linked();
        bench.inputs.homed = false;
        bench.step(100);
        bench
    }

    fn homing() -> Self {
        let mut bench = Self::unhomed();
        bench.receive(HostMessage::Home { session: bench.session, seq: 1 });
        bench.seq = 1;
        bench.step(100);
        assert_eq!(bench.device.phase(), Phase::Homing);
        bench
    }

    fn enabled() -> Self {
        let mut bench = Self::linked();
        let enable = bench.enable();
        assert!(bench.answer_is(enable, true) && bench.device.phase() == Phase::Enabled);
        bench
    }

    fn faulted() -> Self {
        let mut bench = Self::enabled();
        bench.inputs.fault = true;
        bench.step(100);
        bench.inputs.fault = false;
        bench.step(100);
        assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Hardware));
        bench
    }

    fn step(&mut self, after_us: u64) -> Outputs {
        self.now_us += after_us;
        self.device.step(self.now_us, &self.inputs)
    }

    fn receive(&mut self, message: HostMessage) -> Option<DeviceMessage> {
        self.device.receive(self.now_us, &message)
    }

    fn hello(&mut self) {
        match self.receive(HostMessage::Hello { version: VERSION, nonce: 77 }) {
            Some(DeviceMessage::HelloAck { version: VERSION, nonce: 77, session, info }) => {
                assert!(session != 0 && session != self.session && info == profile().info);
                self.session = session;
                self.seq = 0;
            }
            other => panic!("{other:?}"),
        }
    }

    fn next(&mut self) -> (u32, u32) {
        self.seq = self.seq.wrapping_add(1);
        (self.session, self.seq)
    }

    fn enable(&mut self) -> Option<DeviceMessage> {
        let (session, seq) = self.next();
        self.receive(HostMessage::Enable { session, seq })
    }

    fn command_of(&mut self, torque_unm: [i32; 3], valid_for_us: u16) -> HostMessage {
        let (session, seq) = self.next();
        HostMessage::Command { session, seq, t_host_us: self.now_us as u32, torque_unm, valid_for_us }
    }

    fn command(&mut self, torque_unm: [i32; 3], valid_for_us: u16) -> Option<DeviceMessage> {
        let command = self.command_of(torque_unm, valid_for_us);
        self.receive(command)
    }

    /// Whether the answer is the state with the newest number, and says that the request was done, or refused.
    fn answer_is(&self, answer: Option<DeviceMessage>, done: bool) -> bool {
        matches!(answer, Some(DeviceMessage::State { seq_echo, flags, .. })
            if seq_echo == self.seq && (flags & message::REFUSED == 0) == done)
    }
}

type Event = (&'static str, [&'static str; 6], fn(&mut Bench) -> String);

fn initial(phase: Phase) -> char {
    match phase {
        Phase::Idle => 'I',
        Phase::Linked => 'L',
        Phase::Homing => 'H',
        Phase::Enabled => 'E',
        Phase::Faulted(_) => 'F',
    }
}

/// A phase and the kind of the answer: Ack, Done, Refused, Fault, or none.
fn answered(bench: &mut Bench, message: HostMessage) -> String {
    let answer = match bench.receive(message) {
        None => '-',
        Some(DeviceMessage::HelloAck { .. }) => 'A',
        Some(DeviceMessage::Fault { .. }) => 'F',
        Some(DeviceMessage::State { flags, .. }) if flags & message::REFUSED != 0 => 'R',
        Some(DeviceMessage::State { .. }) => 'D',
    };
    format!("{}{answer}", initial(bench.device.phase()))
}

fn stepped(bench: &mut Bench, after_us: u64) -> String {
    bench.step(after_us);
    initial(bench.device.phase()).to_string()
}

/// Every state and every event: the state after it and the answer.
#[test]
fn every_state_meets_every_event() {
    let states = [
        ("idle", Bench::new as fn() -> Bench),
        ("unhomed", Bench::unhomed),
        ("linked", Bench::linked),
        ("homing", Bench::homing),
        ("enabled", Bench::enabled),
        ("faulted", Bench::faulted),
    ];
    let table: [Event; 27] = [
        ("hello", ["LA", "LA", "LA", "LA", "LA", "LA"], |b| {
            answered(b, HostMessage::Hello { version: VERSION, nonce: 3 })
        }),
        ("hello of another version", ["IA", "IA", "IA", "IA", "IA", "FA"], |b| {
            answered(b, HostMessage::Hello { version: VERSION + 1, nonce: 3 })
        }),
        ("enable", ["I-", "LR", "ED", "HR", "ED", "FF"], |b| {
            let (session, seq) = b.next();
            answered(b, HostMessage::Enable { session, seq })
        }),
        ("disable", ["I-", "LD", "LD", "LD", "LD", "FF"], |b| {
            let (session, seq) = b.next();
            answered(b, HostMessage::Disable { session, seq })
        }),
        ("home", ["I-", "HD", "HD", "HD", "HD", "FF"], |b| {
            let (session, seq) = b.next();
            answered(b, HostMessage::Home { session, seq })
        }),
        ("command", ["I-", "LR", "LR", "HR", "ED", "FF"], |b| {
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
        ("command valid for no time", ["I-", "LR", "LR", "HR", "ER", "FF"], |b| {
            let command = b.command_of(TORQUE_UNM, 0);
            answered(b, command)
        }),
        ("enable again", ["I-", "LR", "LR", "HR", "ER", "FF"], |b| {
            answered(b, HostMessage::Enable { session: b.session, seq: b.seq })
        }),
        ("disable again", ["I-", "LD", "LD", "LD", "LD", "FF"], |b| {
            answered(b, HostMessage::Disable { session: b.session, seq: b.seq })
        }),
        ("home again", ["I-", "LR", "LR", "HR", "ER", "FF"], |b| {
            answered(b, HostMessage::Home { session: b.session, seq: b.seq })
        }),
        ("command again", ["I-", "LR", "LR", "HR", "ER", "FF"], |b| {
            b.seq = b.seq.wrapping_sub(1);
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
        ("old command", ["I-", "LR", "LR", "HR", "ER", "FF"], |b| {
            b.seq = b.seq.wrapping_sub(2);
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
        ("enable of another session", ["I-", "L-", "L-", "H-", "E-", "F-"], |b| {
            answered(b, HostMessage::Enable { session: b.session ^ 1, seq: 9 })
        }),
        ("disable of another session", ["I-", "L-", "L-", "H-", "E-", "F-"], |b| {
            answered(b, HostMessage::Disable { session: b.session ^ 1, seq: 9 })
        }),
        ("home of another session", ["I-", "L-", "L-", "H-", "E-", "F-"], |b| {
            answered(b, HostMessage::Home { session: b.session ^ 1, seq: 9 })
        }),
        ("command of another session", ["I-", "L-", "L-", "H-", "E-", "F-"], |b| {
            b.session ^= 1;
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
        ("command of session 0", ["I-", "L-", "L-", "H-", "E-", "F-"], |b| {
            b.session = 0;
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
        ("reading", ["I", "L", "L", "H", "E", "F"], |b| stepped(b, 100)),
        ("two readings", ["I", "L", "L", "H", "E", "F"], |b| {
            stepped(b, 100);
            stepped(b, 100)
        }),
        ("home found", ["I", "L", "L", "L", "E", "F"], |b| {
            b.inputs.homed = true;
            stepped(b, 100)
        }),
        ("home lost", ["I", "L", "L", "H", "F", "F"], |b| {
            b.inputs.homed = false;
            stepped(b, 100)
        }),
        ("jump of an encoder", ["I", "L", "L", "H", "F", "F"], |b| {
            b.inputs.encoders[1] += 21;
            stepped(b, 100)
        }),
        ("fault of the hardware", ["F", "F", "F", "F", "F", "F"], |b| {
            b.inputs.fault = true;
            stepped(b, 100)
        }),
        ("reading, clock backwards", ["F", "F", "F", "F", "F", "F"], |b| {
            b.now_us -= 1;
            stepped(b, 0)
        }),
        ("command, clock backwards", ["F-", "FF", "FF", "FF", "FF", "FF"], |b| {
            b.now_us -= 1;
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
        ("silence, then a reading", ["I", "L", "L", "H", "F", "F"], |b| stepped(b, WATCHDOG_US)),
        ("silence, then a command", ["I-", "LR", "LR", "HR", "FF", "FF"], |b| {
            b.now_us += WATCHDOG_US;
            let command = b.command_of(TORQUE_UNM, 3000);
            answered(b, command)
        }),
    ];
    for (event, expected, happen) in table {
        for ((state, start), expected) in states.iter().zip(expected) {
            let mut bench = start();
            assert_eq!(happen(&mut bench), expected, "{state}: {event}");
            if bench.device.phase() != Phase::Enabled {
                assert_eq!(bench.step(0).torque_unm, [0; 3], "{state}: {event}");
            }
        }
    }
}

#[test]
fn the_torque_acts_for_as_long_as_it_is_valid() {
    let mut bench = Bench::enabled();
    assert_eq!(bench.step(100).torque_unm, [0; 3], "no command yet");
    let answer = bench.command(TORQUE_UNM, 3000);
    assert!(bench.answer_is(answer, true));
    assert_eq!(bench.step(0).torque_unm, TORQUE_UNM);
    assert_eq!(bench.step(2999).torque_unm, TORQUE_UNM);
    assert_eq!(bench.step(1).torque_unm, [0; 3]);
    // Not a fault yet: the next one acts.
    bench.command([1, 2, 3], 3000);
    assert_eq!(bench.step(0).torque_unm, [1, 2, 3]);
    let (session, seq) = bench.next();
    bench.receive(HostMessage::Disable { session, seq });
    assert_eq!(bench.step(0).torque_unm, [0; 3]);
    bench.enable();
    assert_eq!(bench.step(0).torque_unm, [0; 3], "the torque before does not come back");
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
    // A command at that very microsecond comes too late, even if no reading was taken before it.
    let command = bench.command_of(TORQUE_UNM, 3000);
    let fault = DeviceMessage::Fault { code: DeviceFault::Watchdog };
    assert_eq!(late.receive(bench.now_us, &command), Some(fault));
    assert_eq!(late.step(bench.now_us, &bench.inputs), Outputs::default());
}

/// Replays, late commands, repeated enabling, and what belongs to another session.
#[test]
fn only_a_command_that_acts_feeds_the_watchdog() {
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
            // A microsecond is forgiven as drift of the clocks.
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
fn time_on_the_way_counts() {
    let mut bench = Bench::enabled();
    let mut send = |late_us: u32, valid_for_us| {
        bench.now_us += 1000;
        let (session, seq) = bench.next();
        // The host's clock is far ahead; the way takes 400 us.
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
    let mut lateness = Lateness::new();
    let (first_us, ticks) = (1_u64 << 40, 600_000_u64);
    for tick in 0..ticks {
        // Ten minutes with a host's clock that is slow by 200 parts in a million.
        let now_us = first_us + tick * 1000;
        let late_us = lateness.judge(now_us, (tick * 1000 - tick / 5) as u32);
        assert!(late_us <= 1, "{late_us} us at {tick} ms");
    }
    let now_us = first_us + ticks * 1000;
    let late_us = lateness.judge(now_us, (ticks * 1000 - ticks / 5 - 7000) as u32);
    assert!((6990..=7001).contains(&late_us), "{late_us}");
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
fn homing_is_asked_for_and_waited_for() {
    // The hardware still says homed, from an earlier search, when the request is new.
    let mut bench = Bench::enabled();
    bench.command(TORQUE_UNM, 3000);
    assert_eq!(bench.step(100).torque_unm, TORQUE_UNM);
    let (session, seq) = bench.next();
    let answer = bench.receive(HostMessage::Home { session, seq });
    assert!(bench.answer_is(answer, true));
    assert_eq!(bench.step(100), Outputs { torque_unm: [0; 3], home: true }, "this reading is older");
    bench.inputs.homed = false;
    assert_eq!(bench.step(100), Outputs { torque_unm: [0; 3], home: true });
    let answer = bench.enable();
    assert!(bench.answer_is(answer, false), "not homed");
    bench.inputs.homed = true;
    // Coordinates begin anew: no fault, nothing is enabled.
    bench.inputs.encoders = [0; 3];
    assert_eq!(bench.step(100), Outputs::default());
    assert_eq!(bench.device.phase(), Phase::Linked);
    let answer = bench.enable();
    assert!(bench.answer_is(answer, true));
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Enabled);
    // And once more in the same session.
    let (session, seq) = bench.next();
    bench.receive(HostMessage::Home { session, seq });
    assert!(bench.step(100).home && !bench.step(100).home);
}

#[test]
fn a_fault_of_the_hardware_that_lasts_cannot_be_cleared() {
    let mut bench = Bench::enabled();
    bench.inputs.fault = true;
    bench.step(100);
    bench.hello();
    let answer = bench.enable();
    assert!(bench.answer_is(answer, false), "before the next reading");
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Hardware));
}

#[test]
fn the_first_fault_stays() {
    let mut bench = Bench::enabled();
    bench.step(WATCHDOG_US);
    bench.inputs = Inputs { fault: true, homed: false, encoders: [9999; 3], buttons: 0 };
    bench.step(1);
    bench.now_us -= 100;
    bench.step(0);
    assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Watchdog));
}

#[test]
fn speed_is_judged_over_a_millisecond_at_least() {
    let watch = |steps: &[(u64, i32)]| {
        let mut watch = SpeedWatch::new();
        steps.iter().any(|&(now_us, count)| {
            watch.is_too_fast(now_us, [0, count, i32::MAX.wrapping_sub(count)], 2, 20_000)
        })
    };
    assert!(!watch(&[(0, 5)]), "the first reading has nothing before it");
    assert!(!watch(&[(0, 0), (10, 1), (11, 2), (11, 3)]), "counts close together are no speed");
    assert!(!watch(&[(0, 0), (100, 20)]) && watch(&[(0, 0), (100, 21)]) && watch(&[(0, 0), (100, -21)]));
    assert!(!watch(&[(0, 0), (2000, 40)]) && watch(&[(0, 0), (2000, 41)]));
    assert!(watch(&[(0, 0), (500, 15), (900, 21)]), "creeping within the window");
    assert!(!watch(&[(0, 0), (1000, 20), (1100, 40)]) && watch(&[(0, 0), (999, 20), (1099, 40)]));
    assert!(!watch(&[(0, i32::MAX), (100, i32::MIN)]), "counts wrap round");
    assert!(watch(&[(0, 0), (100, i32::MIN)]));
    assert!(!watch(&[(0, 0), (u64::MAX, i32::MAX)]));
    // Moving fast is a fault while enabled only.
    let mut bench = Bench::linked();
    bench.inputs.encoders = [1000, 0, 0];
    bench.step(100);
    bench.enable();
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Enabled);
    bench.inputs.encoders = [1021, 0, 0];
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Overspeed));
}

#[test]
fn no_session_comes_twice_in_a_row() {
    let mut bench = Bench::new();
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..10_000 {
        bench.hello();
        seen.insert(bench.session);
    }
    assert!(seen.len() > 9_990, "{}", seen.len());
    let mut other = Bench::new();
    other.device = Device::new(DeviceProfile { boot: 1, ..profile() }).expect("good");
    other.hello();
    assert!(!seen.contains(&other.session), "another start of the firmware");
}

/// The nonces for which the hash is that of the session before, and zero.
#[test]
fn no_nonce_gives_a_session_that_is_known() {
    const PER_SESSION: u32 = 0x9e37_79b9;
    let mut bench = Bench::new();
    let mut open = |nonce| match bench.receive(HostMessage::Hello { version: VERSION, nonce }) {
        Some(DeviceMessage::HelloAck { session, .. }) => session,
        other => panic!("{other:?}"),
    };
    let first = open(77);
    assert_eq!(open(77_u32.wrapping_sub(PER_SESSION)), first.wrapping_add(1));
    assert_eq!(open(0_u32.wrapping_sub(PER_SESSION.wrapping_mul(3))), 1);
    assert_eq!(open(0_u32.wrapping_sub(PER_SESSION.wrapping_mul(4))), 2);
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

#[test]
fn a_hello_of_another_version_ends_the_session() {
    let mut bench = Bench::enabled();
    bench.command(TORQUE_UNM, 3000);
    let answer = bench.receive(HostMessage::Hello { version: 0, nonce: 4 });
    let info = profile().info;
    assert_eq!(answer, Some(DeviceMessage::HelloAck { version: VERSION, nonce: 4, session: 0, info }));
    assert_eq!(bench.step(0).torque_unm, [0; 3]);
    assert_eq!(bench.enable(), None);
}

#[test]
fn an_impossible_profile_is_refused() {
    let mut bad = profile();
    bad.info.watchdog_us = 20_001;
    assert!(matches!(Device::new(bad), Err(ProfileError::Info(_))));
    let slow = DeviceProfile { max_speed_counts_per_s: 999, ..profile() };
    assert_eq!(Device::new(slow), Err(ProfileError::MaxSpeed { max_speed_counts_per_s: 999 }));
}

#[test]
fn an_axis_that_is_not_there_gets_no_torque() {
    let mut bench = Bench::linked();
    let mut profile = profile();
    profile.info.dof = 2;
    bench.device = Device::new(profile).expect("two axes");
    bench.session = 0;
    bench.step(0);
    match bench.receive(HostMessage::Hello { version: VERSION, nonce: 1 }) {
        Some(DeviceMessage::HelloAck { session, .. }) => (bench.session, bench.seq) = (session, 0),
        other => panic!("{other:?}"),
    }
    bench.enable();
    bench.command([100, -200, i32::MIN], 3000);
    bench.inputs.encoders[2] = i32::MIN;
    assert_eq!(bench.step(100).torque_unm, [100, -200, 0]);
}

#[test]
fn torque_is_clamped_and_says_so() {
    let mut bench = Bench::enabled();
    let flags = |answer| match answer {
        Some(DeviceMessage::State { flags, .. }) => flags & message::CLAMPED,
        other => panic!("{other:?}"),
    };
    assert_eq!(flags(bench.command([500_000, -400_000, 250_000], 3000)), 0);
    assert_eq!(bench.step(0).torque_unm, [500_000, -400_000, 250_000]);
    assert_eq!(flags(bench.command([0, -800_000, 250_000], 3000)), message::CLAMPED);
    assert_eq!(bench.step(0).torque_unm, [0, -400_000, 125_000]);
    assert_eq!(flags(bench.command([i32::MIN; 3], 3000)), message::CLAMPED);
    assert_eq!(bench.step(0).torque_unm, [-250_000; 3]);
    assert_eq!(clamp_torque([i32::MIN, 0, i32::MAX], [u32::MAX; 3]), ([-i32::MAX, 0, i32::MAX], true));
}

/// Both codecs and the device, as they will stand at the two ends of a wire.
#[test]
fn a_session_over_frames() {
    let mut bench = Bench::new();
    let mut at_device = FrameReader::<HostMessage>::new();
    let mut at_host = FrameReader::<DeviceMessage>::new();
    let mut exchange = |bench: &mut Bench, message: HostMessage| {
        let (mut out, mut back) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        let frame = encode(&message, &mut out).expect("it fits");
        let heard = at_device.read(&mut &*frame).expect("a frame").expect("a message");
        let answer = bench.device.receive(bench.now_us, &heard).expect("an answer");
        let frame = encode(&answer, &mut back).expect("it fits");
        at_host.read(&mut &*frame).expect("a frame").expect("a message")
    };
    match exchange(&mut bench, HostMessage::Hello { version: VERSION, nonce: 5 }) {
        DeviceMessage::HelloAck { session, .. } => bench.session = session,
        other => panic!("{other:?}"),
    }
    let (session, seq) = bench.next();
    exchange(&mut bench, HostMessage::Enable { session, seq });
    for tick in 0..1000_i32 {
        bench.now_us += 1000;
        let torque_unm = [tick, -tick, 0];
        let command = bench.command_of(torque_unm, 3000);
        let answer = exchange(&mut bench, command);
        assert!(bench.answer_is(Some(answer), true));
        assert_eq!(bench.step(100).torque_unm, torque_unm);
    }
}

/// What a host, a wire and a mechanism can do to a device.
#[derive(Debug, Clone)]
enum Act {
    Hello(u16),
    Send {
        kind: u8,
        session_ahead: u32,
        seq_ahead: i32,
        late_us: u32,
        torque_unm: [i32; 3],
        valid_for_us: u16,
    },
    Step {
        after_us: i64,
        homed: bool,
        fault: bool,
        moved: i32,
    },
}

fn any_act() -> impl Strategy<Value = Act> {
    let send = (0..4_u8, 0..20_u32, -2..40_i32, 0..6000_u32, any::<[i32; 3]>(), 0..9000_u16).prop_map(
        |(kind, other, ahead, late_us, torque_unm, valid_for_us)| Act::Send {
            kind,
            session_ahead: u32::from(other == 0),
            seq_ahead: if ahead <= 0 { ahead } else { 1 },
            late_us: late_us.saturating_sub(4000),
            torque_unm,
            valid_for_us,
        },
    );
    let step = (0..300_i64, prop::bool::weighted(0.97), prop::bool::weighted(0.01), -25..25_i32).prop_map(
        |(after_us, homed, fault, moved)| Act::Step {
            after_us: if after_us == 0 { -1 } else { after_us * 10 },
            homed,
            fault,
            moved: if moved.abs() > 22 { moved } else { moved / 8 },
        },
    );
    let hello = (0..20_u16).prop_map(|version| Act::Hello(if version == 0 { 2 } else { VERSION }));
    prop_oneof![1 => hello, 8 => send, 10 => step]
}

/// Plays acts on a device and checks after each what must always hold. Returns how often a torque acted and a fault latched.
fn play(acts: &[Act]) -> (u32, u32) {
    let mut bench = Bench::new();
    let (mut torques, mut faults) = (0, 0);
    // What a person has allowed: enabling, in a session without a fault.
    let mut allowed = false;
    for act in acts {
        let before = bench.device.phase();
        let mut new_session = false;
        match *act {
            Act::Hello(version) => {
                let answer = bench.receive(HostMessage::Hello { version, nonce: 7 });
                if let Some(DeviceMessage::HelloAck { session, .. }) = answer {
                    bench.session = session;
                    bench.seq = 0;
                }
                allowed = false;
                new_session = version == VERSION;
            }
            Act::Send { kind, session_ahead, seq_ahead, late_us, torque_unm, valid_for_us } => {
                let session = bench.session.wrapping_add(session_ahead);
                let seq = bench.seq.wrapping_add_signed(seq_ahead);
                if session_ahead == 0 && seq_ahead > 0 {
                    bench.seq = seq;
                }
                let message = match kind {
                    0 => HostMessage::Enable { session, seq },
                    1 if seq % 4 == 0 => HostMessage::Disable { session, seq },
                    1 if seq % 4 == 1 => HostMessage::Home { session, seq },
                    _ => {
                        let t_host_us = (bench.now_us as u32).wrapping_sub(late_us);
                        HostMessage::Command { session, seq, t_host_us, torque_unm, valid_for_us }
                    }
                };
                let answer = bench.receive(message);
                if matches!(message, HostMessage::Enable { .. }) && bench.answer_is(answer, true) {
                    allowed = true;
                }
                assert!(session_ahead == 0 || answer.is_none(), "another session is not answered");
                assert!(bench.device.phase() != Phase::Enabled || allowed);
            }
            Act::Step { after_us, homed, fault, moved } => {
                bench.now_us = bench.now_us.wrapping_add_signed(after_us);
                bench.inputs.homed = homed;
                bench.inputs.fault = fault;
                bench.inputs.encoders[0] = bench.inputs.encoders[0].wrapping_add(moved);
                let Outputs { torque_unm, home } = bench.step(0);
                assert_eq!(home, bench.device.phase() == Phase::Homing);
                assert!(
                    torque_unm.iter().zip(LIMIT_UNM).all(|(torque, limit)| torque.unsigned_abs() <= limit)
                );
                if torque_unm != [0; 3] {
                    torques += 1;
                    assert!(bench.device.phase() == Phase::Enabled && allowed && homed && !fault);
                }
            }
        }
        let after = bench.device.phase();
        if let Phase::Faulted(_) = after {
            allowed = false;
        }
        if let Phase::Faulted(_) = before {
            assert!(after == before || new_session, "a fault is cleared by a handshake only");
        } else if let Phase::Faulted(_) = after {
            faults += 1;
        }
    }
    (torques, faults)
}

proptest! {
    #[test]
    fn nothing_resumes_without_a_handshake(acts in prop::collection::vec(any_act(), 1..300)) {
        play(&acts);
    }

    #[test]
    fn clamping_keeps_the_direction(torque in any::<[i32; 3]>(), limit in prop::array::uniform3(1..=i32::MAX as u32)) {
        let (clamped, shortened) = clamp_torque(torque, limit);
        prop_assert!(clamped.iter().zip(limit).all(|(torque, limit)| torque.unsigned_abs() <= limit));
        let within = torque.iter().zip(limit).all(|(torque, limit)| torque.unsigned_abs() <= limit);
        prop_assert_eq!(shortened, !within);
        if within {
            prop_assert_eq!(clamped, torque);
        } else {
            prop_assert!(clamped.iter().zip(limit).any(|(torque, limit)| torque.unsigned_abs() == limit));
        }
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            // Each component is rounded by less than one.
            let across = |a: usize, b: usize| i128::from(clamped[a]) * i128::from(torque[b]);
            let room = i128::from(torque[i].unsigned_abs().max(torque[j].unsigned_abs()));
            prop_assert!((across(i, j) - across(j, i)).abs() <= room, "{:?} {:?}", torque, clamped);
            prop_assert!(i64::from(clamped[i]) * i64::from(torque[i]) >= 0);
        }
    }
}

/// The random acts above are worth something only if they enable, move and fault.
#[test]
fn the_random_acts_meet_torques_and_faults() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let acts = prop::collection::vec(any_act(), 20_000).new_tree(&mut runner).expect("acts").current();
    let (torques, faults) = play(&acts);
    assert!(torques > 500 && faults > 200, "{torques} torques, {faults} faults");
}
