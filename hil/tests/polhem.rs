//! The host's real Polhem driver and the core's controller with the emulated device, over a pseudo terminal.
//!
//! Time is virtual and both sides run in lockstep: one tick of the host, then the device answers. The load of
//! the machine has no effect.

#[path = "../../host/tests/common/synthetic.rs"]
mod synthetic;

use palpate_core::{Config, Controller, Fault, Method, Organ, Phase, Vec3, vec3};
use palpate_hil::hosts::wait;
use palpate_hil::{EmulatedPolhem, Faults, Faulty, Handle, PtyTransport, Waypoint};
use palpate_host::device::fence::{Fence, GuardPath};
use palpate_host::device::nonblocking_port::NonBlockingPort;
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::workspace::Workspace;
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::{Device, DeviceError, DeviceErrorKind};
use serialport::{SerialPort, TTYPort};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest wait for bytes in flight in a pseudo terminal of a busy machine.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// Device z is the outward normal of the first active node. The device's origin lies on the surface there.
fn workspace(organ: &Organ<'_>) -> Workspace {
    let normal = organ.spaces[0].active.outward_normal;
    let first = vec3::normalize_or_zero(vec3::cross([0.3, 0.9, 0.1], normal));
    let second = vec3::cross(normal, first);
    Workspace {
        axes: [0, 1, 2].map(|i: usize| [first[i], second[i], normal[i]]),
        model_origin_m: organ.spaces[0].active.rest_position_m,
        ..Workspace::default()
    }
}

/// The hand moves from 8 mm above the surface to 12 mm below it, without resistance.
fn pressing() -> Handle {
    let at = |t_us, z| Waypoint { t_us, position_m: [0.0, 0.0, z] };
    Handle::new(vec![at(0, 0.008), at(300_000, 0.008), at(1_000_000, -0.012)])
}

/// Advances the device until the driver can read all delivered bytes. A terminal forwards bytes late, in real
/// time, which would add silence to the link in virtual time.
fn serve(device: &mut EmulatedPolhem, link: &mut Faulty<PtyTransport>, driver_end: &TTYPort, now_us: u64) {
    // The driver has read all earlier bytes, so it reads next what is delivered now.
    let (before, unread) = (link.delivered(), driver_end.bytes_to_read().expect("open"));
    device.poll(now_us, link).expect("open");
    let expected = u64::from(unread) + link.delivered() - before;
    let deadline = std::time::Instant::now() + MAX_WAIT;
    while driver_end.bytes_to_read().is_ok_and(|count| u64::from(count) < expected) {
        assert!(std::time::Instant::now() < deadline, "bytes lost in the terminal");
        std::thread::yield_now();
    }
}

/// Both ends of the link after the device has woken up.
struct Bench<'l, 'o> {
    haptic: HapticLoop<'l, 'o, 'o, Polhem, &'l VirtualClock>,
    clock: &'l VirtualClock,
    records: rtrb::Consumer<TickRecord>,
    device: EmulatedPolhem,
    link: Faulty<PtyTransport>,
    driver_end: TTYPort,
    fence: Fence,
    path: GuardPath,
    index: u64,
}

impl<'l, 'o> Bench<'l, 'o> {
    fn new(organ: &'o Organ<'o>, clock: &'l VirtualClock, controls: &'l Controls) -> Self {
        let (link, driver) = PtyTransport::pair().expect("a pseudo terminal");
        let driver_end = driver.try_clone_native().expect("a second handle");
        let (mut link, mut device) =
            (Faulty::new(link, Faults::default(), 11), EmulatedPolhem::new(pressing()));
        let woken = AtomicBool::new(false);
        let mut polhem = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !woken.load(Ordering::Relaxed) {
                    device.poll(0, &mut link).expect("the terminal is open");
                    std::thread::sleep(Duration::from_micros(200));
                }
            });
            let config = PolhemConfig { workspace: workspace(organ), ..PolhemConfig::default() };
            let port = NonBlockingPort::from_port(driver).expect("it is open");
            let polhem = Polhem::with_port(Box::new(port), config);
            woken.store(true, Ordering::Relaxed);
            polhem.expect("the emulator wakes up")
        });
        let controller = Controller::new(organ, Config::new(Method::Hybrid)).expect("has the method");
        let (producer, records) = rtrb::RingBuffer::new(10_000);
        let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
        let outputs = Outputs { records: producer, latest };
        // Through the same boxes as in a session.
        let fence = Fence::default();
        let path = (&mut polhem as &mut dyn Device).guard_path(&fence);
        let path = path.expect("it is open").expect("a serial port has a path");
        let haptic = HapticLoop::new(controller, polhem, clock, LoopConfig::default(), controls, outputs);
        Self { haptic, clock, records, device, link, driver_end, fence, path, index: 0 }
    }

    fn now_us(&self) -> u64 {
        self.index * 1_000
    }

    /// One tick of the host, then the device advances.
    fn step(&mut self) -> Result<TickRecord, DeviceError> {
        self.index += 1;
        let now_us = self.now_us();
        self.clock.wait_until(now_us * 1_000, 0);
        self.haptic.tick(self.index, 0, now_us * 1_000)?;
        let record = self.records.pop().expect("one record per tick");
        self.serve();
        Ok(record)
    }

    fn serve(&mut self) {
        let now_us = self.now_us();
        serve(&mut self.device, &mut self.link, &self.driver_end, now_us);
    }

    fn run(&mut self, ticks: u64) -> Vec<TickRecord> {
        (0..ticks).map(|_| self.step().expect("the device is connected")).collect()
    }
}

fn with_bench(test: impl FnOnce(&mut Bench<'_, '_>, &Controls)) {
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let mut bench = Bench::new(&organ, &clock, &controls);
    test(&mut bench, &controls);
}

/// Under any fault the force is finite, within the force and slew limits, and zero unless active.
fn assert_safe(records: &[TickRecord]) {
    let mut before = vec3::ZERO;
    for record in records {
        let force_n = record.hand_force_n;
        assert!(vec3::is_finite(force_n) && vec3::norm(force_n) <= 8.0, "{record:?}");
        let step_n = vec3::distance(force_n, before);
        assert!(force_n == vec3::ZERO || step_n <= 2.001, "{step_n} N in one tick: {record:?}");
        assert!(record.phase == Phase::Active || force_n == vec3::ZERO, "{record:?}");
        before = force_n;
    }
}

#[test]
fn a_press_gives_a_force_through_the_whole_chain() {
    with_bench(|bench, controls| {
        let disarmed = bench.run(50);
        assert!(disarmed.iter().all(|record| record.phase == Phase::Disarmed));
        assert_eq!(bench.device.force_n(), vec3::ZERO, "a real device never arms itself");
        controls.arm();
        let records = bench.run(1_600);
        assert_safe(&records);
        let last = records.last().expect("ticks ran");
        assert_eq!((last.phase, last.engaged), (Phase::Active, Some(0)));
        // The handle rests between the hand's spring and the organ: the forces balance at a depth between 0
        // and 12 mm.
        let [x, y, z] = bench.device.force_n();
        assert!(z > 1.0 && x.abs() < 0.1 && y.abs() < 0.1, "{:?}", bench.device.force_n());
        let balance_n = 400.0 * (bench.device.position_m()[2] + 0.012);
        assert!((z - balance_n).abs() < 0.05, "{z} N against the hand's {balance_n} N");
        assert!((vec3::norm(last.hand_force_n) - z).abs() < 0.05);
        // One request per tick except at the start: the link keeps up with 1 kHz.
        assert!(bench.device.requests() > 1_600, "{}", bench.device.requests());
        assert_eq!(bench.device.refused(), 0);
    });
}

#[test]
fn the_end_of_the_loop_removes_the_force() {
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let mut bench = Bench::new(&organ, &clock, &controls);
    controls.arm();
    bench.run(1_400);
    assert!(bench.device.force_n()[2] > 1.0);
    let Bench { haptic, mut device, mut link, index, .. } = bench;
    drop(haptic);
    assert!(link.inner_mut().poll_input().expect("open"));
    device.poll(index * 1_000, &mut link).expect("open");
    assert_eq!(device.force_n(), vec3::ZERO);
}

#[test]
fn a_silent_link_latches_zero_until_reset_and_arming() {
    with_bench(|bench, controls| {
        controls.arm();
        let mut records = bench.run(1_500);
        assert!(bench.device.force_n()[2] > 1.0);
        bench.link.set_faults(Faults { drop: 1.0, ..Faults::default() });
        let silent = bench.run(40);
        // 10 ms without a sample; the last one may be a tick old.
        for record in &silent[12..] {
            assert_eq!((record.phase, record.hand_force_n), (Phase::SafeZero(Fault::Stale), vec3::ZERO));
        }
        let held: Vec<&TickRecord> =
            silent.iter().filter(|record| record.hand_force_n != vec3::ZERO).collect();
        assert!(held.len() <= 5, "the last force is held for at most 5 ticks, not {}", held.len());
        assert!(
            bench.device.force_n()[2] > 1.0,
            "a device without a watchdog keeps its force on a silent link"
        );

        bench.link.set_faults(Faults::default());
        bench.run(15);
        assert_eq!(bench.device.force_n(), vec3::ZERO, "the first request that arrives removes the force");
        records.extend(bench.run(500));
        assert!(
            records[1_500..].iter().all(|record| record.hand_force_n == vec3::ZERO),
            "the force must not return without a reset"
        );

        controls.reset();
        controls.arm();
        // The tool is below the surface and must cross it before the organ pushes back.
        let again = bench.run(700);
        assert!(again.iter().all(|record| record.phase == Phase::Active));
        assert_safe(&again);
    });
}

/// The loop stops for 60 ms while the hand presses on the organ; only the guard writes to the line.
#[test]
fn a_stalled_loop_is_zeroed_past_the_driver_until_the_fence_opens() {
    with_bench(|bench, controls| {
        controls.arm();
        for _ in 0..1_400 {
            bench.step().expect("the device is connected");
        }
        assert!(bench.device.force_n()[2] > 1.0, "the hand presses on the organ");
        for ms in 1..=60 {
            bench.index += 1;
            bench.clock.wait_until(bench.now_us() * 1_000, 0);
            if ms == 10 {
                bench.fence.page().close();
                bench.path.send_zero(bench.fence.page()).expect("room");
                bench.serve();
            }
            // The emulated device has no watchdog.
            assert_eq!(bench.device.force_n() == vec3::ZERO, ms >= 10, "{ms} ms");
        }
        // The loop resumes and sends its force as before.
        for _ in 0..300 {
            bench.step().expect("the device is connected");
            assert_eq!(bench.device.force_n(), vec3::ZERO, "not for a single tick");
        }
        assert_eq!(bench.device.refused(), 0, "the lines of driver and guard stay separate");
        bench.fence.open();
        controls.reset();
        controls.arm();
        let again = bench.run(900);
        assert_safe(&again);
        assert!(again.iter().all(|record| record.phase == Phase::Active));
    });
}

/// A fault hits one frame about every 50 ms, a request and a reply in turn. Two faults within a few
/// milliseconds may latch zero; the test below covers them.
#[test]
fn the_loop_recovers_from_single_faults() {
    for (name, faults) in [
        ("drop", Faults { drop: 1.0, ..Faults::default() }),
        ("truncate", Faults { truncate: 1.0, ..Faults::default() }),
        ("delay", Faults { delay: 1.0, delay_us: 3_000, ..Faults::default() }),
        ("duplicate", Faults { duplicate: 1.0, ..Faults::default() }),
        ("stall", Faults { stall: 1.0, stall_us: 3_000, ..Faults::default() }),
        ("noise", Faults { noise: 1.0, ..Faults::default() }),
    ] {
        with_bench(|bench, controls| {
            controls.arm();
            let mut records = Vec::new();
            for round in 0..40 {
                let none = Faults::default();
                let (to_device, to_driver) = if round % 2 == 0 { (faults, none) } else { (none, faults) };
                bench.link.set_faults_each(to_device, to_driver);
                records.extend(bench.run(1));
                bench.link.set_faults(none);
                records.extend(bench.run(50 + round % 7));
            }
            assert_safe(&records);
            let counts = bench.link.counts();
            let injected = counts.dropped
                + counts.truncated
                + counts.delayed
                + counts.duplicated
                + counts.stalled
                + counts.noise_bursts;
            assert!((15..=40).contains(&injected), "{name}: {counts:?}");
            assert_eq!(records.last().map(|record| record.phase), Some(Phase::Active), "{name}: {counts:?}");
            assert!(bench.device.force_n()[2] > 1.0, "{name}");
        });
    }
}

/// The protocol has no checksum, so a flipped bit may be a valid number. Then the controller's limits apply.
#[test]
fn many_faults_end_in_zero_force() {
    let faults = Faults {
        drop: 0.05,
        truncate: 0.05,
        corrupt: 0.10,
        delay: 0.05,
        delay_us: 15_000,
        ..Faults::default()
    };
    with_bench(|bench, controls| {
        controls.arm();
        bench.run(1_200);
        bench.link.set_faults(faults);
        let records = bench.run(1_500);
        assert_safe(&records);
        assert!(matches!(records.last().expect("ticks ran").phase, Phase::SafeZero(_)));
        bench.link.set_faults(Faults::default());
        bench.run(60);
        assert_eq!(bench.device.force_n(), vec3::ZERO);
    });
}

/// Delayed replies are fresh bytes with old contents. They must not count as fresh samples.
#[test]
fn a_link_that_is_always_late_is_stale() {
    for delay_us in [12_000, 30_000, 50_000] {
        with_bench(|bench, controls| {
            bench.link.set_faults(Faults { delay: 1.0, delay_us, ..Faults::default() });
            bench.run(200);
            let before = bench.device.requests();
            controls.arm();
            let records = bench.run(300);
            assert_safe(&records);
            assert!(bench.device.requests() > before + 20, "the link carries data continuously");
            assert!(records.iter().all(|record| record.engaged.is_none()), "never on old data");
            assert_eq!(
                records.last().map(|record| record.phase),
                Some(Phase::SafeZero(Fault::Stale)),
                "{delay_us}"
            );
        });
    }
}

#[test]
fn an_unplugged_device_ends_the_loop() {
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let mut bench = Bench::new(&organ, &clock, &controls);
    bench.run(20);
    let Bench { mut haptic, link, index, .. } = bench;
    drop(link);
    let lost = (1..20).find_map(|i| haptic.tick(index + i, 0, (index + i) * 1_000_000).err());
    assert_eq!(lost.map(|error| error.kind()), Some(DeviceErrorKind::Disconnected));
}

#[test]
fn a_device_that_never_wakes_is_a_timeout() {
    let (_link, driver) = PtyTransport::pair().expect("a pseudo terminal");
    let config = PolhemConfig { wake_timeout: Duration::from_millis(250), ..PolhemConfig::default() };
    let port = NonBlockingPort::from_port(driver).expect("it is open");
    let refused = Polhem::with_port(Box::new(port), config);
    assert_eq!(refused.err().map(|error| error.kind()), Some(DeviceErrorKind::Timeout));
}

/// The other tests rely on this: the force on the emulated motors is the commanded one, axis by axis.
#[test]
fn forces_arrive_on_the_right_axes() {
    let (link, driver) = PtyTransport::pair().expect("a pseudo terminal");
    let driver_end = driver.try_clone_native().expect("a second handle");
    let mut link = Faulty::new(link, Faults::default(), 1);
    let mut device = EmulatedPolhem::new(Handle::new(Vec::new()));
    let woken = AtomicBool::new(false);
    let mut polhem = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !woken.load(Ordering::Relaxed) {
                device.poll(0, &mut link).expect("open");
                std::thread::sleep(Duration::from_micros(200));
            }
        });
        let mut config = PolhemConfig { max_stiffness_n_m: 2_000.0, ..PolhemConfig::default() };
        config.workspace.scale = 2.0;
        let port = NonBlockingPort::from_port(driver).expect("it is open");
        let polhem = Polhem::with_port(Box::new(port), config);
        woken.store(true, Ordering::Relaxed);
        polhem.expect("wakes up")
    });
    // A workspace of scale 2 doubles the stiffness of the model at the hand.
    assert_eq!(polhem.info().max_stiffness_n_m, 1_000.0);
    serve(&mut device, &mut link, &driver_end, 0);
    let sent: Vec3 = [1.25, -2.5, 0.75];
    for tick in 1..10 {
        polhem.exchange(tick * 1_000, sent).expect("a fault-free link");
        serve(&mut device, &mut link, &driver_end, tick * 1_000);
    }
    assert_eq!(device.force_n(), sent);
}

#[test]
fn a_device_that_sends_noise_still_receives_its_zero() {
    with_bench(|bench, controls| {
        controls.arm();
        bench.run(1_400);
        assert!(bench.device.force_n()[2] > 1.0, "the hand presses on the organ");
        // A malformed line in every tick: the driver never gets the silence it waits for, and the controller
        // latches a fault.
        let mut records = Vec::new();
        for _ in 0..30 {
            let (now_us, noise) = (bench.now_us(), b"noise noise\n");
            let readable = bench.driver_end.bytes_to_read().expect("open") as usize;
            palpate_hil::Transport::send(bench.link.inner_mut(), now_us, noise).expect("open");
            // A terminal that forwards it late would give the driver its silence.
            wait("noise", || {
                bench.driver_end.bytes_to_read().is_ok_and(|count| count as usize >= readable + noise.len())
            });
            records.push(bench.step().expect("the device is connected"));
        }
        assert_safe(&records);
        let last = records.last().expect("ticks ran");
        assert!(matches!(last.phase, Phase::SafeZero(_)), "{last:?}");
        assert_eq!(bench.device.force_n(), vec3::ZERO, "the zero of a fault reaches the device");
    });
}
