//! The fuzz target of the device link on the inputs of the corpus, on its seeds, and on mutations of both.

use std::path::{Path, PathBuf};

use palpate_link::{DeviceFault, DeviceMessage, HostMessage, MAX_FRAME, VERSION, encode};

#[path = "../../../tests/fuzz/bodies/link.rs"]
mod bodies;
#[path = "../../../tests/fuzz/replay.rs"]
mod replay;

use replay::{kept, replay, write_seeds};

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/link")
}

#[test]
fn frames_are_refused_or_executed_safely() {
    replay(&conversations(), 2000, |line| _ = bodies::link(line));
    replay(&kept(&corpus()), 50, |line| _ = bodies::link(line));
}

/// Seeds: conversations of a driver with a device.
fn conversations() -> Vec<Vec<u8>> {
    let session = 0x1234_5678;
    let torque_unm = [1, -2, i32::MAX];
    let command =
        |seq| HostMessage::Command { session, seq, t_host_us: 1000 * seq, torque_unm, valid_for_us: 5000 };
    let hello = HostMessage::Hello { version: VERSION, nonce: 7 };
    let (enable, home) = (HostMessage::Enable { session, seq: 2 }, HostMessage::Home { session, seq: 1 });
    let said = [hello, home, enable, command(3), command(4), HostMessage::Disable { session, seq: 5 }];
    let state =
        |seq_echo| DeviceMessage::State { seq_echo, t_dev_us: 1, encoders: [1, -1, 0], buttons: 1, flags: 7 };
    let answered = [state(0), state(u32::MAX), DeviceMessage::Fault { code: DeviceFault::Watchdog }];
    let mut to_device = Vec::new();
    for message in &said {
        to_device.extend(encode(message, &mut [0; MAX_FRAME]).expect("fits"));
    }
    let mut to_host = Vec::new();
    for message in &answered {
        to_host.extend(encode(message, &mut [0; MAX_FRAME]).expect("fits"));
    }
    let cut = to_device.iter().copied().skip(5).chain(to_host.iter().copied().take(40)).collect();
    // As messages after their lengths, in the current session, for which session 1 stands.
    let mut framed = vec![1];
    let here =
        |seq| HostMessage::Command { session: 1, seq, t_host_us: 1000 * seq, torque_unm, valid_for_us: 5000 };
    let (home, enable) =
        (HostMessage::Home { session: 1, seq: 1 }, HostMessage::Enable { session: 1, seq: 3 });
    for message in [hello, home, here(2), enable, here(4), here(4), here(5), hello, here(1)] {
        let bytes = postcard::to_allocvec(&message).expect("encoded");
        framed.push(bytes.len() as u8);
        framed.extend(bytes);
    }
    // The last commands last 9 ms each, so that the watchdog fires. The messages after them must not enable
    // the device.
    let with_len = |line: &mut Vec<u8>, messages: &[HostMessage], time: u8| {
        for message in messages {
            let bytes = postcard::to_allocvec(message).expect("encoded");
            line.push(bytes.len() as u8 | time);
            line.extend(bytes);
        }
    };
    let enable = HostMessage::Enable { session: 1, seq: 2 };
    let (again, home) =
        (HostMessage::Enable { session: 1, seq: 10 }, HostMessage::Home { session: 1, seq: 11 });
    let disable = HostMessage::Disable { session: 1, seq: 12 };
    let (mut late, mut broken) = (framed.clone(), framed.clone());
    with_len(&mut late, &[enable, here(4)], 0xc0);
    late.extend([0xc0, 0xc0]);
    with_len(&mut late, &[again, home, disable, here(13), here(14)], 0);
    // A hardware fault while enabled.
    with_len(&mut broken, &[enable, here(4)], 0);
    broken.push(63);
    [to_device, to_host, cut]
        .into_iter()
        .map(|line| [vec![0], line].concat())
        .chain([framed, late, broken])
        .collect()
}

/// At least one conversation reaches a torque, otherwise the replay would prove nothing.
#[test]
fn the_seeds_of_frames_reach_a_torque() {
    assert!(conversations().iter().any(|line| bodies::link(line)), "no seed enables the device");
}

#[test]
#[ignore = "writes the seeds of tests/fuzz: run by hand after a change of the protocol"]
fn write_the_first_inputs() {
    write_seeds(&corpus(), &conversations());
}
