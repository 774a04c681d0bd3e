//! A supervisor on a thread with a scripted device: effects of valid and invalid datagrams.
//!
//! The limit is long in tests that are not about silence, so that a busy machine does not trigger it; time is
//! real.

use crate::synthetic;
use assert_no_alloc::assert_no_alloc;
use palpate_core::{Config, Controller, Fault, Method, Organ, Phase, Sample, Vec3, vec3};
use palpate_host::device::{DeviceState, EmergencyStop};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::supervisor::wire::{Order, OrderMessage, Report};
use palpate_host::supervisor::{ServeSummary, StartError, Supervised, serve};
use palpate_host::sys::{self, Policy};
use palpate_host::{Device, DeviceError, DeviceErrorKind, DeviceInfo};
use std::os::fd::AsFd;
use std::os::unix::net::UnixDatagram;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Too long to be reached by accident.
const LONG_MS: u32 = 5_000;
const CERTAIN: Duration = Duration::from_secs(20);
const FORCE_N: Vec3 = [0.5, 0.0, -1.0];

/// Record of the device's inputs, and its scripted behaviour.
#[derive(Debug, Default)]
struct Script {
    forces: Vec<Vec3>,
    stops: usize,
    zeros: usize,
    /// Number of coming zeros on the emergency path that fail.
    refusals: u32,
    /// Whether the next exchange hangs, until this is false again.
    hangs: bool,
    panics: bool,
    fails: Option<DeviceErrorKind>,
    position_m: Vec3,
    state: Option<DeviceState>,
}

type Shared = Arc<Mutex<Script>>;

fn lock(script: &Shared) -> std::sync::MutexGuard<'_, Script> {
    script.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Replies to each request in the next exchange, like a real device.
struct Scripted {
    script: Shared,
    requested_us: Option<u64>,
}

struct EmergencyPath(Shared);

impl EmergencyStop for EmergencyPath {
    fn zero(&mut self) -> Result<(), DeviceError> {
        let mut script = lock(&self.0);
        if let Some(fewer) = script.refusals.checked_sub(1) {
            script.refusals = fewer;
            return Err(DeviceError::new(DeviceErrorKind::Timeout));
        }
        script.zeros += 1;
        script.forces.push(vec3::ZERO);
        Ok(())
    }
}

impl Device for Scripted {
    fn exchange(&mut self, now_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        while lock(&self.script).hangs {
            std::thread::sleep(Duration::from_micros(200));
        }
        let mut script = lock(&self.script);
        if script.panics {
            drop(script);
            panic!("injected panic");
        }
        script.forces.push(force_n);
        if let Some(kind) = script.fails {
            return Err(DeviceError::new(kind));
        }
        let position_m = script.position_m;
        let answered = self.requested_us.replace(now_us);
        Ok(answered.map(|t_us| Sample { t_us, position_m, buttons: 1 }))
    }

    fn stop(&mut self) {
        let mut script = lock(&self.script);
        script.stops += 1;
        script.forces.push(vec3::ZERO);
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "scripted".into(),
            self_arming: false,
            max_force_n: 4.0,
            max_stiffness_n_m: 900.0,
            resolution_m: 1e-5,
        }
    }

    fn state(&self) -> DeviceState {
        lock(&self.script).state.unwrap_or(DeviceState::Homed)
    }

    fn emergency_stop(&mut self) -> Option<Box<dyn EmergencyStop>> {
        Some(Box::new(EmergencyPath(Arc::clone(&self.script))))
    }
}

/// Both ends of the socket.
struct Bench {
    device: Supervised,
    script: Shared,
    thread: JoinHandle<std::io::Result<ServeSummary>>,
    /// A second handle of the host's end, for datagrams that are not from the host.
    foreign: UnixDatagram,
    started: Instant,
}

impl Bench {
    fn new(limit_ms: u32) -> Self {
        let script = Shared::default();
        let (ours, theirs) = UnixDatagram::pair().expect("a socket pair");
        let foreign = ours.try_clone().expect("a second handle");
        let scripted = Scripted { script: Arc::clone(&script), requested_us: None };
        let thread = std::thread::spawn(move || serve(&theirs, Policy::Fifo(51), || Ok(scripted)));
        let device = Supervised::with_socket(ours, limit_ms).expect("it opens");
        Self { device, script, thread, foreign, started: Instant::now() }
    }

    fn now_us(&self) -> u64 {
        self.started.elapsed().as_micros() as u64
    }

    /// One tick; waits until the device has exchanged.
    fn tick(&mut self, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let (before, now_us) = (lock(&self.script).forces.len(), self.now_us());
        let sample = self.device.exchange(now_us, force_n)?;
        wait("exchange", || lock(&self.script).forces.len() > before);
        Ok(sample)
    }

    fn last_n(&self) -> Vec3 {
        lock(&self.script).forces.last().copied().unwrap_or_default()
    }

    /// Ends the host's side.
    fn end(self) -> (ServeSummary, Shared) {
        drop((self.device, self.foreign));
        (self.thread.join().expect("no panic").expect("a host"), self.script)
    }
}

fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let started = Instant::now();
    while !done() {
        assert!(started.elapsed() < CERTAIN, "no {what}");
        std::thread::sleep(Duration::from_micros(100));
    }
}

#[test]
fn forces_arrive_and_samples_have_the_time_of_their_request() {
    let mut bench = Bench::new(LONG_MS);
    assert_eq!(bench.device.info().name, "scripted");
    assert_eq!((bench.device.info().max_force_n, bench.device.state()), (4.0, DeviceState::Homed));
    let supervision = bench.device.supervision();
    assert_eq!((supervision.limit_ms, supervision.policy), (LONG_MS, Policy::Fifo(51)));
    let mut ticks_us = Vec::new();
    let mut samples_us = Vec::new();
    for i in 0..200 {
        lock(&bench.script).position_m = [i as f32, 0.0, 0.0];
        ticks_us.push(bench.now_us());
        if let Some(sample) = bench.device.exchange(ticks_us[i], FORCE_N).expect("connected") {
            samples_us.push(sample.t_us);
        }
        wait("exchange", || lock(&bench.script).forces.len() > i);
        assert_eq!(bench.last_n(), FORCE_N);
        std::thread::sleep(Duration::from_micros(300));
    }
    assert!(samples_us.len() > 150, "{}", samples_us.len());
    assert!(samples_us.windows(2).all(|pair| pair[1] > pair[0]), "in ascending order");
    assert!(samples_us.iter().all(|t_us| ticks_us.contains(t_us)), "equal to times of ticks");
    let (summary, script) = bench.end();
    assert_eq!((summary.exchanges, summary.silences, summary.strays, summary.abandoned), (200, 0, 0, false));
    assert_eq!(lock(&script).forces.last(), Some(&vec3::ZERO));
    assert!(lock(&script).stops >= 1);
}

/// Counted in exchanges, independent of the clock: a tick's force reaches the device in that tick. A sample
/// arrives one exchange later than without a supervisor.
#[test]
fn a_supervisor_delays_samples_by_exactly_one_tick() {
    let lags = |device: &mut dyn Device, settle: &dyn Fn(u64)| -> Vec<u64> {
        let lag = |tick: u64, device: &mut dyn Device| {
            let sample = device.exchange(1_000 * tick, [tick as f32, 0.0, 0.0]).expect("connected");
            settle(tick);
            sample.map(|sample| tick - sample.t_us / 1_000)
        };
        (0..200).filter_map(|tick| lag(tick, device)).collect()
    };
    let script = Shared::default();
    let direct = lags(&mut Scripted { script, requested_us: None }, &|_| ());
    assert_eq!(direct, vec![1; 199]);

    let Bench { mut device, script, thread, foreign, .. } = Bench::new(LONG_MS);
    let settle = |tick: u64| {
        wait("report", || {
            sys::wait_readable(foreign.as_fd(), Duration::from_millis(50))
                && lock(&script).forces.len() > tick as usize
        });
        assert_eq!(lock(&script).forces.last(), Some(&[tick as f32, 0.0, 0.0]), "in its own tick");
        // No two exchanges may have the same time in microseconds.
        std::thread::sleep(Duration::from_micros(50));
    };
    let supervised = lags(&mut device, &settle);
    assert_eq!(supervised, vec![2; 198]);
    drop(device);
    thread.join().expect("no panic").expect("a host");
}

/// The device's reply is delayed and the report arrives many ticks later: the sample has the time of its
/// request.
#[test]
fn a_late_report_is_not_taken_for_a_recent_one() {
    let mut bench = Bench::new(LONG_MS);
    bench.tick(FORCE_N).expect("connected");
    bench.tick(FORCE_N).expect("connected");
    let requested_us = bench.now_us();
    bench.device.exchange(requested_us, FORCE_N).expect("connected");
    std::thread::sleep(Duration::from_millis(5));
    lock(&bench.script).hangs = true;
    bench.device.exchange(bench.now_us(), FORCE_N).expect("connected");
    std::thread::sleep(Duration::from_millis(50));
    // Discard the reports from before the hang.
    while bench.device.exchange(bench.now_us(), FORCE_N).expect("connected").is_some() {}
    lock(&bench.script).hangs = false;
    let mut late = None;
    wait("late report", || {
        late = bench.device.exchange(bench.started.elapsed().as_micros() as u64, FORCE_N).unwrap_or_default();
        late.is_some()
    });
    let late = late.expect("a sample");
    assert!(
        late.t_us <= requested_us + 40_000 && bench.now_us() - late.t_us > 10_000,
        "{late:?} asked at {requested_us}"
    );
    bench.end();
}

#[test]
fn silence_zeroes_the_device_until_a_reset() {
    let mut bench = Bench::new(10);
    for _ in 0..20 {
        bench.tick(FORCE_N).expect("connected");
        if bench.device.was_zeroed() {
            bench.device.reset();
        }
    }
    let zeros = lock(&bench.script).zeros;
    let since = Instant::now();
    wait("zero", || lock(&bench.script).zeros > zeros);
    println!("silence: zero after {:.1} ms", since.elapsed().as_secs_f64() * 1e3);
    assert!(since.elapsed() >= Duration::from_millis(9), "not before the limit");
    // The zero is repeated, because it may be lost on the line.
    wait("zero again", || lock(&bench.script).zeros > zeros + 2);
    assert_eq!(bench.last_n(), vec3::ZERO);

    let mut zeroed = false;
    for _ in 0..50 {
        bench.tick(FORCE_N).expect("connected");
        zeroed |= bench.device.was_zeroed();
        assert_eq!(bench.last_n(), vec3::ZERO, "only a heartbeat");
    }
    assert!(zeroed && bench.device.supervision().zeroed() >= 1);
    wait("force after the reset", || {
        bench.device.reset();
        bench.tick(FORCE_N).expect("connected");
        bench.last_n() == FORCE_N
    });
    bench.end();
}

/// Orders of another host, old numbers, arbitrary bytes of any length: the device does not move, and they do
/// not count as heartbeats.
#[test]
fn foreign_datagrams_have_no_effect() {
    let mut bench = Bench::new(LONG_MS);
    bench.tick(FORCE_N).expect("connected");
    let before = lock(&bench.script).forces.len();
    let zeros = lock(&bench.script).zeros;
    let order = |nonce, number, order| OrderMessage { nonce, number, sent_ns: u64::MAX, order }.encode();
    let mut sent = 0;
    let mut seed = 1_u64;
    for round in 0..300_usize {
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 33) as u32
        };
        let mut bytes: Vec<u8> = match round % 3 {
            0 => (0..round).map(|_| random() as u8).collect(),
            1 => order(random(), u64::MAX, Order::Zero).to_vec(),
            _ => order(random(), u64::MAX, Order::Tick { session: 0, force_n: [3.0; 3] }).to_vec(),
        };
        if round % 6 == 5 {
            bytes.truncate(round % 48);
        }
        wait("room", || bench.foreign.send(&bytes).is_ok());
        sent += 1;
    }
    // After them in the queue.
    let mut done = false;
    wait("force after the foreign datagrams", || {
        done = bench.tick(FORCE_N).is_ok() && lock(&bench.script).forces.len() > before;
        done
    });
    assert_eq!(bench.last_n(), FORCE_N);
    assert!(lock(&bench.script).forces[before..].iter().all(|force_n| *force_n == FORCE_N));
    assert_eq!(lock(&bench.script).zeros, zeros);
    let (summary, _) = bench.end();
    assert_eq!((summary.strays, summary.silences), (sent, 0));
}

/// In the other direction: a datagram that is not a report of this supervisor gives no sample.
#[test]
fn a_host_accepts_reports_of_its_own_supervisor_only() {
    let (ours, theirs) = UnixDatagram::pair().expect("a socket pair");
    let foreign = theirs.try_clone().expect("a second handle");
    let script = Shared::default();
    let scripted = Scripted { script: Arc::clone(&script), requested_us: None };
    let thread = std::thread::spawn(move || serve(&theirs, Policy::Other, || Ok(scripted)));
    let mut device = Supervised::with_socket(ours, LONG_MS).expect("it opens");
    let lie = Report {
        answers: 1,
        session: 9,
        stopped: false,
        device: DeviceState::Disconnected,
        place: None,
        error: Some(DeviceError::new(DeviceErrorKind::Disconnected)),
    };
    for nonce in 0..5 {
        foreign.send(&lie.encode(nonce)).expect("room");
        foreign.send(&[0x55; 64][..usize::try_from(nonce).expect("small") * 12]).expect("room");
        let received = device.exchange(u64::from(nonce), FORCE_N).expect("no error");
        assert!(received.is_none_or(|sample| sample.t_us < u64::from(nonce)));
        assert!(!device.was_zeroed() && device.state() == DeviceState::Homed);
        wait("exchange", || lock(&script).forces.len() > nonce as usize);
    }
    drop(device);
    thread.join().expect("no panic").expect("a host");
}

#[test]
fn the_watchdog_path_zeroes_the_device_and_ends_the_session() {
    let mut bench = Bench::new(LONG_MS);
    bench.tick(FORCE_N).expect("connected");
    let mut path = (&mut bench.device as &mut dyn Device).emergency_stop().expect("an emergency stop");
    path.zero().expect("room");
    wait("zero", || lock(&bench.script).zeros == 1);
    path.zero().expect("room");
    wait("zero", || lock(&bench.script).zeros == 2);
    for _ in 0..20 {
        bench.tick(FORCE_N).expect("connected");
        assert_eq!(bench.last_n(), vec3::ZERO);
    }
    assert!(bench.device.was_zeroed() && !bench.device.was_zeroed());
    assert_eq!(bench.device.supervision().zeroed(), 1, "two zeros end one session");
    bench.device.reset();
    bench.tick(FORCE_N).expect("connected");
    assert_eq!(bench.last_n(), FORCE_N);
    bench.end();
}

#[test]
fn the_device_is_stopped_when_the_host_is_gone() {
    let mut bench = Bench::new(10);
    bench.tick(FORCE_N).expect("connected");
    // Every handle of the socket is closed without a Leave order, as by a killed process.
    let Bench { device, script, thread, foreign, .. } = bench;
    drop(foreign);
    std::mem::forget(device);
    // The socket of the forgotten device is still open: the host is silent.
    wait("zero", || lock(&script).zeros > 0);
    assert_eq!(lock(&script).forces.last(), Some(&vec3::ZERO));
    drop(thread);

    let (ours, theirs) = UnixDatagram::pair().expect("a socket pair");
    let script = Shared::default();
    let scripted = Scripted { script: Arc::clone(&script), requested_us: None };
    let thread = std::thread::spawn(move || serve(&theirs, Policy::Other, || Ok(scripted)));
    let order = |number, order| {
        let sent_ns = palpate_host::sys::monotonic_ns();
        OrderMessage { nonce: 3, number, sent_ns, order }.encode()
    };
    ours.send(&order(1, Order::Hello { limit_us: 500_000 })).expect("room");
    ours.send(&order(2, Order::Tick { session: 0, force_n: FORCE_N })).expect("room");
    wait("force", || lock(&script).forces.last() == Some(&FORCE_N));
    // The line accepts nothing for a while: the last zero is retried until it is sent.
    lock(&script).refusals = 20;
    drop(ours);
    let summary = thread.join().expect("no panic").expect("a host");
    assert!(summary.abandoned, "{summary:?}");
    let script = lock(&script);
    assert_eq!((script.refusals, script.zeros), (0, 1));
    assert_eq!((script.forces.last(), script.stops), (Some(&vec3::ZERO), 1));
}

#[test]
fn a_panic_of_the_supervisor_zeroes_the_force_and_disconnects_the_host() {
    let mut bench = Bench::new(LONG_MS);
    bench.tick(FORCE_N).expect("connected");
    lock(&bench.script).panics = true;
    let mut end = None;
    wait("end", || {
        end = bench.device.exchange(bench.started.elapsed().as_micros() as u64, FORCE_N).err();
        end.is_some_and(|error| !error.kind().is_transient())
    });
    assert_eq!(end.map(|error| error.kind()), Some(DeviceErrorKind::Disconnected));
    assert_eq!(bench.device.state(), DeviceState::Disconnected);
    assert_eq!((bench.last_n(), lock(&bench.script).stops), (vec3::ZERO, 1));
    assert!(bench.thread.join().is_err());
}

#[test]
fn errors_of_the_device_reach_the_loop_unchanged() {
    let mut bench = Bench::new(LONG_MS);
    for kind in [DeviceErrorKind::BadFrame, DeviceErrorKind::Timeout, DeviceErrorKind::Disconnected] {
        lock(&bench.script).fails = Some(kind);
        let mut seen = None;
        wait("error", || {
            seen = bench.device.exchange(bench.started.elapsed().as_micros() as u64, FORCE_N).err();
            seen.is_some_and(|error| error.kind() == kind)
        });
    }
    lock(&bench.script).fails = None;
    bench.end();

    let (ours, theirs) = UnixDatagram::pair().expect("a socket pair");
    let thread = std::thread::spawn(move || {
        serve(&theirs, Policy::Other, || Err::<Scripted, _>("no port; plug it in".into()))
    });
    let refused = Supervised::with_socket(ours, 10);
    assert!(
        matches!(&refused, Err(StartError::Refused(text)) if text == "no port; plug it in"),
        "{refused:?}"
    );
    thread.join().expect("no panic").expect("a host");
}

#[test]
fn an_exchange_neither_allocates_nor_blocks() {
    let mut bench = Bench::new(LONG_MS);
    bench.tick(FORCE_N).expect("connected");
    let (started, mut samples) = (bench.started, 0);
    assert_no_alloc(|| {
        for _ in 0..2_000 {
            let now_us = started.elapsed().as_micros() as u64;
            samples += u64::from(matches!(bench.device.exchange(now_us, FORCE_N), Ok(Some(_))));
            let _ = bench.device.was_zeroed();
            bench.device.reset();
            std::thread::sleep(Duration::from_micros(100));
        }
    });
    assert!(samples > 100, "{samples}");
    // The supervisor does not reply and the queue fills up: exchanges fail, but do not block.
    lock(&bench.script).hangs = true;
    let mut longest = Duration::ZERO;
    let mut full = 0;
    for _ in 0..1_000 {
        let (at, now_us) = (Instant::now(), bench.now_us());
        full +=
            u64::from(bench.device.exchange(now_us, FORCE_N).is_err_and(|error| error.kind().is_transient()));
        longest = longest.max(at.elapsed());
    }
    println!("longest of 1000 exchanges with a full queue: {longest:?}, {full} of them refused");
    assert!(full > 500 && longest < Duration::from_millis(500));
    lock(&bench.script).hangs = false;
    bench.end();
}

/// With the core's controller: a silence latches the watchdog's fault, and keys pressed during it are
/// ignored.
#[test]
fn a_loop_that_resumes_latches_a_watchdog_fault() {
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller: Controller<'_, '_> =
        Controller::new(&organ, Config::new(Method::Hybrid)).expect("has the method");
    let Bench { device, script, thread, foreign, .. } = Bench::new(50);
    let normal = organ.spaces[0].active.outward_normal;
    let rest_m = organ.spaces[0].active.rest_position_m;
    let (records, mut drained) = rtrb::RingBuffer::new(100_000);
    let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let outputs = Outputs { records, latest };
    // The device is boxed, as on the command line.
    let device: Box<dyn Device> = Box::new(device);
    let mut haptic = HapticLoop::new(controller, device, &clock, LoopConfig::default(), &controls, outputs);
    let mut index = 0;
    let mut step = |height_m: f32| {
        index += 1;
        let before = {
            let mut script = lock(&script);
            script.position_m = vec3::add(rest_m, vec3::scale(normal, height_m));
            script.forces.len()
        };
        clock.wait_until(index * 1_000_000, 0);
        haptic.tick(index, 0, index * 1_000_000).expect("connected");
        wait("exchange", || lock(&script).forces.len() > before);
        // Its report too.
        std::thread::sleep(Duration::from_micros(300));
        drained.pop().expect("one record a tick")
    };
    assert_eq!(step(0.005).phase, Phase::Disarmed);
    // On a busy machine this may itself cause a silence: then repeat it.
    let mut lean = || {
        loop {
            let phase = step(0.005).phase;
            if phase != Phase::Disarmed {
                controls.reset();
                continue;
            }
            controls.arm();
            if (0..1_000).all(|i| step(0.005 - 12e-6 * i as f32).phase == Phase::Active) {
                return;
            }
        }
    };
    lean();
    assert!(
        vec3::norm(lock(&script).forces.last().copied().unwrap_or_default()) > 0.3,
        "the organ exerts a force"
    );
    let zeros = lock(&script).zeros;
    wait("zero", || lock(&script).zeros > zeros);
    // Keys pressed during the stall.
    controls.reset();
    controls.arm();
    let mut faulted = false;
    for _ in 0..100 {
        let record = step(-0.007);
        faulted |= record.phase == Phase::SafeZero(Fault::Watchdog);
        assert!(faulted || record.phase == Phase::Active, "{:?}", record.phase);
        assert_eq!(lock(&script).forces.last(), Some(&vec3::ZERO));
    }
    assert!(faulted);
    drop((haptic, foreign));
    thread.join().expect("no panic").expect("a host");
}
