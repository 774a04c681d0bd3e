//! Frames of the device link: golden bytes, and a reader that returns only messages that were sent.

use palpate_link::{
    DeviceFault, DeviceInfo, DeviceMessage, FrameError, FrameReader, HostMessage, InfoError, MAX_FRAME,
    Message, VERSION, encode, message,
};
use proptest::prelude::*;
use serde::Serialize;

const SESSION: u32 = 0x2a1b_3c4d;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn frame(message: &impl Serialize) -> Vec<u8> {
    encode(message, &mut [0; MAX_FRAME]).expect("it fits").to_vec()
}

/// A frame round any bytes, with a correct checksum.
fn signed(message: &[u8]) -> Vec<u8> {
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(message).to_le_bytes();
    stuffed(&[message, &checksum].concat())
}

/// COBS as defined in its paper, independent of the crate that is used.
fn stuffed(body: &[u8]) -> Vec<u8> {
    assert!(body.len() < 254);
    let mut out = Vec::new();
    for block in body.split(|&byte| byte == 0) {
        out.push(block.len() as u8 + 1);
        out.extend(block);
    }
    out.push(0);
    out
}

type Outcome<T> = Result<T, FrameError>;

fn read_all<T: Message>(mut bytes: &[u8]) -> Vec<Outcome<T>> {
    let mut reader = FrameReader::new();
    let mut found = Vec::new();
    while let Some(outcome) = reader.read(&mut bytes) {
        found.push(outcome);
    }
    assert!(bytes.is_empty());
    found
}

fn info() -> DeviceInfo {
    DeviceInfo {
        dof: 3,
        counts_per_turn: [4096, 4096, 1280],
        torque_limit_unm: [500_000, 500_000, 250_000],
        watchdog_us: 10_000,
        serial: 17,
        firmware: 0x0102,
    }
}

fn host_messages() -> [HostMessage; 5] {
    [
        HostMessage::Hello { version: VERSION, nonce: 0x0102_0304 },
        HostMessage::Enable { session: SESSION, seq: 2 },
        HostMessage::Disable { session: SESSION, seq: 300 },
        HostMessage::Home { session: SESSION, seq: 1 },
        HostMessage::Command {
            session: SESSION,
            seq: 3,
            t_host_us: 1_000_000,
            torque_unm: [250_000, -125_000, 0],
            valid_for_us: 5000,
        },
    ]
}

fn device_messages() -> [DeviceMessage; 3] {
    [
        DeviceMessage::HelloAck { version: VERSION, nonce: 0x0102_0304, session: SESSION, info: info() },
        DeviceMessage::State {
            seq_echo: 3,
            t_dev_us: 2_000_500,
            encoders: [-516, 872, i32::MAX],
            buttons: 5,
            flags: message::HOMED | message::ENABLED,
        },
        DeviceMessage::Fault { code: DeviceFault::Watchdog },
    ]
}

/// From an independent encoder in Python: COBS, CRC-32 (zlib) and the layout.
#[test]
fn golden_frames() {
    let host = [
        "0102010904030201c177259e00",
        "07014d3c1b2a020101058115406400",
        "08024d3c1b2a2c0101057e9be21c00",
        "07034d3c1b2a01010105e992035800",
        "07044d3c1b2a0301010440420f0490d00305b817feff010101078813b32215e700",
    ];
    let device = [
        "0102010a040302014d3c1b2a0302100101021001010205010420a1070420a1070490d0030410271101010302010105fff4959d00",
        "03010301010474861e07fcfdffff6803010bffffff7f0505b4bfa7a200",
        "0202057d70ef7300",
    ];
    for (message, golden) in host_messages().iter().zip(host) {
        assert_eq!(hex(&frame(message)), golden, "{message:?}");
        assert_eq!(read_all(&frame(message)), [Ok(*message)]);
    }
    for (message, golden) in device_messages().iter().zip(device) {
        assert_eq!(hex(&frame(message)), golden, "{message:?}");
        assert_eq!(read_all(&frame(message)), [Ok(*message)]);
    }
    let faults: Vec<_> = DeviceFault::ALL.iter().map(|&code| frame(&DeviceMessage::Fault { code })).collect();
    let codes: Vec<_> = (0..5).map(|code| signed(&[2, code])).collect();
    assert_eq!(faults, codes);
}

#[test]
fn every_kind_has_one_length() {
    let longest = HostMessage::Command {
        session: u32::MAX,
        seq: u32::MAX,
        t_host_us: u32::MAX,
        torque_unm: [i32::MIN; 3],
        valid_for_us: u16::MAX,
    };
    for message in host_messages().into_iter().chain([longest]) {
        assert_eq!(frame(&message).len(), message.encoded_len() + 6, "{message:?}");
    }
    let all = DeviceInfo {
        dof: 255,
        counts_per_turn: [u32::MAX; 3],
        torque_limit_unm: [u32::MAX; 3],
        watchdog_us: u16::MAX,
        serial: u32::MAX,
        firmware: u32::MAX,
    };
    let ack = DeviceMessage::HelloAck { version: u16::MAX, nonce: u32::MAX, session: u32::MAX, info: all };
    for message in device_messages().into_iter().chain([ack]) {
        assert_eq!(frame(&message).len(), message.encoded_len() + 6, "{message:?}");
    }
    assert_eq!(ack.encoded_len(), message::MAX_MESSAGE);
    assert_eq!((frame(&ack).len(), MAX_FRAME), (52, 52));
}

#[test]
fn a_message_that_is_too_long_is_not_encoded() {
    assert!(encode(&([1_u8; 32], [1_u8; 14]), &mut [0; MAX_FRAME]).is_ok());
    assert!(encode(&([1_u8; 32], [1_u8; 15]), &mut [0; MAX_FRAME]).is_err());
    assert!(encode(&[[1_u8; 30]; 3], &mut [0; MAX_FRAME]).is_err());
}

#[test]
fn every_truncation_is_refused_and_the_next_frame_read() {
    for message in host_messages() {
        let good = frame(&message);
        for cut in 1..good.len() - 1 {
            let found = read_all::<HostMessage>(&[&good[..cut], &[0], &good[..]].concat());
            assert!(matches!(found[..], [Err(_), Ok(read)] if read == message), "{cut}: {found:?}");
            // Without the 00 the truncated frame destroys one following frame, never two.
            let found = read_all::<HostMessage>(&[&good[..cut], &good[..], &good[..]].concat());
            assert!(matches!(found[..], [Err(_), Ok(read)] if read == message), "{cut}: {found:?}");
            // The beginning is missing.
            let found = read_all::<HostMessage>(&[&good[cut..], &good[..]].concat());
            assert!(matches!(found[..], [Err(_), Ok(read)] if read == message), "{cut}: {found:?}");
        }
    }
}

#[test]
fn every_corrupted_byte_is_refused_and_the_next_frame_read() {
    fn check<T: Message + PartialEq + core::fmt::Debug>(message: &T) {
        let good = frame(message);
        for index in 0..good.len() {
            for value in (0..=255).filter(|&value| value != good[index]) {
                let mut bad = good.clone();
                bad[index] = value;
                let found = read_all::<T>(&[&bad[..], &[0], &good[..]].concat());
                let (last, before) = found.split_last().expect("the good frame");
                assert_eq!(last.as_ref(), Ok(message), "byte {index}, value {value}");
                assert!(before.iter().all(Result::is_err), "byte {index}, value {value}: {before:?}");
            }
        }
    }
    host_messages().iter().for_each(check);
    device_messages().iter().for_each(check);
}

/// Each reason, from a frame with no other error.
#[test]
fn every_reason_is_named() {
    let ok = [3, 1, 2, 3, 4, 5, 6, 7, 8];
    let fault = |bytes: &[u8]| {
        let found = read_all::<HostMessage>(&[bytes, &frame(&host_messages()[4])].concat());
        assert!(matches!(found[..], [Err(_), Ok(_)]), "{found:?}");
        *found[0].as_ref().expect_err("bad")
    };
    assert!(read_all::<HostMessage>(&signed(&ok))[0].is_ok());
    let unsigned = stuffed(&[&ok[..], &[9; 4]].concat());
    let nothing = signed(&[]);
    let trailing = signed(&[&ok[..], &[0]].concat());
    assert_eq!(fault(&[&[9; 60][..], &[0]].concat()), FrameError::TooLong);
    assert_eq!(fault(&signed(&[9; 47])), FrameError::TooLong);
    assert_eq!(fault(&[9, 1, 1, 0]), FrameError::Cobs);
    assert_eq!(fault(&[5, 1, 1, 1, 1, 0]), FrameError::TooShort);
    assert_eq!(fault(&[1, 0]), FrameError::TooShort);
    assert_eq!(fault(&nothing), FrameError::TooShort);
    assert_eq!(fault(&unsigned), FrameError::Checksum);
    assert_eq!(fault(&signed(&[5])), FrameError::Message, "an unknown kind");
    assert_eq!(fault(&signed(&ok[..8])), FrameError::Message, "ends early");
    assert_eq!(fault(&trailing), FrameError::Trailing);
    assert_eq!(read_all::<DeviceMessage>(&signed(&[2, 5])), [Err(FrameError::Message)], "an unknown fault");
    let longer = [&[0x83, 0][..], &ok[1..]].concat();
    assert_eq!(fault(&signed(&longer)), FrameError::Message, "a longer tag");
    assert_eq!(
        read_all::<DeviceMessage>(&signed(&[2, 0x80, 0])),
        [Err(FrameError::Message)],
        "a longer fault"
    );
}

#[test]
fn empty_frames_mean_nothing() {
    let good = frame(&host_messages()[0]);
    let found = read_all::<HostMessage>(&[&[0, 0, 0][..], &good, &[0, 0], &good, &[0]].concat());
    assert_eq!(found, [Ok(host_messages()[0]); 2]);
}

#[test]
fn the_memory_of_a_reader_is_bounded() {
    let mut reader = FrameReader::<HostMessage>::new();
    assert!((0..1_000_000).all(|_| reader.push(0xff).is_none()));
    assert_eq!(reader.push(0), Some(Err(FrameError::TooLong)));
    let good = frame(&host_messages()[4]);
    assert_eq!(reader.read(&mut &good[..]), Some(Ok(host_messages()[4])));
    assert!(size_of_val(&reader) <= 128, "{}", size_of_val(&reader));
}

/// xorshift64.
struct Noise(u64);

impl Noise {
    fn byte(&mut self) -> u8 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 32) as u8
    }
}

#[test]
fn noise_is_not_decoded_as_a_message() {
    let mut noise = Noise(0x1234_5678_9abc_def1);
    let bytes: Vec<u8> = (0..1_000_000).map(|_| noise.byte()).collect();
    let found = read_all::<HostMessage>(&bytes);
    let count = |reason| found.iter().filter(|outcome| **outcome == Err(reason)).count();
    assert!(found.iter().all(Result::is_err));
    assert!(count(FrameError::TooLong) > 1000 && count(FrameError::Cobs) > 100, "{found:?}");
    assert!(read_all::<DeviceMessage>(&bytes).iter().all(Result::is_err));
    // Correct COBS, so that all of it reaches the checksum.
    let mut reader = FrameReader::<HostMessage>::new();
    for _ in 0..100_000 {
        let mut body = vec![4];
        body.extend((0..30).map(|_| noise.byte()));
        assert_eq!(reader.read(&mut &stuffed(&body)[..]), Some(Err(FrameError::Checksum)));
    }
}

fn any_host() -> impl Strategy<Value = HostMessage> {
    let torque = any::<[i32; 3]>();
    (0..5, any::<(u32, u32, u32, u16)>(), torque).prop_map(
        |(kind, (session, seq, t_host_us, short), torque_unm)| match kind {
            0 => HostMessage::Hello { version: short, nonce: session },
            1 => HostMessage::Enable { session, seq },
            2 => HostMessage::Disable { session, seq },
            3 => HostMessage::Home { session, seq },
            _ => HostMessage::Command { session, seq, t_host_us, torque_unm, valid_for_us: short },
        },
    )
}

fn any_device() -> impl Strategy<Value = DeviceMessage> {
    let numbers = any::<(u32, u32, u32, u16, u8, u8)>();
    (0..7_usize, numbers, any::<[u32; 3]>(), any::<[i32; 3]>()).prop_map(
        |(kind, (nonce, session, serial, version, dof, flags), counts_per_turn, encoders)| match kind {
            0 => {
                let torque_limit_unm = encoders.map(i32::unsigned_abs);
                let watchdog_us = version.rotate_left(3);
                let firmware = !nonce;
                let info =
                    DeviceInfo { dof, counts_per_turn, torque_limit_unm, watchdog_us, serial, firmware };
                DeviceMessage::HelloAck { version, nonce, session, info }
            }
            1 => DeviceMessage::State { seq_echo: nonce, t_dev_us: serial, encoders, buttons: dof, flags },
            kind => DeviceMessage::Fault { code: DeviceFault::ALL[kind - 2] },
        },
    )
}

/// Reads a stream in pieces of some length.
fn read_in_pieces<T: Message>(stream: &[u8], piece: usize) -> Vec<Outcome<T>> {
    let mut reader = FrameReader::new();
    let mut found = Vec::new();
    for mut bytes in stream.chunks(piece) {
        while let Some(outcome) = reader.read(&mut bytes) {
            found.push(outcome);
        }
    }
    found
}

proptest! {
    #[test]
    fn sent_messages_are_read_in_order(
        host in prop::collection::vec(any_host(), 1..8),
        device in prop::collection::vec(any_device(), 1..8),
        piece in 1..70_usize,
    ) {
        let stream: Vec<u8> = host.iter().flat_map(frame).collect();
        prop_assert_eq!(read_in_pieces(&stream, piece), host.into_iter().map(Ok).collect::<Vec<_>>());
        let stream: Vec<u8> = device.iter().flat_map(frame).collect();
        prop_assert_eq!(read_in_pieces(&stream, piece), device.into_iter().map(Ok).collect::<Vec<_>>());
    }

    /// A looped-back cable: no end accepts its own messages as those of the other end.
    #[test]
    fn a_looped_back_message_is_refused(host in any_host(), device in any_device()) {
        prop_assert!(read_all::<DeviceMessage>(&frame(&host))[0].is_err());
        prop_assert!(read_all::<HostMessage>(&frame(&device))[0].is_err());
    }

    /// With a correct checksum any bytes are refused, or are the one encoding of a message.
    #[test]
    fn bytes_with_a_checksum_are_one_message_or_none(kind in 0..6_u8, mut bytes in prop::collection::vec(any::<u8>(), 0..46)) {
        bytes.insert(0, kind);
        let sent = signed(&bytes);
        if let [Ok(message)] = read_all::<HostMessage>(&sent)[..] {
            prop_assert_eq!(frame(&message), sent.clone());
        }
        if let [Ok(message)] = read_all::<DeviceMessage>(&sent)[..] {
            prop_assert_eq!(frame(&message), sent);
        }
    }
}

#[test]
fn invalid_device_properties_are_refused() {
    let changed = |change: fn(&mut DeviceInfo)| {
        let mut info = info();
        change(&mut info);
        info.check()
    };
    assert_eq!(info().check(), Ok(()));
    assert_eq!(changed(|i| i.dof = 0), Err(InfoError::Dof { dof: 0 }));
    assert_eq!(changed(|i| i.dof = 4), Err(InfoError::Dof { dof: 4 }));
    assert_eq!(changed(|i| i.watchdog_us = 4_999), Err(InfoError::Watchdog { watchdog_us: 4_999 }));
    assert_eq!(changed(|i| i.watchdog_us = 5_000), Ok(()));
    assert_eq!(changed(|i| i.watchdog_us = 20_000), Ok(()));
    assert_eq!(changed(|i| i.watchdog_us = 20_001), Err(InfoError::Watchdog { watchdog_us: 20_001 }));
    assert_eq!(changed(|i| i.counts_per_turn[1] = 0), Err(InfoError::Counts { axis: 1 }));
    let limit = |limit_unm| Err(InfoError::TorqueLimit { axis: 2, limit_unm });
    assert_eq!(changed(|i| i.torque_limit_unm[2] = 0), limit(0));
    assert_eq!(changed(|i| i.torque_limit_unm[2] = 1 << 31), limit(1 << 31));
    assert_eq!(changed(|i| (i.dof, i.torque_limit_unm[2], i.counts_per_turn[2]) = (2, 0, 0)), Ok(()));
}
