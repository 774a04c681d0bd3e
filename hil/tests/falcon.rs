//! The emulated Falcon under raw requests and packets of the protocol, without the host's driver.

use palpate_core::{Vec3, vec3};
use palpate_hil::falcon::kinematics::Pose;
use palpate_hil::falcon::memory::Link;
use palpate_hil::falcon::{LoaderFault, LoaderOptions, Setup, homing_path, synthetic_image};
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

fn image() -> Vec<u8> {
    let code: Vec<u16> = (0..500).map(|i| i * 77).collect();
    synthetic_image(0x3f_8000, &[(0x3f_8000, &code), (0x8000, &code[..33])])
}

/// Steps 1 to 5 of a load. The error is the number of the failed step.
fn load(ftdi: &impl Ftdi, image: &[u8]) -> Result<(), u8> {
    let set = |request, value| ftdi.control(request, value).expect("a known request");
    for (request, value) in
        [(0, 1), (0, 2), (9, 16), (3, 0x4138), (4, 8), (2, 0), (1, 0x200), (1, 0x100), (1, 0x101)]
    {
        set(request, value);
    }
    let say = |bytes: &[u8]| assert_eq!(ftdi.write(bytes, TIMEOUT), Ok(bytes.len()));
    say(&[0x0a, 0x43, 0x0d]);
    let welcome = listen(ftdi, 4, TIMEOUT);
    if welcome.strip_prefix(&[0]).unwrap_or(&welcome) != [0x0a, 0x44, 0x2c, 0x0d] {
        return Err(2);
    }
    set(1, 0x100);
    set(3, 0x15);
    say(&[0x41]);
    if listen(ftdi, 1, TIMEOUT) != [0x41] {
        return Err(3);
    }
    for chunk in image.chunks(62) {
        say(chunk);
        if listen(ftdi, chunk.len(), TIMEOUT) != chunk {
            return Err(4);
        }
    }
    set(9, 1);
    set(3, 2);
    set(0, 1);
    set(0, 2);
    Ok(())
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

fn homed() -> MemoryFtdi {
    let ftdi = running(FalconConfig::default());
    for _ in 0..1_600 {
        exchange(&ftdi, ZERO, HOMING);
    }
    assert!(ftdi.falcon().is_homed());
    ftdi
}

/// Motor commands for a force on the hand, by the protocol: -10000 J^T F, J = d(position)/d(angles).
fn motors_for(force_n: Vec3, at_m: Vec3) -> [i16; 3] {
    // Columns of J by Cramer's rule on its inverse: the displacement that turns one arm alone.
    let [a, b, c] = Pose::at(at_m).expect("within reach").rad_per_m;
    let cross = |p: [f64; 3], q: [f64; 3]| {
        [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    };
    let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    let determinant = dot(a, cross(b, c));
    let columns = [cross(b, c), cross(c, a), cross(a, b)];
    columns.map(|column| {
        let torque_nm = dot(column, force_n.map(f64::from)) / determinant;
        (-10_000.0 * torque_nm).round() as i16
    })
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

#[test]
fn a_board_without_firmware_is_silent_until_it_is_loaded() {
    let ftdi = MemoryFtdi::new(EmulatedFalcon::new(FalconConfig {
        loader: LoaderOptions { leading_zero: true, fault: None },
        ..FalconConfig::default()
    }));
    ftdi.control(3, 2).expect("a rate");
    ftdi.control(9, 1).expect("a latency");
    ftdi.write(&request(ZERO, 0), TIMEOUT).expect("room");
    assert_eq!(listen(&ftdi, 16, TIMEOUT), b"");

    assert_eq!(load(&ftdi, &image()), Ok(()));
    let loaded = ftdi.falcon().image().expect("an image");
    assert_eq!((loaded.entry, loaded.blocks, loaded.words), (0x3f_8000, 2, 533));
    ftdi.write(&request(ZERO, 0b1000), TIMEOUT).expect("room");
    let first = reply(&listen(&ftdi, 16, TIMEOUT)).expect("a reply");
    assert_eq!((first.homed, first.buttons), (0, 0));
    assert_eq!(ftdi.falcon().firmware().map(|firmware| firmware.leds()), Some(0b100), "red");
    // 2 x 1116 bytes at 142,857 baud, and the rest at 9600 baud, take virtual time.
    assert!((100_000..2_000_000).contains(&ftdi.now_us()), "{} us", ftdi.now_us());
}

#[test]
fn an_invalid_image_is_refused_and_a_valid_one_loads_after_it() {
    let ftdi = MemoryFtdi::new(EmulatedFalcon::new(FalconConfig::default()));
    let mut wrong = image();
    wrong[0] ^= 1;
    assert_eq!(load(&ftdi, &wrong), Err(4));
    assert!(ftdi.falcon().firmware().is_none());
    assert_eq!(load(&ftdi, &image()), Ok(()));
    assert!(ftdi.falcon().firmware().is_some());
}

#[test]
fn each_loader_fault_fails_at_its_step_and_ends() {
    for (fault, step) in [
        (LoaderFault::Silent, 2),
        (LoaderFault::Refuses, 2),
        (LoaderFault::WrongEcho { at: 700 }, 4),
        (LoaderFault::FallsSilent { at: 700 }, 4),
    ] {
        let loader = LoaderOptions { leading_zero: false, fault: Some((fault, 3)) };
        let ftdi = MemoryFtdi::new(EmulatedFalcon::new(FalconConfig { loader, ..FalconConfig::default() }));
        for _ in 0..3 {
            assert_eq!(load(&ftdi, &image()), Err(step), "{fault:?}");
        }
        assert_eq!(load(&ftdi, &image()), Ok(()), "{fault:?}");
    }
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
fn a_force_moves_the_grip_along_its_direction() {
    let ftdi = homed();
    let at_m = ftdi.falcon().position_m();
    let force = [[3.0, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, 3.0], [1.5, 2.0, -2.5]];
    for expected_n in force {
        let before_m = ftdi.falcon().position_m();
        ftdi.falcon().reset_record();
        exchange(&ftdi, motors_for(expected_n, before_m), HOMING);
        let felt_n = ftdi.falcon().force_record().force_n;
        assert!(vec3::distance(felt_n, expected_n) < 0.03, "{felt_n:?} N, expected {expected_n:?} N");
        for _ in 0..400 {
            let here_m = ftdi.falcon().position_m();
            exchange(&ftdi, motors_for(expected_n, here_m), HOMING);
        }
        // Stiffness of the arm 450 N/m, and 0.2 N of friction in either direction.
        let moved_m = vec3::sub(ftdi.falcon().position_m(), before_m);
        let error_n = vec3::distance(vec3::scale(moved_m, 450.0), expected_n);
        assert!(error_n < 0.5, "{moved_m:?} m under {expected_n:?} N");
        assert!(ftdi.falcon().force_record().work_j > 0.0);
        for _ in 0..400 {
            exchange(&ftdi, ZERO, HOMING);
        }
        assert!(vec3::distance(ftdi.falcon().position_m(), at_m) < 2e-3);
    }
}

#[test]
fn there_is_no_watchdog_and_unplugging_keeps_the_force() {
    let ftdi = homed();
    let at_m = ftdi.falcon().position_m();
    exchange(&ftdi, motors_for([0.0, 0.0, 2.0], at_m), HOMING);
    let commanded_us = ftdi.now_us();
    ftdi.falcon().advance(commanded_us + 5_000_000);
    assert!(ftdi.falcon().force_record().force_n[2] > 1.5);
    ftdi.unplug();
    ftdi.falcon().advance(commanded_us + 6_000_000);
    ftdi.replug();
    ftdi.falcon().advance(commanded_us + 7_000_000);
    let felt = *ftdi.falcon().force_record();
    assert!(felt.force_n[2] > 1.5 && felt.off_since_us.is_none());
    assert!(felt.last_command_us.is_some_and(|at_us| at_us <= commanded_us));
    // The firmware still runs after the device is opened again.
    ftdi.reopen().expect("it is plugged in again");
    for (request, value) in [(3, 2), (9, 1), (6, 0x013e)] {
        ftdi.control(request, value).expect("a known request");
    }
    assert_eq!(exchange(&ftdi, ZERO, HOMING).homed, 0b111);
    assert_eq!(ftdi.falcon().force_record().force_n, vec3::ZERO);
    // Without power neither firmware nor motors work.
    exchange(&ftdi, motors_for([0.0, 0.0, 2.0], at_m), HOMING);
    ftdi.falcon().power_cycle();
    assert!(ftdi.falcon().firmware().is_none() && ftdi.falcon().force_record().force_n == vec3::ZERO);
}

#[test]
fn buttons_encoder_jumps_and_a_loss_of_homing_are_reported() {
    let ftdi = homed();
    ftdi.falcon().press(0b0101);
    let before = exchange(&ftdi, ZERO, HOMING);
    assert_eq!((before.buttons, before.homed), (0b0101, 0b111));
    ftdi.falcon().jump_encoder(1, 250);
    let after = exchange(&ftdi, ZERO, HOMING);
    let moved = [0, 1, 2].map(|i| after.counts[i] - before.counts[i]);
    assert!(moved[0].abs() <= 1 && (moved[1] - 250).abs() <= 1 && moved[2].abs() <= 1, "{moved:?}");
    ftdi.falcon().lose_homing();
    assert_eq!(exchange(&ftdi, ZERO, HOMING).homed, 0);
}

/// A session with faults of every kind: the counts are bounded, repeat with the seed, and most replies are
/// valid.
#[test]
fn faults_in_both_directions_repeat_with_their_seed() {
    let faults = Faults {
        drop: 0.02,
        truncate: 0.02,
        corrupt: 0.02,
        delay: 0.02,
        delay_us: 4_000,
        duplicate: 0.02,
        reorder: 0.02,
        stall: 0.005,
        stall_us: 8_000,
        noise: 0.02,
        ..Faults::default()
    };
    let run = |seed| {
        let ftdi = FaultyFtdi::new(running(FalconConfig::default()), seed);
        ftdi.set_faults(faults, faults);
        let (mut good, mut all) = (0, Vec::new());
        for ms in 1..=2_000_u64 {
            ftdi.write(&request(ZERO, HOMING), Duration::ZERO).expect("the cable is in");
            ftdi.inner().falcon().advance(ms * 1_000);
            let bytes = listen(&ftdi, 16, Duration::ZERO);
            let is_good = bytes.len() == 16 && bytes[1..15].iter().all(|byte| (0x41..=0xc0).contains(byte));
            good += u32::from(is_good);
            all.extend(bytes);
        }
        (good, all, ftdi.counts())
    };
    let (good, all, counts) = run(3);
    assert!((1_200..1_950).contains(&good), "{good}");
    for channel in [counts.0, counts.1] {
        let injected =
            [channel.dropped, channel.truncated, channel.corrupted, channel.delayed, channel.duplicated];
        assert!(injected.iter().all(|count| (15..90).contains(count)), "{channel:?}");
        assert!(channel.reordered > 10 && channel.stalled > 2 && channel.noise_bursts > 15, "{channel:?}");
    }
    assert_eq!((good, all.clone(), counts), run(3));
    assert_ne!(all, run(4).1);
}

#[test]
fn without_faults_the_wrapper_changes_nothing() {
    let (plain, wrapped) =
        (running(FalconConfig::default()), FaultyFtdi::new(running(FalconConfig::default()), 1));
    let (mut one, mut other) = ([0; 512], [0; 512]);
    for i in 0..50_i16 {
        let packet = request([i, -i, 2 * i], HOMING);
        assert_eq!(plain.write(&packet, TIMEOUT), wrapped.write(&packet, TIMEOUT));
        let (a, b) = (plain.read(&mut one, TIMEOUT), wrapped.read(&mut other, TIMEOUT));
        assert_eq!((a, one), (b, other));
    }
    assert_eq!(plain.now_us(), wrapped.now_us());
    assert_eq!(load(&wrapped, &image()), Ok(()), "the loader too, which DTR starts at any time");
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
