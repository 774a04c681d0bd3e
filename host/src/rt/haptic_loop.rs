//! The 1 kHz loop: wait for an absolute deadline, exchange with the device, tick the controller, hand the record on.
//!
//! Once `run` has begun nothing here allocates, locks, formats or writes. A tick that ends after the next deadline makes the
//! loop skip what has passed: the hand gets a gap, never a burst of ticks that pretend to be a millisecond apart.

use super::clock::Clock;
use super::latency::{LatencyRecorder, TickTimes};
use super::pace::{Paced, Paces, pace};
use super::watchdog::Heartbeat;
use super::{Applied, TickRecord};
use crate::device::{Device, DeviceError, DeviceState};
use crate::instructions::{Instructions, Interpolator};
use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use palpate_core::{Controller, Fault, Phase, State, Vec3, vec3};

/// Timing of the loop, and how it is armed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoopConfig {
    /// Time between deadlines, us.
    pub period_us: u32,
    /// The last part of the wait that is spun instead of slept, us.
    pub spin_us: u32,
    /// Device buttons that arm a disarmed controller when pressed; 0 for none.
    pub arm_button: u32,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self { period_us: 1_000, spin_us: 100, arm_button: 0 }
    }
}

/// Most models in one session.
pub const MOST_MODELS: usize = u8::MAX as usize - 1;
/// No model was asked for.
const NO_MODEL: u8 = u8::MAX;

/// Requests from other threads, taken up at the next tick.
#[derive(Debug)]
pub struct Controls {
    arm: AtomicBool,
    disarm: AtomicBool,
    reset: AtomicBool,
    model: AtomicU8,
    /// Only a replay asks for it: a watchdog has fired.
    zeroed: AtomicBool,
}

impl Default for Controls {
    fn default() -> Self {
        let no = || AtomicBool::new(false);
        Self { arm: no(), disarm: no(), reset: no(), model: AtomicU8::new(NO_MODEL), zeroed: no() }
    }
}

impl Controls {
    /// Starts rendering. For a real device this must stand for a deliberate act of the user.
    pub fn arm(&self) {
        self.arm.store(true, Ordering::Relaxed);
    }

    /// Stops rendering.
    pub fn disarm(&self) {
        self.disarm.store(true, Ordering::Relaxed);
    }

    /// Clears a latched fault, which leaves the controller disarmed.
    pub fn reset(&self) {
        self.reset.store(true, Ordering::Relaxed);
    }

    /// Goes on with another model; after the last comes the first again.
    pub fn select(&self, model: u8) {
        self.model.store(model, Ordering::Relaxed);
    }

    /// Asks again for what was done before a recorded tick.
    pub fn repeat(&self, applied: Applied) {
        self.reset.store(applied.reset, Ordering::Relaxed);
        self.arm.store(applied.arm, Ordering::Relaxed);
        self.disarm.store(applied.disarm, Ordering::Relaxed);
        self.zeroed.store(applied.zeroed, Ordering::Relaxed);
    }

    /// Disarming goes last, so that it wins over whatever was asked in the same tick. A device that is not ready is not armed, and no key
    /// that was pressed while the loop stood still arms or resets.
    fn apply(&self, state: &mut State, ready: bool, zeroed: bool) -> Applied {
        let zeroed = self.zeroed.swap(false, Ordering::Relaxed) || zeroed;
        let applied = Applied {
            zeroed,
            reset: self.reset.swap(false, Ordering::Relaxed) && !zeroed,
            arm: self.arm.swap(false, Ordering::Relaxed) && ready && !zeroed,
            disarm: self.disarm.swap(false, Ordering::Relaxed),
        };
        if applied.zeroed {
            state.trip(Fault::Watchdog);
        }
        if applied.reset {
            state.reset();
        }
        if applied.arm {
            state.arm();
        }
        if applied.disarm {
            state.disarm();
        }
        applied
    }
}

/// Where the records go. Both ends are wait-free.
#[derive(Debug)]
pub struct Outputs {
    /// Every record; what does not fit is dropped and counted.
    pub records: rtrb::Producer<TickRecord>,
    /// The newest record, for the eye.
    pub latest: triple_buffer::Input<TickRecord>,
}

/// Why the loop ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoopEnd {
    /// Every period asked for has passed.
    Completed,
    /// The stop flag was set.
    Stopped,
    /// The device is gone.
    DeviceLost(DeviceError),
}

/// What is left when the loop has ended.
#[derive(Debug, Clone)]
pub struct LoopOutcome {
    /// Why it ended.
    pub end: LoopEnd,
    /// Timing.
    pub latency: LatencyRecorder,
    /// Ticks that ran.
    pub ticks: u64,
    /// Records that did not fit into the queue.
    pub dropped_records: u64,
    /// Exchanges that failed in passing (late reply, bad frame).
    pub device_errors: u64,
    /// The last of them.
    pub last_device_error: Option<DeviceError>,
    /// Phase at the end.
    pub phase: Phase,
}

/// Takes the force away from the device when dropped, be it at the end of a run or while a panic unwinds.
#[derive(Debug)]
struct StopOnDrop<D: Device>(D);

impl<D: Device> Drop for StopOnDrop<D> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// A controller and its way to the force, chosen once; a tick only calls it.
#[derive(Debug)]
struct Rendered<'o, 'a, const N: usize> {
    controller: Controller<'o, 'a, N>,
    interpolator: Interpolator,
}

/// The loop with all it owns; built outside the real-time thread, because building allocates.
#[derive(Debug)]
pub struct HapticLoop<'l, 'o, 'a, D: Device, C: Clock, const N: usize> {
    models: Vec<Rendered<'o, 'a, N>>,
    model: usize,
    state: State,
    device: StopOnDrop<D>,
    clock: C,
    config: LoopConfig,
    controls: &'l Controls,
    outputs: Outputs,
    hand_force_n: Vec3,
    buttons: u32,
    latency: LatencyRecorder,
    ticks: u64,
    skipped_periods: u64,
    dropped_records: u64,
    device_errors: u64,
    last_device_error: Option<DeviceError>,
    heartbeat: Option<&'l Heartbeat>,
    /// Ends the loop from outside the session, whatever the thread beside it is doing.
    stop: Option<&'l AtomicBool>,
    /// Firings of the watchdog that this loop has answered with a fault.
    answered_firings: u64,
}

impl<D: Device, C: Clock, const N: usize> Paced for HapticLoop<'_, '_, '_, D, C, N> {
    type Clock = C;
    type Error = DeviceError;

    fn clock(&self) -> &C {
        &self.clock
    }

    fn tick(&mut self, index: u64, origin_ns: u64, deadline_ns: u64) -> Result<(), DeviceError> {
        HapticLoop::tick(self, index, origin_ns, deadline_ns)
    }

    fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    fn overrun(&mut self, index: u64, skipped: u64, late_ns: u64) {
        self.latency.record_overrun(index, skipped, late_ns);
        self.skipped_periods += skipped;
    }
}

impl<'l, 'o, 'a, D: Device, C: Clock, const N: usize> HapticLoop<'l, 'o, 'a, D, C, N> {
    /// Takes over a device. A simulated one arms itself; a real one waits for [`Controls::arm`] or its button.
    pub fn new(
        controller: Controller<'o, 'a, N>,
        device: D,
        clock: C,
        config: LoopConfig,
        controls: &'l Controls,
        outputs: Outputs,
    ) -> Self {
        Self::of_models(&[controller], device, clock, config, controls, outputs)
    }

    /// With several models of one body with the same active nodes ([`crate::model::controllers`]), of which the first is rendered until
    /// [`Controls::select`] asks for another.
    ///
    /// # Panics
    ///
    /// If there is none, or more than [`MOST_MODELS`].
    pub fn of_models(
        controllers: &[Controller<'o, 'a, N>],
        device: D,
        clock: C,
        config: LoopConfig,
        controls: &'l Controls,
        outputs: Outputs,
    ) -> Self {
        let mut state = State::new();
        if device.info().self_arming {
            state.arm();
        }
        assert!(!controllers.is_empty() && controllers.len() <= MOST_MODELS, "1 to 254 models");
        let rendered = |controller: &Controller<'o, 'a, N>| Rendered {
            controller: *controller,
            interpolator: Interpolator::new(controller.config().method),
        };
        Self {
            models: controllers.iter().map(rendered).collect(),
            model: 0,
            state,
            device: StopOnDrop(device),
            clock,
            config,
            controls,
            outputs,
            hand_force_n: vec3::ZERO,
            // All held: arming needs a press that was seen to happen.
            buttons: u32::MAX,
            latency: LatencyRecorder::new(),
            ticks: 0,
            skipped_periods: 0,
            dropped_records: 0,
            device_errors: 0,
            last_device_error: None,
            heartbeat: None,
            stop: None,
            answered_firings: 0,
        }
    }

    /// Lets a watchdog see every tick. Its limit must not be shorter than the age at which a sample is a fault.
    #[must_use]
    pub const fn watched(mut self, heartbeat: &'l Heartbeat) -> Self {
        self.heartbeat = Some(heartbeat);
        self
    }

    /// Lets a flag of the caller end the loop at its next tick, beside the one of [`HapticLoop::run`].
    #[must_use]
    pub const fn stopped_by(mut self, stop: &'l AtomicBool) -> Self {
        self.stop = Some(stop);
        self
    }

    /// What its watchdog sees.
    pub(super) const fn heartbeat(&self) -> Option<&'l Heartbeat> {
        self.heartbeat
    }

    /// Beats; true if the watchdog has zeroed the device since the last tick.
    fn was_zeroed(&mut self) -> bool {
        let Some(heartbeat) = self.heartbeat else { return false };
        let fired = heartbeat.beat(self.ticks + 1);
        core::mem::replace(&mut self.answered_firings, fired) != fired
    }

    /// The instructions the force is interpolated with.
    pub fn instructions(&self) -> Instructions {
        self.models[self.model].interpolator.instructions()
    }

    /// Goes over to the model that was asked for, if it is there.
    fn change_model(&mut self) {
        let asked = self.controls.model.swap(NO_MODEL, Ordering::Relaxed);
        let wanted = usize::from(asked) % self.models.len();
        if asked != NO_MODEL && wanted != self.model {
            self.state.hand_over(true);
            self.model = wanted;
        }
    }

    /// Runs for a number of periods or until the flag is set, then takes the force away.
    pub fn run(mut self, stop: &AtomicBool, periods: u64) -> LoopOutcome {
        let end = self.run_periods(stop, periods);
        let Self { state, device, latency, ticks, dropped_records, .. } = self;
        let (device_errors, last_device_error) = (self.device_errors, self.last_device_error);
        drop(device);
        LoopOutcome {
            end,
            latency,
            ticks,
            dropped_records,
            device_errors,
            last_device_error,
            phase: state.phase(),
        }
    }

    fn run_periods(&mut self, stop: &AtomicBool, periods: u64) -> LoopEnd {
        match pace(self, self.config, stop, periods) {
            Paces::Completed => LoopEnd::Completed,
            Paces::Stopped => LoopEnd::Stopped,
            Paces::Failed(error) => LoopEnd::DeviceLost(error),
        }
    }

    /// One tick: exchange, control, hand on. An error is one after which the device is gone.
    pub fn tick(&mut self, index: u64, origin_ns: u64, deadline_ns: u64) -> Result<(), DeviceError> {
        let start_ns = self.clock.now_ns();
        let now_us = start_ns.saturating_sub(origin_ns) / 1_000;
        let was_zeroed = self.was_zeroed();
        if was_zeroed {
            self.hand_force_n = vec3::ZERO;
        }
        let sample = match self.device.0.exchange(now_us, self.hand_force_n) {
            Ok(sample) => sample,
            Err(error) => {
                self.device_errors += 1;
                self.last_device_error = Some(error);
                if !error.kind().is_passing() {
                    return Err(error);
                }
                None
            }
        };
        let exchanged_ns = self.clock.now_ns();
        let device = self.device.0.state();
        let ready = device == DeviceState::Homed;
        if !ready {
            self.state.trip(Fault::NotReady);
        }
        let applied = self.controls.apply(&mut self.state, ready, was_zeroed);
        self.change_model();
        if let Some(sample) = &sample {
            let pressed_now = sample.buttons & !self.buttons & self.config.arm_button != 0;
            self.buttons = sample.buttons;
            // What is asked in the same tick, disarming above all, wins over a press.
            if pressed_now && ready && applied == Applied::default() {
                self.state.arm();
            }
        }
        let Rendered { controller, interpolator, .. } = &self.models[self.model];
        let command =
            controller.tick_with(&mut self.state, now_us, sample.as_ref(), |space, displacement_m| {
                interpolator.force(space, displacement_m)
            });
        self.hand_force_n = command.hand_force_n;
        let lateness_ns = start_ns.saturating_sub(deadline_ns);
        let end_ns = self.clock.now_ns();
        let (device_ns, compute_ns) = (exchanged_ns - start_ns, end_ns - start_ns);

        self.ticks += 1;
        let controller_ns = end_ns - exchanged_ns;
        self.latency.record(TickTimes { wake_ns: lateness_ns, device_ns, compute_ns: controller_ns });
        let record = TickRecord {
            tick: index,
            t_us: now_us,
            sample,
            device,
            applied,
            model: self.model as u8,
            compute_ns,
            device_ns: Some(device_ns),
            lateness_ns,
            skipped_periods: self.skipped_periods,
            ..TickRecord::of(&command)
        };
        if self.outputs.records.push(record).is_err() {
            self.dropped_records += 1;
        }
        self.outputs.latest.write(record);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{DeviceErrorKind, DeviceInfo, EmergencyStop};
    use crate::rt::clock::VirtualClock;
    use crate::rt::watchdog::Watchdog;
    use crate::synthetic::{self, Shape};
    use palpate_core::{Config, Fault, Method, Organ, Sample};
    use std::sync::atomic::AtomicU64;
    use std::sync::{Arc, Mutex};

    type Forces = Mutex<Vec<Vec3>>;

    /// Presses into the first node and remembers every force it was given; stopping is a zero.
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
            Ok(answers.then_some(Sample { t_us: now_us, position_m, buttons }))
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

    struct Bench<'h> {
        periods: u64,
        config: LoopConfig,
        self_arming: bool,
        queue: usize,
        heartbeat: Option<&'h Heartbeat>,
    }

    impl Default for Bench<'_> {
        fn default() -> Self {
            let config = LoopConfig::default();
            Self { periods: 3_000, config, self_arming: true, queue: 100_000, heartbeat: None }
        }
    }

    impl<'h> Bench<'h> {
        fn run(
            &self,
            clock: impl Clock,
            controls: &'h Controls,
            stop: &AtomicBool,
            each: impl FnMut(u64) -> Result<bool, DeviceError> + Send,
        ) -> Run {
            let blob = synthetic::organ(&Shape::default());
            let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
            let controller = Controller::new(&organ, Config::new(Method::Tricubic)).expect("has the method");
            let (records, mut drained) = rtrb::RingBuffer::new(self.queue);
            let (latest, _) = triple_buffer::triple_buffer(&TickRecord::NOTHING);
            let forces = Forces::default();
            let device = Probe {
                forces: &forces,
                rest_m: organ.spaces[0].rest_position_m,
                normal: organ.spaces[0].outward_normal,
                self_arming: self.self_arming,
                each,
                calls: 0,
            };
            let outputs = Outputs { records, latest };
            let mut haptic = HapticLoop::new(controller, device, clock, self.config, controls, outputs);
            if let Some(heartbeat) = self.heartbeat {
                haptic = haptic.watched(heartbeat);
            }
            let outcome = haptic.run(stop, self.periods);
            let records = core::iter::from_fn(|| drained.pop().ok()).collect();
            Run { outcome, records, forces: forces.into_inner().expect("one thread") }
        }
    }

    /// A clock on which the tick with this number takes that long.
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
        let run = Bench::default().run(
            VirtualClock::default(),
            &Controls::default(),
            &AtomicBool::new(false),
            |_| Ok(true),
        );
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
    fn an_overrun_skips_what_has_passed_and_never_bursts() {
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
    fn a_full_queue_drops_and_counts_but_does_not_wait() {
        let bench = Bench { periods: 500, queue: 64, ..Bench::default() };
        let run =
            bench.run(VirtualClock::default(), &Controls::default(), &AtomicBool::new(false), |_| Ok(true));
        assert_eq!((run.records.len(), run.outcome.dropped_records), (64, 436));
    }

    #[test]
    fn a_real_device_stays_without_force_until_armed() {
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
    fn silence_of_the_device_latches_a_fault_until_reset_and_armed() {
        let controls = Controls::default();
        let run = Bench::default().run(VirtualClock::default(), &controls, &AtomicBool::new(false), |call| {
            match call {
                1_000..1_030 => Err(DeviceError::new(DeviceErrorKind::Timeout)),
                1_030..1_040 => Ok(false),
                2_000 => {
                    controls.reset();
                    controls.arm();
                    Ok(true)
                }
                _ => Ok(true),
            }
        });
        assert_eq!(run.outcome.device_errors, 30);
        assert_eq!(run.records[998].phase, Phase::Active);
        for record in &run.records[1_015..1_999] {
            assert_eq!(record.phase, Phase::SafeZero(Fault::Stale));
            assert_eq!(record.hand_force_n, vec3::ZERO);
        }
        assert_eq!(run.outcome.phase, Phase::Active);
    }

    /// Zeroes go into the same list as the loop's own forces.
    struct SecondPath(Arc<Mutex<Vec<u64>>>, Arc<AtomicU64>);

    impl EmergencyStop for SecondPath {
        fn zero(&mut self) -> Result<(), DeviceError> {
            self.0.lock().expect("one thread").push(self.1.load(Ordering::Relaxed));
            Ok(())
        }
    }

    /// Tick 1,500 hangs in its exchange for 60 ms of virtual time, in which the watchdog looks each 2 ms.
    #[test]
    fn a_stall_is_zeroed_past_the_loop_and_latched_until_reset_and_armed() {
        let (heartbeat, controls, clock) =
            (Heartbeat::default(), Controls::default(), VirtualClock::default());
        let (zeros, now_ns) = (Arc::default(), Arc::new(AtomicU64::new(0)));
        let path = SecondPath(Arc::clone(&zeros), Arc::clone(&now_ns));
        let mut watchdog = Watchdog::new(&heartbeat, Box::new(path), 20_000_000);
        let mut stalled_at_ns = 0;
        let bench = Bench { heartbeat: Some(&heartbeat), ..Bench::default() };
        let run = bench.run(&clock, &controls, &AtomicBool::new(false), |call| {
            let stall_ns = if call == 1_500 { 60_000_000 } else { 0 };
            if stall_ns > 0 {
                stalled_at_ns = clock.now_ns();
            }
            if call == 1_501 {
                // Keys pressed while everything hung, found by the first tick after it, count for nothing.
                controls.reset();
                controls.arm();
            }
            for _ in 0..=stall_ns / 2_000_000 {
                now_ns.store(clock.now_ns(), Ordering::Relaxed);
                watchdog.look(clock.now_ns());
                clock.advance_ns(if stall_ns > 0 { 2_000_000 } else { 0 });
            }
            if call == 2_500 {
                controls.reset();
                controls.arm();
            }
            Ok(true)
        });
        let zeros = zeros.lock().expect("one thread").clone();
        let after_ms: Vec<u64> = zeros.iter().map(|at_ns| (at_ns - stalled_at_ns) / 1_000_000).collect();
        assert_eq!(after_ms, [20, 40, 60], "zero within the limit, and again while it lasts");
        assert_eq!(heartbeat.fired(), 1);

        let stall = run.records.iter().position(|record| record.compute_ns > 50_000_000).expect("it hung");
        assert!(vec3::norm(run.records[stall - 1].hand_force_n) > 0.5, "there was a force to take away");
        // The exchange after the stall does not send the force that was computed before it.
        assert_eq!(run.forces[stall + 1], vec3::ZERO);
        let latched = &run.records[stall + 1..2_499];
        assert!(latched.len() > 900);
        for record in latched {
            assert_eq!(record.phase, Phase::SafeZero(Fault::Watchdog), "{record:?}");
            assert_eq!(record.hand_force_n, vec3::ZERO);
        }
        assert!(run.forces[stall + 1..2_500].iter().all(|force| *force == vec3::ZERO));
        assert_eq!(run.outcome.phase, Phase::Active, "after reset and arm");

        // And it is told that the device took the time, not the controller.
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
    fn the_newest_record_reaches_the_eye() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
        let controller = Controller::new(&organ, Config::new(Method::Hybrid)).expect("has the method");
        let (records, _drained) = rtrb::RingBuffer::new(8);
        let (latest, mut seen) = triple_buffer::triple_buffer(&TickRecord::NOTHING);
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
}
