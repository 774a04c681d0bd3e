//! The 1 kHz loop: wait for an absolute deadline, exchange with the device, tick the controller, hand the record on.
//!
//! Once `run` has begun nothing here allocates, locks, formats or writes. A tick that ends after the next deadline makes the
//! loop skip what has passed: the hand gets a gap, never a burst of ticks that pretend to be a millisecond apart.

use super::clock::Clock;
use super::controls::{Controls, MOST_MODELS};
use super::latency::{LatencyRecorder, TickTimes};
use super::pace::{Paced, Paces, pace};
use super::watchdog::Heartbeat;
use super::{Applied, TickRecord};
use crate::device::{Device, DeviceError, DeviceState};
use crate::instructions::{Instructions, Interpolator};
use core::sync::atomic::{AtomicBool, Ordering};
use palpate_core::profile::PC_SPACES;
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

/// Where the records go. Both ends are wait-free.
#[derive(Debug)]
pub struct Outputs {
    /// Every record; what does not fit is dropped and counted.
    pub records: rtrb::Producer<TickRecord>,
    /// The newest record, for the eye.
    pub latest: triple_buffer::Input<TickRecord>,
}

/// Time in which the force that carries the handle rises, us: that of the ramp after arming.
const CARRY_RISE_US: f32 = 500_000.0;

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
pub struct HapticLoop<'l, 'o, 'a, D: Device, C: Clock, const N: usize = PC_SPACES> {
    models: Vec<Rendered<'o, 'a, N>>,
    model: usize,
    state: State,
    device: StopOnDrop<D>,
    clock: C,
    config: LoopConfig,
    controls: &'l Controls,
    outputs: Outputs,
    hand_force_n: Vec3,
    /// Force that carries the weight of the handle, and what share of it is on.
    carried_n: Vec3,
    carried_share: f32,
    /// Ticks since the last sample.
    missed: u32,
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
            carried_n: vec3::ZERO,
            carried_share: 0.0,
            missed: 0,
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

    /// Carries the weight of the handle with this force, model frame, N, while the controller is active.
    ///
    /// It is no force of the model: it is neither recorded nor counted by the guard on energy, and the device's own clamp holds the sum. It rises over
    /// half a second and is gone at once with whatever takes the force away.
    #[must_use]
    pub const fn carrying(mut self, force_n: Vec3) -> Self {
        self.carried_n = force_n;
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

    /// What is added to the force for the weight of the handle. Samples that do not come take it away with the model's force: one policy.
    fn carried_n(&mut self, phase: Phase, has_sample: bool) -> Vec3 {
        self.missed = if has_sample { 0 } else { self.missed.saturating_add(1) };
        let hold_ticks = self.models[self.model].controller.config().limits.stale_hold_ticks;
        if phase == Phase::Active && self.missed <= hold_ticks {
            let step = self.config.period_us as f32 / CARRY_RISE_US;
            self.carried_share = (self.carried_share + step).min(1.0);
        } else {
            self.carried_share = 0.0;
        }
        vec3::scale(self.carried_n, self.carried_share)
    }

    /// Goes over to the model that was asked for.
    fn change_model(&mut self) {
        let Some(asked) = self.controls.take_model() else { return };
        let wanted = usize::from(asked) % self.models.len();
        if wanted != self.model {
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
        let was_zeroed = self.device.0.was_zeroed() || was_zeroed;
        let applied = self.controls.apply(&mut self.state, ready, was_zeroed);
        // What is disarmed has lost no force: the deliberate act that is asked for is the arming.
        if applied.reset || (applied.zeroed && self.state.phase() == Phase::Disarmed) {
            self.device.0.reset();
        }
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
        let carried_n = self.carried_n(command.phase, sample.is_some());
        self.hand_force_n = vec3::add(command.hand_force_n, carried_n);
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
mod tests;
