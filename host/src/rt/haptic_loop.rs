//! The 1 kHz loop: wait for an absolute deadline, exchange with the device, tick the controller, publish the
//! record.
//!
//! After `run` has begun the loop does not allocate, lock or format; its only input and output is the
//! exchange with the device. If a tick ends after the next deadline, the loop skips the deadlines that have
//! passed: no force is sent in the meantime, and no burst of ticks follows.

use super::clock::Clock;
use super::config::LoopConfig;
use super::controls::{Controls, MAX_MODELS};
use super::histogram::TickTimes;
use super::latency::LatencyRecorder;
use super::periodic::{PeriodicEnd, PeriodicTask, run_periodic};
use super::record::{Applied, TickRecord};
use crate::device::{Device, DeviceError, DeviceState};
use crate::instructions::{Instructions, Interpolator};
use crate::live::{LiveCounts, LiveField};
use core::sync::atomic::{AtomicBool, Ordering};
use palpate_core::{Controller, Fault, Limits, Phase, Sample, Space, State, Vec3, vec3};

/// The buttons while they are unknown: none counts as pressed before it was seen released.
const ALL_HELD: u32 = u32::MAX;
/// Ticks without a sample after which the buttons are unknown. A late reply takes two or three.
const MAX_SILENT_TICKS: u64 = 10;

/// Destinations of the records. Both are wait-free.
#[derive(Debug)]
pub struct Outputs {
    /// Every record; records that do not fit are dropped and counted.
    pub records: rtrb::Producer<TickRecord>,
    /// The newest record, for the viewer.
    pub latest: triple_buffer::Input<TickRecord>,
}

/// Reason of the end of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoopEnd {
    /// All requested periods have passed.
    Completed,
    /// The stop flag was set.
    Stopped,
    /// The device is lost.
    DeviceLost(DeviceError),
}

/// Result of a run of the loop.
#[derive(Debug, Clone)]
pub struct LoopOutcome {
    /// Reason of the end.
    pub end: LoopEnd,
    /// Timing.
    pub latency: LatencyRecorder,
    /// Number of ticks.
    pub ticks: u64,
    /// Records dropped because the queue was full.
    pub dropped_records: u64,
    /// Records dropped because the queue of the recorder was full.
    pub dropped_by_recorder: u64,
    /// Exchanges that failed, including the one that ended the loop.
    pub device_errors: u64,
    /// The last error of an exchange.
    pub last_device_error: Option<DeviceError>,
    /// Phase at the end.
    pub phase: Phase,
    /// What a live solver has sent; `None` where tables gave the force.
    pub live: Option<LiveCounts>,
}

/// Stops the device when dropped, at the end of a run or while a panic unwinds.
#[derive(Debug)]
struct StopOnDrop<D: Device>(D);

impl<D: Device> Drop for StopOnDrop<D> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// What gives the force, decided once.
#[derive(Debug)]
enum Force {
    /// The tables of each model, with the interpolator chosen for its method.
    Tables(Vec<Interpolator>),
    /// The jets of a live solver, for the only model.
    Jets(Box<LiveField>),
}

/// The loop and all it owns. It is built outside the real-time thread, because building allocates.
#[derive(Debug)]
pub struct HapticLoop<'l, 'o, 'a, D: Device, C: Clock, const N: usize = { Limits::PC.spaces }> {
    models: Vec<Controller<'o, 'a, N>>,
    force: Force,
    model: usize,
    state: State,
    device: StopOnDrop<D>,
    clock: C,
    config: LoopConfig,
    controls: &'l Controls,
    outputs: Outputs,
    /// The queue of a recorder.
    recording: Option<rtrb::Producer<TickRecord>>,
    /// Force of the next exchange: that of the last record.
    sent_force_n: Vec3,
    /// Buttons of the last sample, or [`ALL_HELD`].
    buttons: u32,
    /// Whether the device ignores forces until its reset succeeds.
    is_latched: bool,
    /// Ticks without a sample since the last one.
    last_sample_tick: u64,
    latency: LatencyRecorder,
    ticks: u64,
    skipped_periods: u64,
    dropped_records: u64,
    dropped_by_recorder: u64,
    device_errors: u64,
    last_device_error: Option<DeviceError>,
    /// Flag of the session's caller that ends the loop.
    stop: Option<&'l AtomicBool>,
}

impl<D: Device, C: Clock, const N: usize> PeriodicTask for HapticLoop<'_, '_, '_, D, C, N> {
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
    /// Takes over a device. A simulated device arms itself; a real one waits for [`Controls::arm`] or its
    /// button.
    pub fn new(
        controller: Controller<'o, 'a, N>,
        device: D,
        clock: C,
        config: LoopConfig,
        controls: &'l Controls,
        outputs: Outputs,
    ) -> Self {
        Self::with_models(&[controller], device, clock, config, controls, outputs)
    }

    /// Makes a loop with several models of one body that have the same active nodes
    /// ([`crate::model::controllers`]). The first is rendered until [`Controls::select`] requests another.
    ///
    /// # Panics
    ///
    /// If there is no model, more than [`MAX_MODELS`], or one without a method.
    pub fn with_models(
        controllers: &[Controller<'o, 'a, N>],
        device: D,
        clock: C,
        config: LoopConfig,
        controls: &'l Controls,
        outputs: Outputs,
    ) -> Self {
        assert!(!controllers.is_empty() && controllers.len() <= MAX_MODELS, "1 to 254 models");
        let interpolator = |controller: &Controller<'o, 'a, N>| {
            Interpolator::new(controller.config().method.expect("models of tables have a method"))
        };
        let force = Force::Tables(controllers.iter().map(interpolator).collect());
        Self::with_force(controllers.to_vec(), force, device, clock, config, controls, outputs)
    }

    /// Makes a loop that renders the jets of a live solver. The controller needs no method.
    pub fn live(
        controller: Controller<'o, 'a, N>,
        jets: LiveField,
        device: D,
        clock: C,
        config: LoopConfig,
        controls: &'l Controls,
        outputs: Outputs,
    ) -> Self {
        Self::with_force(
            vec![controller],
            Force::Jets(Box::new(jets)),
            device,
            clock,
            config,
            controls,
            outputs,
        )
    }

    fn with_force(
        models: Vec<Controller<'o, 'a, N>>,
        force: Force,
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
        Self {
            models,
            force,
            model: 0,
            state,
            device: StopOnDrop(device),
            clock,
            config,
            controls,
            outputs,
            recording: None,
            sent_force_n: vec3::ZERO,
            buttons: ALL_HELD,
            is_latched: false,
            last_sample_tick: 0,
            latency: LatencyRecorder::new(),
            ticks: 0,
            skipped_periods: 0,
            dropped_records: 0,
            dropped_by_recorder: 0,
            device_errors: 0,
            last_device_error: None,
            stop: None,
        }
    }

    /// Sets the queue of a recorder, besides the one of [`Outputs`]: neither waits for the other's reader.
    #[must_use]
    pub fn with_recording(mut self, queue: Option<rtrb::Producer<TickRecord>>) -> Self {
        self.recording = queue;
        self
    }

    /// Sets a second stop flag, besides the one of [`HapticLoop::run`].
    #[must_use]
    pub const fn with_stop_flag(mut self, stop: &'l AtomicBool) -> Self {
        self.stop = Some(stop);
        self
    }

    /// The instructions that evaluate the force.
    pub fn instructions(&self) -> Instructions {
        match &self.force {
            Force::Tables(interpolators) => interpolators[self.model].instructions(),
            Force::Jets(_) => Instructions::Baseline,
        }
    }

    /// Switches to the requested model.
    fn change_model(&mut self) {
        let Some(requested) = self.controls.take_model() else { return };
        let requested = usize::from(requested) % self.models.len();
        if requested != self.model {
            self.state.hand_over(true);
            self.model = requested;
        }
    }

    /// Whether this sample shows a press of the button that arms. A button that is held at the start, or that
    /// went down in a gap of samples, must first be released.
    fn button_is_pressed(&mut self, index: u64, sample: Option<&Sample>) -> bool {
        let Some(sample) = sample else { return false };
        let gap = index.saturating_sub(core::mem::replace(&mut self.last_sample_tick, index));
        let before = if gap > MAX_SILENT_TICKS { ALL_HELD } else { self.buttons };
        self.buttons = sample.buttons;
        sample.buttons & !before & self.config.arm_button != 0
    }

    /// Runs for a number of periods or until the flag is set, then stops the device.
    pub fn run(mut self, stop: &AtomicBool, periods: u64) -> LoopOutcome {
        let end = self.run_periods(stop, periods);
        let Self { state, device, latency, ticks, dropped_records, dropped_by_recorder, force, .. } = self;
        let live = if let Force::Jets(jets) = &force { Some(jets.counts()) } else { None };
        let (device_errors, last_device_error) = (self.device_errors, self.last_device_error);
        drop(device);
        LoopOutcome {
            end,
            latency,
            ticks,
            dropped_records,
            dropped_by_recorder,
            device_errors,
            last_device_error,
            phase: state.phase(),
            live,
        }
    }

    fn run_periods(&mut self, stop: &AtomicBool, periods: u64) -> LoopEnd {
        match run_periodic(self, self.config, stop, periods) {
            PeriodicEnd::Completed => LoopEnd::Completed,
            PeriodicEnd::Stopped => LoopEnd::Stopped,
            PeriodicEnd::Failed(error) => LoopEnd::DeviceLost(error),
        }
    }

    /// One tick: exchange, control, publish. An error means that the device is lost.
    pub fn tick(&mut self, index: u64, origin_ns: u64, deadline_ns: u64) -> Result<(), DeviceError> {
        let start_ns = self.clock.now_ns();
        let now_us = start_ns.saturating_sub(origin_ns) / 1_000;
        let sample = match self.device.0.exchange(now_us, self.sent_force_n) {
            Ok(sample) => sample,
            Err(error) => {
                self.device_errors += 1;
                self.last_device_error = Some(error);
                if !error.kind().is_transient() {
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
        let was_zeroed = self.device.0.was_zeroed();
        if was_zeroed {
            self.buttons = ALL_HELD;
        }
        let ready = ready && !self.is_latched;
        let applied = self.controls.apply(&mut self.state, ready, was_zeroed, || self.device.0.reset());
        // While disarmed the device's zero latch is cleared without a reset by the user, as soon as its cause
        // is gone: no force returns before arming, and a latched device is not armed.
        self.is_latched = (self.is_latched || applied.zeroed) && !applied.reset;
        if self.is_latched && self.state.phase() == Phase::Disarmed {
            self.is_latched = !self.device.0.reset();
        }
        self.change_model();
        // Any request of the same tick, for example to disarm, overrides a press of the button.
        if self.button_is_pressed(index, sample.as_ref()) && ready && applied == Applied::default() {
            self.state.arm();
        }
        let (controller, state) = (&self.models[self.model], &mut self.state);
        let (command, live) = match &mut self.force {
            Force::Tables(interpolators) => {
                let interpolator = interpolators[self.model];
                let force = |space: &Space<'_>, d: &Vec3| interpolator.force(space, d);
                (controller.tick_with(state, now_us, sample.as_ref(), force), None)
            }
            Force::Jets(jets) => {
                let at = (index, start_ns, now_us);
                let (command, live) = jets.tick(controller, state, at, sample.as_ref());
                (command, Some(live))
            }
        };
        self.sent_force_n = command.hand_force_n;
        self.device.0.set_armed(command.phase == Phase::Active);
        let lateness_ns = start_ns.saturating_sub(deadline_ns);
        let end_ns = self.clock.now_ns();
        let device_ns = exchanged_ns - start_ns;

        self.ticks += 1;
        // In the statistics `compute_ns` is without the exchange; in the record it includes the exchange.
        self.latency.record(TickTimes { wake_ns: lateness_ns, device_ns, compute_ns: end_ns - exchanged_ns });
        let record = TickRecord {
            tick: index,
            t_us: now_us,
            sample,
            device,
            applied,
            model: self.model as u8,
            compute_ns: end_ns - start_ns,
            reported_n: sample.and_then(|_| self.device.0.reported_n()),
            device_ns: Some(device_ns),
            lateness_ns,
            skipped_periods: self.skipped_periods,
            live,
            ..TickRecord::of(&command)
        };
        if self.outputs.records.push(record).is_err() {
            self.dropped_records += 1;
        }
        if self.recording.as_mut().is_some_and(|queue| queue.push(record).is_err()) {
            self.dropped_by_recorder += 1;
        }
        self.outputs.latest.write(record);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
