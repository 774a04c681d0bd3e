//! Sessions: none repeats, none outlives another; and one complete session over frames.

use palpate_link::{
    Device, DeviceMessage, DeviceProfile, FrameReader, HostMessage, MAX_FRAME, VERSION, encode,
};

use super::bench::{Bench, TORQUE_UNM, profile};

#[test]
fn consecutive_sessions_differ() {
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

/// The nonces for which the hash equals the previous session, or zero.
#[test]
fn no_nonce_gives_the_previous_session_or_zero() {
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
fn a_hello_of_another_version_ends_the_session() {
    let mut bench = Bench::enabled();
    bench.command(TORQUE_UNM, 3000);
    let answer = bench.receive(HostMessage::Hello { version: 0, nonce: 4 });
    let info = profile().info;
    assert_eq!(answer, Some(DeviceMessage::HelloAck { version: VERSION, nonce: 4, session: 0, info }));
    assert_eq!(bench.step(0).torque_unm, [0; 3]);
    assert_eq!(bench.enable(), None);
}

/// Both codecs and the device, as at the two ends of a wire.
#[test]
fn a_session_over_frames() {
    let mut bench = Bench::new();
    let mut at_device = FrameReader::<HostMessage>::new();
    let mut at_host = FrameReader::<DeviceMessage>::new();
    let mut exchange = |bench: &mut Bench, message: HostMessage| {
        let (mut out, mut back) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        let frame = encode(&message, &mut out).expect("it fits");
        let received = at_device.read(&mut &*frame).expect("a frame").expect("a message");
        let answer = bench.device.receive(bench.now_us, &received).expect("an answer");
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
