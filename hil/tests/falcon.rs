//! The emulated Falcon under raw requests and packets of the protocol, without the host's driver.

use palpate_core::vec3;
use palpate_hil::falcon::kinematics::Pose;
use palpate_hil::falcon::memory::Link;
use palpate_hil::falcon::{Setup, homing_path};
use palpate_hil::{EmulatedFalcon, FalconConfig, Faults, FaultyFtdi, MemoryFtdi, Waypoint};
use palpate_host::DeviceErrorKind;
use palpate_host::device::falcon::Ftdi;
use std::time::Duration;

const TIMEOUT: Duration = Duration::from_millis(100);
const HOMING: u8 = 1;
const ZERO: [i16; 3] = [0; 3];

fn request(motors: [i16; 3], control: u8) -> [u8; 16] {
    let mut packet = [0x41; 16];
    (packet[0], packet[15]) = (b'<', b'>');
    for (axis, motor) in motors.into_iter().enumerate() {
        for nibble in 0..4 {
            packet[1 + 4 * axis + nibble] += (motor as u16 >> (4 * nibble) & 0xf) as u8;
        }
    }
    packet[13] += control;
    packet
}

#[derive(Debug, PartialEq)]
struct Reply {
    counts: [i16; 3],
    buttons: u8,
    homed: u8,
}

/// The last whole packet in these bytes.
fn reply(bytes: &[u8]) -> Option<Reply> {
    let end = bytes.iter().rposition(|byte| *byte == b'>')?;
    let packet = bytes.get(end.checked_sub(15)?..=end)?;
    let value = |at: usize| packet[at] - 0x41;
    let counts = [1, 5, 9].map(|from| {
        (0..4).map(|nibble| u16::from(value(from + nibble)) << (4 * nibble)).sum::<u16>().cast_signed()
    });
    Some(Reply { counts, buttons: value(13) & 0xf, homed: value(13) >> 4 })
}

/// Payload received within a time, across packets.
fn listen(ftdi: &impl Ftdi, count: usize, deadline: Duration) -> Vec<u8> {
    let (mut bytes, mut buffer) = (Vec::new(), [0; 512]);
    // An idle chip sends a packet each time its timer expires, after 16 ms at most.
    for _ in 0..40 {
        if bytes.len() >= count {
            break;
        }
        let Ok(read) = ftdi.read(&mut buffer, deadline) else { break };
        bytes.extend(buffer[..read].chunks(64).flat_map(|packet| packet[2..].to_vec()));
    }
    bytes
}

/// A device with running firmware, at the firmware's baud rate.
fn running(config: FalconConfig) -> MemoryFtdi {
    let ftdi = MemoryFtdi::new(EmulatedFalcon::new(FalconConfig { firmware_runs: true, ..config }));
    for (request, value) in [(4, 8), (3, 2), (9, 1), (6, 0x013e)] {
        ftdi.control(request, value).expect("a known request");
    }
    ftdi
}

/// One exchange per millisecond.
fn exchange(ftdi: &MemoryFtdi, motors: [i16; 3], control: u8) -> Reply {
    let next_us = ftdi.now_us() + 1_000;
    ftdi.write(&request(motors, control), Duration::ZERO).expect("room");
    ftdi.falcon().advance(next_us);
    reply(&listen(ftdi, 16, Duration::ZERO)).expect("a reply")
}

#[test]
fn the_device_enumerates_as_a_falcon() {
    let mut falcon = EmulatedFalcon::new(FalconConfig::default());
    let get = |value| Setup { request_type: 0x80, request: 6, value, index: 0, length: 255 };
    let device = falcon.control(get(0x0100), &[]).expect("a descriptor");
    assert_eq!((device.len(), &device[8..12]), (18, &[0x03, 0x04, 0x48, 0xcb][..]));
    let configuration = falcon.control(get(0x0200), &[]).expect("a descriptor");
    assert_eq!(configuration[..4], [9, 2, 32, 0]);
    let name = falcon.control(get(0x0302), &[]).expect("a string");
    let units: Vec<u16> = name[2..].chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
    assert_eq!(String::from_utf16_lossy(&units), "FALCON");
    let configure = Setup { request_type: 0, request: 9, value: 1, index: 0, length: 0 };
    assert_eq!(falcon.control(configure, &[]), Ok(Vec::new()));
}

/// 16 bytes out, 20 us, 16 bytes in: 234 us; then the timer, or at once.
#[test]
fn a_reply_waits_for_the_latency_timer_unless_its_last_byte_is_the_event_character() {
    let comes_after_us = |event: u16| {
        let ftdi = running(FalconConfig::default());
        ftdi.control(6, event).expect("a known request");
        let mut buffer = [0; 64];
        // The timer restarts with the packet it sends.
        assert_eq!(ftdi.read(&mut buffer, TIMEOUT), Ok(2));
        let sent_us = ftdi.now_us();
        ftdi.write(&request(ZERO, 0), TIMEOUT).expect("room");
        assert_eq!(ftdi.read(&mut buffer, TIMEOUT), Ok(18));
        assert!(reply(&buffer[2..18]).is_some());
        ftdi.now_us() - sent_us
    };
    assert_eq!(comes_after_us(0), 1_000);
    assert!((230..=250).contains(&comes_after_us(0x013e)));
    assert_eq!(comes_after_us(0x003e), 1_000, "without its enable bit it has no effect");
}

#[test]
fn the_timer_may_split_a_reply() {
    let ftdi = running(FalconConfig::default());
    ftdi.control(6, 0).expect("a known request");
    let mut buffer = [0; 64];
    ftdi.read(&mut buffer, TIMEOUT).expect("idle");
    let at_us = ftdi.now_us() + 820;
    ftdi.falcon().advance(at_us);
    ftdi.write(&request(ZERO, 0), TIMEOUT).expect("room");
    let first = ftdi.read(&mut buffer, TIMEOUT).expect("a part");
    assert!((3..18).contains(&first), "{first} bytes");
    assert_eq!(ftdi.read(&mut buffer, TIMEOUT), Ok(20 - first));
}

#[test]
fn the_grip_is_homed_by_moving_out_and_in() {
    let ftdi = running(FalconConfig::default());
    // Without a homing request the hand waits.
    for _ in 0..500 {
        assert_eq!(exchange(&ftdi, ZERO, 0).homed, 0);
    }
    assert_eq!(ftdi.falcon().position_m(), homing_path()[0].position_m);
    let true_counts = Pose::at(ftdi.falcon().position_m()).expect("within reach").counts();
    let raw = exchange(&ftdi, ZERO, HOMING).counts;
    assert_eq!([0, 1, 2].map(|i| i32::from(raw[i]) - true_counts[i]), [1_234, -4_321, 77]);

    let (mut homed_at_ms, mut outermost_m) = (None, 0.0_f32);
    for ms in 0..2_000 {
        let seen = exchange(&ftdi, ZERO, HOMING);
        outermost_m = outermost_m.max(ftdi.falcon().position_m()[2]);
        if seen.homed == 0b111 {
            homed_at_ms.get_or_insert(ms);
        }
    }
    assert!(outermost_m > 0.15, "{outermost_m}");
    assert!(homed_at_ms.is_some_and(|ms| (500..1_100).contains(&ms)), "{homed_at_ms:?}");
    let at_m = ftdi.falcon().position_m();
    assert!(vec3::distance(at_m, [0.0, 0.0, 0.12]) < 1e-3, "{at_m:?}");
    let counts = exchange(&ftdi, ZERO, HOMING).counts.map(i32::from);
    let expected = Pose::at(at_m).expect("within reach").counts();
    assert!((0..3).all(|i| (counts[i] - expected[i]).abs() <= 1), "{counts:?} {expected:?}");
}

/// On a lateral path the three axes pass their indices one after the other.
#[test]
fn each_axis_is_homed_by_itself() {
    let at = |t_us, position_m| Waypoint { t_us, position_m };
    let path =
        vec![at(0, [0.0, 0.0, 0.15]), at(200_000, [0.02, 0.0, 0.15]), at(1_200_000, [0.02, 0.0, 0.10])];
    let ftdi = running(FalconConfig { path, ..FalconConfig::default() });
    let mut seen = Vec::new();
    for _ in 0..1_500 {
        let homed = exchange(&ftdi, ZERO, HOMING).homed;
        if seen.last() != Some(&homed) {
            seen.push(homed);
        }
    }
    assert_eq!(seen.len(), 4, "{seen:?}");
    assert_eq!((seen[0], seen[3]), (0, 0b111));
    assert!(seen.windows(2).all(|pair| pair[0] & pair[1] == pair[0]), "{seen:?}");
}

#[test]
fn a_cable_pulled_by_a_fault_is_plugged_in_after_its_time() {
    let ftdi = FaultyFtdi::new(running(FalconConfig::default()), 1);
    ftdi.set_faults(Faults { unplug: 1.0, unplug_us: 50_000, ..Faults::default() }, Faults::default());
    let lost = ftdi.write(&request(ZERO, 0), TIMEOUT).map_err(|error| error.kind());
    assert_eq!(lost, Err(DeviceErrorKind::Disconnected));
    ftdi.set_faults(Faults::default(), Faults::default());
    let kind = |result: Result<usize, palpate_host::DeviceError>| result.map_err(|error| error.kind());
    assert_eq!(kind(ftdi.read(&mut [0; 64], TIMEOUT)), Err(DeviceErrorKind::Disconnected));
    assert!(ftdi.reopen().is_err(), "not yet");
    ftdi.inner().falcon().advance(50_000);
    assert_eq!(
        kind(ftdi.read(&mut [0; 64], TIMEOUT)),
        Err(DeviceErrorKind::Disconnected),
        "this handle is lost"
    );
    ftdi.reopen().expect("it is plugged in again");
    for (request, value) in [(3, 2), (9, 1), (6, 0x013e)] {
        ftdi.control(request, value).expect("a known request");
    }
    ftdi.write(&request(ZERO, 0), TIMEOUT).expect("room");
    assert!(reply(&listen(&ftdi, 16, TIMEOUT)).is_some());
}
