//! A guard on a thread with a scripted device: what it writes, and what the driver is told.
//!
//! The limit is long in tests that are not about silence, so that a busy machine does not trigger it; time is
//! real.

use crate::synthetic;
use assert_no_alloc::assert_no_alloc;
use palpate_core::{Config, Controller, Fault, Method, Organ, Phase, Sample, Vec3, vec3};
use palpate_host::device::fence::{Fence, GuardPath, Wire};
use palpate_host::guard::{GuardOptions, GuardSummary, Guarded, Guarding, guard};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::{Device, DeviceError, DeviceErrorKind, DeviceInfo};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Too long to be reached by accident.
const LONG_MS: u32 = 5_000;
const CERTAIN: Duration = Duration::from_secs(20);
const FORCE_N: Vec3 = [0.5, 0.0, -1.0];
const ZERO: &[u8] = b"zero!";

/// Record of the driver's inputs, and its scripted behaviour.
#[derive(Debug, Default)]
struct Script {
    forces: Vec<Vec3>,
    stops: usize,
    fails: Option<DeviceErrorKind>,
    position_m: Vec3,
}

type Shared = Arc<Mutex<Script>>;

fn lock(script: &Shared) -> std::sync::MutexGuard<'_, Script> {
    script.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A driver whose device a guard reaches by a socket.
struct Scripted {
    script: Shared,
    wire: Option<UnixStream>,
    fence: Fence,
}

impl Device for Scripted {
    fn exchange(&mut self, t_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let mut script = lock(&self.script);
        script.forces.push(force_n);
        match script.fails {
            Some(kind) => Err(DeviceError::new(kind)),
            None => Ok(Some(Sample { t_us, position_m: script.position_m, buttons: 1, ..Sample::default() })),
        }
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

    fn guard_path(&mut self, fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        fence.set_zero_message(ZERO);
        self.fence = fence.clone();
        let wire = self.wire.as_ref().map(UnixStream::try_clone).transpose()?;
        Ok(wire.map(|wire| GuardPath { fd: wire.into(), wire: Wire::Stream }))
    }
}

/// The guarded driver, and the device's end of the guard's wire.
struct Bench {
    device: Box<Guarded<Scripted>>,
    script: Shared,
    /// The guard's end of its wire, and the device's.
    near: UnixStream,
    wire: UnixStream,
    thread: JoinHandle<std::io::Result<GuardSummary>>,
    started: Instant,
}

impl Bench {
    fn new(limit_ms: u32) -> Self {
        let script = Shared::default();
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        let (near, wire) = UnixStream::pair().expect("sockets");
        near.set_nonblocking(true).expect("a setting");
        wire.set_nonblocking(true).expect("a setting");
        let driver = Scripted {
            script: Arc::clone(&script),
            wire: Some(near.try_clone().expect("a second handle")),
            fence: Fence::default(),
        };
        let thread = std::thread::spawn(move || guard(theirs));
        let options = GuardOptions { limit_ms, fifo_priority: None, locks_memory: false };
        let Guarding::Guarded(device) = Guarded::at(driver, ours, options).expect("a guard") else {
            panic!("the driver has a path")
        };
        Self { device, script, near, wire, thread, started: Instant::now() }
    }

    /// One tick; the force that the driver is given.
    fn tick(&mut self) -> Vec3 {
        let now_us = self.started.elapsed().as_micros() as u64;
        let sample = self.device.exchange(now_us, FORCE_N).expect("connected").expect("a sample");
        assert_eq!(sample.t_us, now_us, "a sample reaches the tick of its exchange");
        *lock(&self.script).forces.last().expect("an exchange")
    }

    /// The bytes that the guard has written since the last call.
    fn written(&mut self) -> Vec<u8> {
        written(&mut self.wire)
    }

    /// Ends the session's side.
    fn end(self) -> (GuardSummary, Vec<u8>, usize) {
        let Self { device, script, mut wire, thread, near, .. } = self;
        drop(near);
        drop(device);
        let summary = thread.join().expect("no panic").expect("a session");
        let stops = lock(&script).stops;
        (summary, written(&mut wire), stops)
    }
}

fn written(wire: &mut UnixStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    match wire.read_to_end(&mut bytes) {
        Err(error) if error.kind() != ErrorKind::WouldBlock => panic!("{error}"),
        _ => bytes,
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
fn while_the_loop_beats_the_guard_writes_nothing_and_delays_nothing() {
    let mut bench = Bench::new(LONG_MS);
    for _ in 0..200 {
        assert_eq!(bench.tick(), FORCE_N);
        std::thread::sleep(Duration::from_micros(200));
    }
    assert!(bench.written().is_empty() && !bench.device.was_zeroed());
    bench.device.stop();
    let (summary, last, stops) = bench.end();
    assert_eq!((summary, stops), (GuardSummary::default(), 1));
    assert_eq!(last, ZERO, "once more, whatever the driver has sent");
}

#[test]
fn silence_is_zeroed_once_per_limit_until_a_reset() {
    let mut bench = Bench::new(50);
    assert_eq!(bench.tick(), FORCE_N);
    let silent = Instant::now();
    let mut bytes = Vec::new();
    wait("three zeros", || {
        bytes.extend(bench.written());
        bytes.len() >= 3 * ZERO.len()
    });
    assert!(silent.elapsed() >= Duration::from_millis(145), "{:?}", silent.elapsed());
    assert_eq!(bytes, ZERO.repeat(3));
    // The loop resumes with its old force.
    assert_eq!(bench.tick(), vec3::ZERO);
    assert!(bench.device.was_zeroed() && !bench.device.was_zeroed(), "reported once");
    assert!((0..20).all(|_| bench.tick() == vec3::ZERO), "until a reset");
    // A busy machine may cause another silence before the tick that follows the reset.
    wait("the force again", || {
        bench.device.reset();
        bench.tick() == FORCE_N
    });
    let (summary, ..) = bench.end();
    assert!(summary.silences >= 1, "{summary:?}");
}

/// A thread of the driver that hangs or has died: the loop runs on, and its zeros reach nobody.
#[test]
fn a_driver_that_can_no_longer_write_is_zeroed_past_it() {
    let mut bench = Bench::new(50);
    assert_eq!(bench.tick(), FORCE_N);
    lock(&bench.script).fails = Some(DeviceErrorKind::Stalled);
    let mut bytes = Vec::new();
    wait("a zero while the loop runs", || {
        let _ = bench.device.exchange(0, vec3::ZERO);
        bytes.extend(bench.written());
        !bytes.is_empty()
    });
    assert_eq!(bytes, ZERO);
    assert!(bench.device.was_zeroed(), "the loop latches");
    bench.end();
}

/// Before the loop and after its end there is nothing to watch.
#[test]
fn a_pause_without_a_loop_is_no_silence() {
    let mut bench = Bench::new(20);
    std::thread::sleep(Duration::from_millis(100));
    assert!(bench.written().is_empty() && !bench.device.was_zeroed());
    bench.device.stop();
    std::thread::sleep(Duration::from_millis(100));
    assert!(bench.written().is_empty());
    assert_eq!(bench.end().0, GuardSummary::default());
}

/// A session that ends without stopping its device, as one that is killed.
#[test]
fn the_device_is_zeroed_when_the_session_is_gone() {
    let mut bench = Bench::new(LONG_MS);
    bench.tick();
    let (summary, last, _) = bench.end();
    assert!(summary.abandoned && summary.silences == 0, "{summary:?}");
    assert_eq!(last, ZERO.repeat(5), "one can be lost on the line");
}

#[test]
fn a_guard_that_ends_ends_the_loop() {
    let (ours, theirs) = UnixStream::pair().expect("sockets");
    let (near, _wire) = UnixStream::pair().expect("sockets");
    let script = Shared::default();
    let driver = Scripted { script: Arc::clone(&script), wire: Some(near), fence: Fence::default() };
    let ends = theirs.try_clone().expect("a second handle");
    let thread = std::thread::spawn(move || guard(theirs));
    let options = GuardOptions { limit_ms: LONG_MS, fifo_priority: None, locks_memory: false };
    let Guarding::Guarded(mut device) = Guarded::at(driver, ours, options).expect("a guard") else {
        panic!("the driver has a path")
    };
    assert!(device.exchange(0, FORCE_N).is_ok());
    ends.shutdown(std::net::Shutdown::Both).expect("it is open");
    thread.join().expect("no panic").expect("a session");
    let mut error = None;
    wait("an error", || {
        error = device.exchange(1, FORCE_N).err();
        error.is_some()
    });
    let kind = error.map(|error| error.kind());
    assert_eq!(kind, Some(DeviceErrorKind::GuardLost));
    assert!(kind.is_some_and(|kind| !kind.is_transient()), "the loop ends, and stops the device");
}

/// Its line is full: the zero arrives soon after there is room, not one limit later.
#[test]
fn a_refused_zero_is_repeated_until_the_line_accepts_it() {
    const LIMIT_MS: u64 = 2_000;
    let mut bench = Bench::new(LIMIT_MS as u32);
    bench.tick();
    let mut filler = bench.near.try_clone().expect("a second handle");
    while filler.write(&[b'.'; 4096]).is_ok() {}
    std::thread::sleep(Duration::from_millis(LIMIT_MS + 100));
    let begun = Instant::now();
    let mut bytes = Vec::new();
    wait("a zero", || {
        bytes.extend(bench.written());
        bytes.ends_with(ZERO)
    });
    assert!(begun.elapsed() < Duration::from_millis(LIMIT_MS / 2), "{:?}", begun.elapsed());
    bench.end();
}

#[test]
fn a_device_without_a_path_needs_no_guard() {
    let (ours, _theirs) = UnixStream::pair().expect("sockets");
    let driver = Scripted { script: Shared::default(), wire: None, fence: Fence::default() };
    let options = GuardOptions { limit_ms: LONG_MS, fifo_priority: None, locks_memory: false };
    assert!(matches!(Guarded::at(driver, ours, options), Ok(Guarding::Unneeded(_))));
}

#[test]
fn errors_of_the_driver_pass_unchanged() {
    let mut bench = Bench::new(LONG_MS);
    for kind in [DeviceErrorKind::Timeout, DeviceErrorKind::BadFrame, DeviceErrorKind::Disconnected] {
        lock(&bench.script).fails = Some(kind);
        assert_eq!(bench.device.exchange(0, FORCE_N).map_err(|error| error.kind()), Err(kind));
    }
    bench.end();
}

#[test]
fn an_exchange_does_not_allocate() {
    let mut bench = Bench::new(LONG_MS);
    lock(&bench.script).forces.reserve(10_000);
    bench.tick();
    let started = bench.started;
    assert_no_alloc(|| {
        for _ in 0..2_000 {
            let now_us = started.elapsed().as_micros() as u64;
            let _ = bench.device.exchange(now_us, FORCE_N);
            let _ = bench.device.was_zeroed();
            bench.device.reset();
        }
    });
    bench.end();
}

/// With the core's controller: a silence latches the watchdog's fault, and keys pressed during it are ignored.
#[test]
fn a_loop_that_resumes_latches_a_watchdog_fault() {
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller: Controller<'_, '_> =
        Controller::new(&organ, Config::new(Method::Hybrid)).expect("has the method");
    let Bench { device, script, mut wire, thread, .. } = Bench::new(50);
    let normal = organ.spaces[0].active.outward_normal;
    let rest_m = organ.spaces[0].active.rest_position_m;
    let (records, mut drained) = rtrb::RingBuffer::new(100_000);
    let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls) = (VirtualClock::default(), Controls::default());
    let outputs = Outputs { records, latest };
    // The device is boxed, as on the command line.
    let device: Box<dyn Device> = device;
    let mut haptic = HapticLoop::new(controller, device, &clock, LoopConfig::default(), &controls, outputs);
    let mut index = 0;
    let mut step = |height_m: f32| {
        index += 1;
        lock(&script).position_m = vec3::add(rest_m, vec3::scale(normal, height_m));
        clock.wait_until(index * 1_000_000, 0);
        haptic.tick(index, 0, index * 1_000_000).expect("connected");
        std::thread::sleep(Duration::from_micros(100));
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
    written(&mut wire);
    wait("zero", || !written(&mut wire).is_empty());
    // Keys pressed during the stall.
    controls.reset();
    controls.arm();
    let mut faulted = false;
    for _ in 0..100 {
        let record = step(-0.007);
        faulted |= record.phase == Phase::SafeZero(Fault::Watchdog);
        assert!(faulted, "{:?}", record.phase);
        assert_eq!(lock(&script).forces.last(), Some(&vec3::ZERO));
    }
    drop(haptic);
    thread.join().expect("no panic").expect("a session");
}
