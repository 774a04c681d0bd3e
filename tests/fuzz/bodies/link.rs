//! The body of the fuzz target of the device link, also run by `palpate-link`'s tests: arbitrary bytes
//! and the invariants that must hold for them.

use palpate_link::message::{ENABLED, REFUSED};
use palpate_link::{
    Device, DeviceInfo, DeviceMessage, DeviceProfile, FrameReader, HostMessage, Inputs, MAX_FRAME, Message,
    Phase, encode,
};

/// Arbitrary bytes as input of a device and of the reader of a host. The device gives a torque only while
/// enabled and within the limits; a fault is latched until a handshake; every message is unchanged by a round
/// trip. Returns whether there was a torque.
///
/// If the first byte is odd, the rest are messages, each after its length. They get a checksum and a frame,
/// which a fuzzer would not guess, and session 1 stands for the current one.
pub(crate) fn link(data: &[u8]) -> bool {
    let Some((kind, mut rest)) = data.split_first() else { return false };
    let mut line = Line::new();
    if kind & 1 == 0 {
        rest.iter().for_each(|byte| line.push(*byte));
        return line.torque;
    }
    while let Some((len, after)) = rest.split_first() {
        let (message, next) = after.split_at(usize::from(len % 64).min(after.len()));
        rest = next;
        send_framed(message, &mut line);
        // A length of 63 with no bytes left stands for a hardware fault, which ends with the next message.
        // The upper bits of the length encode a time.
        line.inputs.fault = len % 64 == 63 && after.is_empty();
        line.wait(u64::from(len >> 6) * 3000);
    }
    line.torque
}

/// The checksum of the protocol, independent of the implementation under test.
static CHECKSUM: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// Sends COBS of a message and its checksum, independent of the implementation under test.
fn send_framed(message: &[u8], line: &mut Line) {
    let mut body = [0; 64 + 4];
    let body = &mut body[..message.len() + 4];
    body[..message.len()].copy_from_slice(message);
    body[message.len()..].copy_from_slice(&CHECKSUM.checksum(message).to_le_bytes());
    for piece in body.split(|byte| *byte == 0) {
        line.push(piece.len() as u8 + 1);
        piece.iter().for_each(|byte| line.push(*byte));
    }
    line.push(0);
}

/// A device and the readers at both ends.
struct Line {
    device: Device,
    to_device: FrameReader<HostMessage>,
    to_host: FrameReader<DeviceMessage>,
    inputs: Inputs,
    now_us: u64,
    session: u32,
    /// There was a torque.
    torque: bool,
    /// Last reset of the watchdog.
    fed_us: u64,
}

const DEVICE: DeviceProfile = DeviceProfile {
    info: DeviceInfo {
        dof: 3,
        counts_per_turn: [4096; 3],
        torque_limit_unm: [100_000, 200_000, 300_000],
        watchdog_us: 10_000,
        serial: 1,
        firmware: 1,
    },
    max_speed_counts_per_s: 100_000,
    boot: 1,
};

impl Line {
    fn new() -> Self {
        Self {
            device: Device::new(DEVICE).expect("a sound profile"),
            to_device: FrameReader::new(),
            to_host: FrameReader::new(),
            inputs: Inputs::default(),
            now_us: 0,
            session: 0,
            torque: false,
            fed_us: 0,
        }
    }

    fn push(&mut self, byte: u8) {
        // The bytes also advance the clock and the encoders.
        self.now_us += u64::from(byte & 0x0f);
        self.inputs.encoders = self.inputs.encoders.map(|count| count.wrapping_add(i32::from(byte >> 7)));
        if let Some(Ok(message)) = self.to_host.push(byte) {
            assert_round_trip(&message);
        }
        if let Some(Ok(message)) = self.to_device.push(byte) {
            assert_round_trip(&message);
            self.receive(self.in_session(message));
        }
        self.step();
    }

    fn wait(&mut self, us: u64) {
        self.now_us += us;
        self.step();
    }

    fn in_session(&self, mut message: HostMessage) -> HostMessage {
        use HostMessage::{Command, Disable, Enable, Hello, Home};
        match &mut message {
            Hello { .. } => {}
            Enable { session, .. }
            | Disable { session, .. }
            | Home { session, .. }
            | Command { session, .. } => {
                if *session == 1 {
                    *session = self.session;
                }
            }
        }
        message
    }

    fn receive(&mut self, message: HostMessage) {
        let before = self.device.phase();
        let answer = self.device.receive(self.now_us, &message);
        if matches!(before, Phase::Faulted(_)) && !matches!(message, HostMessage::Hello { .. }) {
            assert_eq!(self.device.phase(), before, "a fault is latched");
        }
        if before != Phase::Enabled && self.device.phase() == Phase::Enabled {
            assert!(matches!(message, HostMessage::Enable { .. }), "enabled by {message:?}");
        }
        match answer {
            Some(DeviceMessage::HelloAck { session, .. }) => self.session = session,
            Some(DeviceMessage::State { flags, .. }) if flags & (ENABLED | REFUSED) == ENABLED => {
                self.fed_us = self.now_us;
            }
            _ => {}
        }
        if let Some(answer) = answer {
            assert_round_trip(&answer);
        }
    }

    fn step(&mut self) {
        let outputs = self.device.step(self.now_us, &self.inputs);
        // Homing ends at once.
        self.inputs.homed |= outputs.home;
        for (torque, limit) in outputs.torque_unm.iter().zip(DEVICE.info.torque_limit_unm) {
            assert!(torque.unsigned_abs() <= limit, "{outputs:?}");
        }
        if self.device.phase() == Phase::Enabled {
            let silent_us = self.now_us - self.fed_us;
            assert!(
                silent_us < u64::from(DEVICE.info.watchdog_us),
                "enabled after {silent_us} us of silence"
            );
        }
        let is_faulted = matches!(self.device.phase(), Phase::Faulted(_));
        assert!(!self.inputs.fault || is_faulted, "a hardware fault without a device fault");
        let torque = outputs.torque_unm != [0; 3];
        assert!(!torque || self.device.phase() == Phase::Enabled, "{outputs:?}");
        self.torque |= torque;
    }
}

fn assert_round_trip<T: Message + PartialEq + std::fmt::Debug>(message: &T) {
    let mut frame = [0; MAX_FRAME];
    let mut bytes = encode(message, &mut frame).expect("it fits");
    let back = FrameReader::<T>::new().read(&mut bytes).expect("a whole frame").expect("a good one");
    assert_eq!(&back, message);
}
