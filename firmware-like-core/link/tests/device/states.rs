//! Every state and every event; homing and faults.

use palpate_link::{DeviceFault, DeviceMessage, HostMessage, Inputs, Outputs, Phase, VERSION, message};

use super::bench::{Bench, TORQUE_UNM, WATCHDOG_US};

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
fn homing_ends_after_a_new_reading() {
    // When Home arrives, the hardware still reports homed from an earlier procedure.
    let mut bench = Bench::enabled();
    bench.command(TORQUE_UNM, 3000);
    assert_eq!(bench.step(100).torque_unm, TORQUE_UNM);
    let (session, seq) = bench.next();
    let answer = bench.receive(HostMessage::Home { session, seq });
    assert!(bench.answer_is(answer, true));
    assert_eq!(
        bench.step(100),
        Outputs { torque_unm: [0; 3], home: true },
        "this reading may precede the request"
    );
    bench.inputs.homed = false;
    assert_eq!(bench.step(100), Outputs { torque_unm: [0; 3], home: true });
    let answer = bench.enable();
    assert!(bench.answer_is(answer, false), "not homed");
    bench.inputs.homed = true;
    // The counts start from zero: no fault, and the device stays disabled.
    bench.inputs.encoders = [0; 3];
    assert_eq!(bench.step(100), Outputs::default());
    assert_eq!(bench.device.phase(), Phase::Linked);
    let answer = bench.enable();
    assert!(bench.answer_is(answer, true));
    bench.step(100);
    assert_eq!(bench.device.phase(), Phase::Enabled);
    // A second homing in the same session.
    let (session, seq) = bench.next();
    bench.receive(HostMessage::Home { session, seq });
    assert!(bench.step(100).home && !bench.step(100).home);
}

#[test]
fn a_lasting_hardware_fault_cannot_be_cleared() {
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
fn the_first_fault_is_latched() {
    let mut bench = Bench::enabled();
    bench.step(WATCHDOG_US);
    bench.inputs = Inputs { fault: true, homed: false, encoders: [9999; 3], buttons: 0 };
    bench.step(1);
    bench.now_us -= 100;
    bench.step(0);
    assert_eq!(bench.device.phase(), Phase::Faulted(DeviceFault::Watchdog));
}
