use super::packet::CAPABILITIES;
use super::*;
use crate::falcon::{EmulatedFalcon, FalconConfig};

/// A device with scripted data.
struct FakeDevice {
    falcon: EmulatedFalcon,
    room: usize,
    taken: Vec<u8>,
    ready: VecDeque<Result<Vec<u8>, Stall>>,
}

impl UsbDevice for FakeDevice {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        self.falcon.control(setup, data)
    }

    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall> {
        let count = bytes.len().min(self.room);
        self.room -= count;
        self.taken.extend(&bytes[..count]);
        Ok(count)
    }

    fn bulk_in(&mut self, max: usize) -> Result<Option<Vec<u8>>, Stall> {
        assert!(max >= PACKET_LEN && max.is_multiple_of(PACKET_LEN));
        self.ready.pop_front().transpose()
    }
}

/// A session after the hello and the connection; its output so far is discarded.
fn connected() -> (Session, FakeDevice) {
    let falcon = EmulatedFalcon::new(FalconConfig::default());
    let mut device = FakeDevice { falcon, room: usize::MAX, taken: Vec::new(), ready: VecDeque::new() };
    let mut session = Session::new();
    session.receive(&packet::hello(), &mut device).expect("a hello");
    session.connect(&mut device);
    session.take_output();
    (session, device)
}

fn bulk(endpoint: u8, len: u16, data: &[u8]) -> Vec<u8> {
    let [low, high] = len.to_le_bytes();
    [&[endpoint, 0, low, high, 0, 0, 0, 0, 0, 0], data].concat()
}

fn request(session: &mut Session, device: &mut FakeDevice, kind: u32, id: u64, body: &[u8]) -> Vec<u8> {
    session.receive(&packet::packet(kind, id, body), device).expect("a valid packet");
    session.take_output()
}

#[test]
fn the_device_is_connected_with_its_descriptors() {
    let (mut session, mut device) = connected();
    session.connect(&mut device);
    let output = session.take_output();
    let (interfaces, rest) = output.split_at(16 + 132);
    let (endpoints, connect) = rest.split_at(16 + 160);
    assert_eq!(interfaces[..8], [4, 0, 0, 0, 132, 0, 0, 0]);
    assert_eq!((&interfaces[16..21], interfaces[16 + 4 + 32]), (&[1, 0, 0, 0, 0][..], 0xff));
    assert_eq!(endpoints[..8], [5, 0, 0, 0, 160, 0, 0, 0]);
    let kinds = &endpoints[16..48];
    assert_eq!((kinds[0], kinds[2], kinds[16], kinds[17]), (0, 2, 0, 2));
    assert_eq!(kinds.iter().filter(|kind| **kind == 255).count(), 28);
    let size = |at: usize| endpoints[16 + 96 + 2 * at];
    assert_eq!((size(2), size(17), size(1)), (64, 64, 0));
    #[rustfmt::skip]
    assert_eq!(connect, [
        1, 0, 0, 0,  10, 0, 0, 0,  0, 0, 0, 0, 0, 0, 0, 0,
        1,  0, 0, 0,  0x03, 0x04,  0x48, 0xcb,  0x00, 0x06,
    ]);
    assert!(session.is_connected() && session.is_handshake_done());
}

#[test]
fn a_disconnected_device_answers_nothing() {
    let (mut session, mut device) = connected();
    assert_eq!(request(&mut session, &mut device, kind::BULK, 5, &bulk(0x81, 64, b"")), b"", "it waits");
    session.disconnect();
    assert_eq!(session.take_output(), packet::packet(kind::DEVICE_DISCONNECT, 0, &[]));
    device.ready.push_back(Ok(vec![1, 0x60]));
    session.poll(&mut device);
    assert_eq!(request(&mut session, &mut device, kind::CANCEL, 5, &[]), b"");
    assert_eq!(request(&mut session, &mut device, kind::SET_CONFIGURATION, 6, &[1]), b"");
    assert!(!session.is_connected());
}

#[test]
fn control_transfers_reach_the_device_and_may_stall() {
    let (mut session, mut device) = connected();
    let latency = [0, 9, 0x40, 0, 7, 0, 0, 0, 0, 0];
    let answer = request(&mut session, &mut device, kind::CONTROL, 1, &latency);
    assert_eq!((&answer[8..16], &answer[16..]), (&[1, 0, 0, 0, 0, 0, 0, 0][..], &latency[..]));
    let answer = request(&mut session, &mut device, kind::CONTROL, 2, &[0x80, 10, 0xc0, 0, 0, 0, 0, 0, 1, 0]);
    assert_eq!(answer[16..], [0x80, 10, 0xc0, 0, 0, 0, 0, 0, 1, 0, 7]);
    // The device qualifier, which a single-speed device does not have.
    let answer = request(&mut session, &mut device, kind::CONTROL, 3, &[0x80, 6, 0x80, 0, 0, 6, 0, 0, 10, 0]);
    assert_eq!(answer[16..], [0x80, 6, 0x80, 4, 0, 6, 0, 0, 0, 0]);
    assert_eq!((session.traffic().control, session.traffic().stalled), (3, 1));
}

#[test]
fn configuration_and_alternate_setting_are_reported() {
    let (mut session, mut device) = connected();
    let mut says = |kind, body: &[u8]| request(&mut session, &mut device, kind, 9, body)[16..].to_vec();
    assert_eq!(says(kind::SET_CONFIGURATION, &[1]), [0, 1]);
    assert_eq!(says(kind::SET_CONFIGURATION, &[7]), [4, 1]);
    assert_eq!(says(kind::GET_CONFIGURATION, &[]), [0, 1]);
    assert_eq!(says(kind::SET_ALT_SETTING, &[0, 0]), [0, 0, 0]);
    assert_eq!(says(kind::SET_ALT_SETTING, &[0, 1]), [4, 0, 0]);
    assert_eq!(says(kind::GET_ALT_SETTING, &[0]), [0, 0, 0]);
}

/// The host's transfer is larger than a packet: full packets are joined, and a short one ends it.
#[test]
fn a_transfer_in_ends_with_a_short_packet_or_when_it_is_full() {
    let (mut session, mut device) = connected();
    assert_eq!(request(&mut session, &mut device, kind::BULK, 1, &bulk(0x81, 256, b"")), b"");
    device.ready.push_back(Ok(vec![9; 64]));
    session.poll(&mut device);
    assert_eq!(session.take_output(), b"", "a full packet may be followed by another");
    device.ready.push_back(Ok(vec![8; 18]));
    session.poll(&mut device);
    let answer = session.take_output();
    assert_eq!((answer[8], answer[17], answer[18], answer.len()), (1, 0, 82, 16 + 10 + 82));

    request(&mut session, &mut device, kind::BULK, 2, &bulk(0x81, 128, b""));
    device.ready.push_back(Ok(vec![7; 128]));
    session.poll(&mut device);
    assert_eq!(session.take_output().len(), 16 + 10 + 128);
    // A packet may not fit, so the request is invalid.
    assert_eq!(
        request(&mut session, &mut device, kind::BULK, 3, &bulk(0x81, 63, b""))[17],
        Status::Invalid as u8
    );
}

#[test]
fn transfers_in_are_answered_in_order() {
    let (mut session, mut device) = connected();
    for id in 1..=3 {
        assert_eq!(request(&mut session, &mut device, kind::BULK, id, &bulk(0x81, 64, b"")), b"");
    }
    device.ready.extend([Ok(vec![1, 0x60, b'a']), Ok(vec![1, 0x60, b'b'])]);
    session.poll(&mut device);
    let output = session.take_output();
    let (first, second) = output.split_at(16 + 10 + 3);
    assert_eq!((first[8], first[28], second[8], second[28]), (1, b'a', 2, b'b'));
}

#[test]
fn the_data_of_a_cancelled_transfer_goes_to_the_next_one() {
    let (mut session, mut device) = connected();
    request(&mut session, &mut device, kind::BULK, 1, &bulk(0x81, 256, b""));
    device.ready.push_back(Ok(vec![9; 64]));
    session.poll(&mut device);
    let answer = request(&mut session, &mut device, kind::CANCEL, 1, &[]);
    assert_eq!((answer[0], answer[8], answer[17], answer.len()), (101, 1, Status::Cancelled as u8, 26));
    assert_eq!(request(&mut session, &mut device, kind::CANCEL, 1, &[]), b"", "it is cancelled once");
    // Complete at once, without a poll of the device.
    let answer = request(&mut session, &mut device, kind::BULK, 2, &bulk(0x81, 64, b""));
    assert_eq!((answer[17], answer.len()), (0, 16 + 10 + 64));
    assert_eq!(session.traffic().cancelled, 1);
}

/// QEMU drops the answer to a transfer that it has cancelled meanwhile. A driver whose timeout equals the
/// chip's timer would otherwise lose bytes often.
#[test]
fn the_data_of_an_answer_that_crosses_a_cancellation_is_kept() {
    let (mut session, mut device) = connected();
    device.ready.extend([Ok(vec![1, 0x60, b'a']), Ok(vec![1, 0x60, b'b'])]);
    request(&mut session, &mut device, kind::BULK, 1, &bulk(0x81, 64, b""));
    assert_eq!(request(&mut session, &mut device, kind::CANCEL, 1, &[]), b"", "it has been answered");
    assert_eq!(request(&mut session, &mut device, kind::BULK, 2, &bulk(0x81, 64, b""))[26..], *b"\x01\x60a");
    assert_eq!(request(&mut session, &mut device, kind::BULK, 3, &bulk(0x81, 64, b""))[26..], *b"\x01\x60b");
    assert_eq!(request(&mut session, &mut device, kind::CANCEL, 2, &[]), b"", "and one after it: too old");
    assert_eq!(request(&mut session, &mut device, kind::BULK, 4, &bulk(0x81, 64, b"")), b"");
}

#[test]
fn data_without_room_waits_as_after_a_nak() {
    let (mut session, mut device) = connected();
    device.room = 3;
    assert_eq!(request(&mut session, &mut device, kind::BULK, 1, &bulk(0x02, 5, b"abcde")), b"");
    assert_eq!(request(&mut session, &mut device, kind::BULK, 2, &bulk(0x02, 1, b"f")), b"");
    device.room = 10;
    session.poll(&mut device);
    let output = session.take_output();
    assert_eq!((device.taken.as_slice(), output.len()), (&b"abcdef"[..], 2 * 26));
    assert_eq!((output[8], output[17], output[18], output[26 + 8]), (1, 0, 5, 2));
}

#[test]
fn a_stalled_pipe_stays_halted_until_it_is_cleared() {
    let (mut session, mut device) = connected();
    device.ready.extend([Err(Stall), Ok(vec![1, 0x60])]);
    let stalled = request(&mut session, &mut device, kind::BULK, 1, &bulk(0x81, 64, b""));
    assert_eq!((stalled[17], stalled.len()), (Status::Stall as u8, 26));
    let clear = |endpoint| [0, 1, 0x02, 0, 0, 0, endpoint, 0, 0, 0];
    // Clearing another pipe has no effect.
    request(&mut session, &mut device, kind::CONTROL, 2, &clear(0x02));
    assert_eq!(request(&mut session, &mut device, kind::BULK, 3, &bulk(0x02, 3, b"abc"))[17], 0);
    let again = request(&mut session, &mut device, kind::BULK, 4, &bulk(0x81, 64, b""));
    assert_eq!((again[17], again.len()), (Status::Stall as u8, 26), "until it is cleared");
    request(&mut session, &mut device, kind::CONTROL, 5, &clear(0x81));
    assert_eq!(request(&mut session, &mut device, kind::BULK, 6, &bulk(0x81, 64, b""))[26..], [1, 0x60]);
}

#[test]
fn a_bus_reset_cancels_all_transfers() {
    let (mut session, mut device) = connected();
    request(&mut session, &mut device, kind::SET_CONFIGURATION, 1, &[1]);
    request(&mut session, &mut device, kind::BULK, 2, &bulk(0x81, 64, b""));
    let answer = request(&mut session, &mut device, kind::RESET, 0, &[]);
    assert_eq!((answer[8], answer[17], answer.len()), (2, Status::Cancelled as u8, 26));
    device.ready.push_back(Ok(vec![1, 0x60]));
    session.poll(&mut device);
    assert_eq!(session.take_output(), b"");
    assert_eq!(request(&mut session, &mut device, kind::GET_CONFIGURATION, 3, &[])[16..], [0, 0]);
}

#[test]
fn a_peer_without_the_capabilities_is_refused() {
    let (mut session, mut device) = (Session::new(), connected().1);
    let mut hello = packet::hello();
    hello[76] = CAPABILITIES as u8 & !(1 << 5);
    assert!(session.receive(&hello, &mut device).is_err() && !session.is_handshake_done());
}
