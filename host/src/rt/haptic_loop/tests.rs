//! The loop on a virtual clock, with a probe device.

use super::*;
use crate::device::{DeviceErrorKind, DeviceInfo};
use crate::rt::clock::VirtualClock;
use crate::synthetic::{self, Shape};
use palpate_core::{Config, Fault, Method, Organ, Sample};
use std::sync::Mutex;
use std::sync::atomic::AtomicU64;

type Forces = Mutex<Vec<Vec3>>;

/// Presses into the first node and records every force it receives; a stop is recorded as zero.
struct Probe<'t, F> {
    forces: &'t Forces,
    rest_m: Vec3,
    normal: Vec3,
    self_arming: bool,
    each: F,
    calls: u64,
}

impl<F: FnMut(u64) -> Result<bool, DeviceError> + Send> Device for Probe<'_, F> {
    fn exchange(&mut self, now_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.calls += 1;
        self.forces.lock().expect("one thread").push(force_n);
        let depth_m = 1e-3 - 1e-5 * self.calls as f32;
        let position_m = vec3::add(self.rest_m, vec3::scale(self.normal, depth_m.max(-0.012)));
        let answers = (self.each)(self.calls)?;
        let buttons = u32::from(self.calls > 100) << 3;
        Ok(answers.then_some(Sample { t_us: now_us, position_m, buttons, ..Sample::default() }))
    }

    fn stop(&mut self) {
        self.forces.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(vec3::ZERO);
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "probe".into(),
            self_arming: self.self_arming,
            max_force_n: 8.0,
            max_stiffness_n_m: 1e3,
            resolution_m: 0.0,
        }
    }
}

struct Run {
    outcome: LoopOutcome,
    records: Vec<TickRecord>,
    forces: Vec<Vec3>,
}

struct Bench {
    periods: u64,
    config: LoopConfig,
    self_arming: bool,
    queue: usize,
}

impl Default for Bench {
    fn default() -> Self {
        let config = LoopConfig::default();
        Self { periods: 3_000, config, self_arming: true, queue: 100_000 }
    }
}

impl Bench {
    fn run(
        &self,
        clock: impl Clock,
        controls: &Controls,
        stop: &AtomicBool,
        each: impl FnMut(u64) -> Result<bool, DeviceError> + Send,
    ) -> Run {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let controller = Controller::new(&organ, Config::new(Method::Tricubic)).expect("has the method");
        let (records, mut drained) = rtrb::RingBuffer::new(self.queue);
        let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
        let forces = Forces::default();
        let device = Probe {
            forces: &forces,
            rest_m: organ.spaces[0].active.rest_position_m,
            normal: organ.spaces[0].active.outward_normal,
            self_arming: self.self_arming,
            each,
            calls: 0,
        };
        let outputs = Outputs { records, latest };
        let haptic = HapticLoop::new(controller, device, clock, self.config, controls, outputs);
        let outcome = haptic.run(stop, self.periods);
        let records = core::iter::from_fn(|| drained.pop().ok()).collect();
        Run { outcome, records, forces: forces.into_inner().expect("one thread") }
    }
}

/// A clock on which the tick with this number takes `stall_ns`.
struct Stalling<'t> {
    clock: VirtualClock,
    calls: &'t AtomicU64,
    stall_ns: fn(u64) -> u64,
}

impl Clock for Stalling<'_> {
    fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    fn wait_until(&self, deadline_ns: u64, spin_ns: u64) {
        self.clock.wait_until(deadline_ns, spin_ns);
        let tick = self.calls.fetch_add(1, Ordering::Relaxed);
        self.clock.advance_ns((self.stall_ns)(tick));
    }
}

#[test]
fn a_press_is_rendered_and_the_last_force_is_zero() {
    let run =
        Bench::default()
            .run(VirtualClock::default(), &Controls::default(), &AtomicBool::new(false), |_| Ok(true));
    assert_eq!(run.outcome.end, LoopEnd::Completed);
    assert_eq!((run.outcome.ticks, run.records.len() as u64), (3_000, 3_000));
    assert!(run.records.windows(2).all(|pair| pair[1].tick == pair[0].tick + 1));
    assert!(vec3::norm(run.forces[run.forces.len() - 2]) > 1.0, "the organ pushes back");
    assert_eq!(run.forces.last(), Some(&vec3::ZERO));
}

#[test]
fn the_stop_flag_ends_the_loop_with_zero_force() {
    let stop = AtomicBool::new(false);
    let run = Bench::default().run(VirtualClock::default(), &Controls::default(), &stop, |call| {
        stop.store(call == 1_500, Ordering::Relaxed);
        Ok(true)
    });
    assert_eq!((run.outcome.end, run.outcome.ticks), (LoopEnd::Stopped, 1_500));
    assert!(vec3::norm(run.forces[run.forces.len() - 2]) > 0.5);
    assert_eq!(run.forces.last(), Some(&vec3::ZERO));
}

#[test]
fn an_overrun_skips_the_deadlines_that_have_passed() {
    let calls = AtomicU64::new(0);
    // Tick 100 is 3.4 ms late: deadlines 101, 102 and 103 have passed when it ends.
    let clock = Stalling {
        clock: VirtualClock::default(),
        calls: &calls,
        stall_ns: |tick| if tick == 100 { 3_400_000 } else { 0 },
    };
    let run = Bench { periods: 200, ..Bench::default() }.run(
        clock,
        &Controls::default(),
        &AtomicBool::new(false),
        |_| Ok(true),
    );
    let numbers: Vec<u64> = run.records.iter().map(|record| record.tick).collect();
    assert_eq!(numbers[99..103], [99, 100, 104, 105]);
    assert_eq!(run.outcome.ticks, 197);
    let report = run.outcome.latency.report();
    assert_eq!((report.overruns, report.skipped_periods), (1, 3));
    assert_eq!(report.first_overruns, [100]);
    assert!((report.wake.max_ns as f64 / 3.4e6 - 1.0).abs() < 2e-3);
    assert_eq!(run.records.last().map(|record| record.skipped_periods), Some(3));
}

#[test]
fn a_full_queue_drops_and_counts_without_blocking() {
    let bench = Bench { periods: 500, queue: 64, ..Bench::default() };
    let run = bench.run(VirtualClock::default(), &Controls::default(), &AtomicBool::new(false), |_| Ok(true));
    assert_eq!((run.records.len(), run.outcome.dropped_records), (64, 436));
}

#[test]
fn a_real_device_has_no_force_until_armed() {
    let controls = Controls::default();
    let bench = Bench { self_arming: false, ..Bench::default() };
    let never = bench.run(VirtualClock::default(), &controls, &AtomicBool::new(false), |_| Ok(true));
    assert!(never.forces.iter().all(|force| *force == vec3::ZERO));
    assert_eq!(never.outcome.phase, Phase::Disarmed);

    let by_key = bench.run(VirtualClock::default(), &controls, &AtomicBool::new(false), |call| {
        if call == 50 {
            controls.arm();
        }
        Ok(true)
    });
    assert_eq!(by_key.outcome.phase, Phase::Active);
    assert!(by_key.forces.iter().any(|force| vec3::norm(*force) > 1.0));

    let config = LoopConfig { arm_button: 8, ..LoopConfig::default() };
    let by_button = Bench { self_arming: false, config, ..Bench::default() }.run(
        VirtualClock::default(),
        &Controls::default(),
        &AtomicBool::new(false),
        |_| Ok(true),
    );
    assert_eq!(by_button.records[99].phase, Phase::Disarmed);
    assert_eq!(by_button.records[100].phase, Phase::Active);
}

#[test]
fn missing_samples_latch_a_fault_until_reset_and_armed() {
    let controls = Controls::default();
    let run =
        Bench::default().run(
            VirtualClock::default(),
            &controls,
            &AtomicBool::new(false),
            |call| match call {
                1_000..1_030 => Err(DeviceError::new(DeviceErrorKind::Timeout)),
                1_030..1_040 => Ok(false),
                2_000 => {
                    controls.reset();
                    controls.arm();
                    Ok(true)
                }
                _ => Ok(true),
            },
        );
    assert_eq!(run.outcome.device_errors, 30);
    assert_eq!(run.records[998].phase, Phase::Active);
    for record in &run.records[1_015..1_999] {
        assert_eq!(record.phase, Phase::SafeZero(Fault::Stale));
        assert_eq!(record.hand_force_n, vec3::ZERO);
    }
    assert_eq!(run.outcome.phase, Phase::Active);
}

/// Tick 1,500 hangs in its exchange for 60 ms of virtual time: the report attributes the time to the device.
#[test]
fn a_stall_is_attributed_to_the_device() {
    let (controls, clock) = (Controls::default(), VirtualClock::default());
    let run = Bench::default().run(&clock, &controls, &AtomicBool::new(false), |call| {
        clock.advance_ns(if call == 1_500 { 62_000_000 } else { 0 });
        Ok(true)
    });
    let report = run.outcome.latency.report();
    let worst = report.worst.first().expect("deadlines were missed");
    assert_eq!((worst.tick, worst.times.device_ns, worst.times.compute_ns), (1_499, 62_000_000, 0));
    assert_eq!(worst.late_ns, 61_000_000);
    assert!(report.device.max_ns > 61_000_000 && report.compute.max_ns == 0, "{report}");
}

#[test]
fn a_lost_device_ends_the_loop_at_once() {
    let lost = DeviceError::new(DeviceErrorKind::Disconnected);
    let run = Bench::default().run(
        VirtualClock::default(),
        &Controls::default(),
        &AtomicBool::new(false),
        |call| {
            if call == 700 { Err(lost) } else { Ok(true) }
        },
    );
    assert_eq!((run.outcome.end, run.outcome.ticks), (LoopEnd::DeviceLost(lost), 699));
    assert_eq!(run.forces.last(), Some(&vec3::ZERO));
}

#[test]
fn the_newest_record_reaches_the_viewer() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller = Controller::new(&organ, Config::new(Method::Hybrid)).expect("has the method");
    let (records, _drained) = rtrb::RingBuffer::new(8);
    let (latest, mut seen) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (forces, controls) = (Forces::default(), Controls::default());
    let device = Probe {
        forces: &forces,
        rest_m: vec3::ZERO,
        normal: vec3::ZERO,
        self_arming: true,
        each: |_| Ok(true),
        calls: 0,
    };
    let mut haptic = HapticLoop::new(
        controller,
        device,
        VirtualClock::default(),
        LoopConfig::default(),
        &controls,
        Outputs { records, latest },
    );
    for index in 0..5 {
        haptic.tick(index, 0, index * 1_000_000).expect("the probe answers");
        assert_eq!(seen.read().tick, index);
    }
}

/// Reports at some calls that it was zeroed by another path, and counts its resets.
struct Latching<'t> {
    calls: u64,
    zeroed_at: [u64; 2],
    resets: &'t AtomicU64,
    /// Calls at which the cause of the latch lasts.
    lasting: std::ops::Range<u64>,
}

impl Device for Latching<'_> {
    fn exchange(&mut self, now_us: u64, _: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.calls += 1;
        Ok(Some(Sample { t_us: now_us, position_m: [0.3, 0.0, 0.0], ..Sample::default() }))
    }

    fn stop(&mut self) {}

    fn info(&self) -> DeviceInfo {
        let name = "latching".into();
        DeviceInfo { name, self_arming: false, max_force_n: 8.0, max_stiffness_n_m: 1e3, resolution_m: 0.0 }
    }

    fn was_zeroed(&mut self) -> bool {
        self.zeroed_at.contains(&self.calls)
    }

    fn reset(&mut self) -> bool {
        let clears = !self.lasting.contains(&self.calls);
        self.resets.fetch_add(u64::from(clears), Ordering::Relaxed);
        clears
    }
}

/// Ticks the loop over a latching device; the requests are made before the ticks of these numbers. Returns of
/// every tick the phase, what was applied, and the number of successful resets.
fn ticks_of_latching(
    zeroed_at: [u64; 2],
    lasting: std::ops::Range<u64>,
    ticks: u64,
    request: impl Fn(u64, &Controls),
) -> Vec<(Phase, Applied, u64)> {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller: Controller<'_, '_> =
        Controller::new(&organ, Config::new(Method::Tricubic)).expect("has the method");
    let (records, mut drained) = rtrb::RingBuffer::new(100);
    let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let (clock, controls, resets) = (VirtualClock::default(), Controls::default(), AtomicU64::new(0));
    let device = Latching { calls: 0, zeroed_at, resets: &resets, lasting };
    let outputs = Outputs { records, latest };
    let mut haptic = HapticLoop::new(controller, device, &clock, LoopConfig::default(), &controls, outputs);
    let seen = (1..=ticks).map(|index| {
        request(index, &controls);
        clock.wait_until(index * 1_000_000, 0);
        haptic.tick(index, 0, index * 1_000_000).expect("it never fails");
        let record = drained.pop().expect("one record a tick");
        (record.phase, record.applied, resets.load(Ordering::Relaxed))
    });
    seen.collect()
}

/// While disarmed the loop resets the device itself. While armed it passes on only the user's reset.
#[test]
fn a_device_zeroed_by_another_path_is_reset_by_the_user_or_while_disarmed() {
    let seen = ticks_of_latching([10, 30], 0..0, 60, |index, controls| match index {
        20 => controls.arm(),
        // In the same tick: a key that was pressed before the loop noticed.
        30 | 50 => controls.reset(),
        _ => {}
    });
    let seen: Vec<_> =
        seen.into_iter().map(|(phase, applied, resets)| (phase, applied.zeroed, resets)).collect();
    assert_eq!(seen[9 - 1], (Phase::Disarmed, false, 0));
    assert_eq!(seen[10 - 1], (Phase::Disarmed, true, 1));
    assert_eq!(seen[29 - 1], (Phase::Active, false, 1));
    assert_eq!(seen[30 - 1], (Phase::SafeZero(Fault::Watchdog), true, 1));
    assert_eq!(seen[49 - 1], (Phase::SafeZero(Fault::Watchdog), false, 1));
    assert_eq!(seen[50 - 1], (Phase::Disarmed, false, 2));
    assert_eq!(seen[60 - 1], (Phase::Disarmed, false, 2));
}

/// A latch that lasts: the user's reset does nothing, and a disarmed device is not armed before it is cleared.
#[test]
fn a_device_whose_latch_lasts_is_neither_reset_nor_armed() {
    let seen = ticks_of_latching([10, 50], 10..80, 100, |index, controls| match index {
        // Armed before the latch; not while it lasts; after it.
        5 | 60 | 90 => controls.arm(),
        20 | 85 => controls.reset(),
        40 => controls.disarm(),
        _ => {}
    });
    let latched = Phase::SafeZero(Fault::Watchdog);
    let at = |tick: usize| (seen[tick - 1].0, seen[tick - 1].1.reset, seen[tick - 1].2);
    assert_eq!(at(10), (latched, false, 0));
    assert_eq!(at(20), (latched, false, 0), "the reset is refused");
    assert!(seen[60 - 1..79].iter().all(|(phase, ..)| *phase != Phase::Active), "{seen:?}");
    assert_eq!(at(85), (Phase::Disarmed, true, 1));
    assert_eq!(at(90).0, Phase::Active);
}
