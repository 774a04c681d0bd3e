//! A rig in lockstep with the driver, or with the whole loop: one exchange or tick per millisecond, then the
//! device advances.

use crate::mechanism::Waypoint;
use crate::rig::{OpenError, Rig};
use crate::tick::TICK_US;
use palpate_core::{Config, Controller, Method, Organ, Sample, Vec3, vec3};
use palpate_host::device::fence::{Fence, GuardPath, MAX_ZERO_MESSAGE};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_host::device::{DeviceState, DeviceWrapper};
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::settings::controller_config;
use palpate_host::{BlobFile, Device, DeviceError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Sampling period of the true positions, us.
const TRUTH_PERIOD_US: u64 = 250;
/// Longest duration of homing, ticks.
const HOMING_TICKS: u64 = 5_000;

/// The golden blob of the core, which contains its certificate.
///
/// # Panics
///
/// Never: a test of the core reads it.
#[must_use]
pub fn golden_organ() -> BlobFile {
    BlobFile::of(include_bytes!("../../firmware-like-core/golden/organ-514.blob"))
}

/// The workspace in which the device's +z is the outward normal of the organ's first active node and the
/// middle of the device's workspace lies on the surface there. Scale and middle are the profile's.
#[must_use]
pub fn on_organ(organ: &Organ<'_>, profile: &Profile) -> Workspace {
    let node = &organ.spaces[0];
    let normal = node.active.outward_normal;
    let first = vec3::normalize_or_zero(vec3::cross([0.3, 0.9, 0.1], normal));
    let second = vec3::cross(normal, first);
    Workspace {
        axes: [0, 1, 2].map(|i: usize| [first[i], second[i], normal[i]]),
        model_origin_m: node.active.rest_position_m,
        ..profile.workspace
    }
}

/// A driver on its rig, without a loop.
pub struct Session<'r> {
    /// The rig.
    pub rig: &'r mut dyn Rig,
    device: Option<Box<dyn Device>>,
    now_us: u64,
    /// Times and true positions of the grip, sampled every [`TRUTH_PERIOD_US`].
    truth: Vec<(u64, Vec3)>,
    longest_wait_us: u64,
    longest_wait: Duration,
    last_wait: Duration,
}

impl<'r> Session<'r> {
    /// Opens the driver.
    pub fn open(rig: &'r mut dyn Rig, workspace: Workspace) -> Result<Self, OpenError> {
        let device = Some(rig.open(workspace)?);
        Ok(Self {
            rig,
            device,
            now_us: 0,
            truth: Vec::new(),
            longest_wait_us: 0,
            longest_wait: Duration::ZERO,
            last_wait: Duration::ZERO,
        })
    }

    /// Opens the driver and exchanges zero force until it is homed.
    pub fn homed(rig: &'r mut dyn Rig, workspace: Workspace) -> Result<Self, OpenError> {
        let mut session = Self::open(rig, workspace)?;
        for _ in 0..HOMING_TICKS {
            let sampled = session.tick(vec3::ZERO)?.is_some();
            if sampled && session.state() == DeviceState::Homed {
                return Ok(session);
            }
        }
        Err("homing took longer than 5 s".into())
    }

    /// The driver.
    ///
    /// # Panics
    ///
    /// If it was dropped.
    pub fn device(&mut self) -> &mut dyn Device {
        self.device.as_mut().expect("the driver is open")
    }

    /// State reported by the driver.
    #[must_use]
    pub fn state(&self) -> DeviceState {
        self.device.as_ref().map_or(DeviceState::Disconnected, Device::state)
    }

    /// The time of the next exchange, us.
    #[must_use]
    pub const fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Times and true positions of the grip.
    #[must_use]
    pub fn truth(&self) -> &[(u64, Vec3)] {
        &self.truth
    }

    /// Longest duration of an exchange, in virtual time (us) and in real time.
    #[must_use]
    pub const fn longest_wait(&self) -> (u64, Duration) {
        (self.longest_wait_us, self.longest_wait)
    }

    /// Duration of the last exchange in real time.
    #[must_use]
    pub const fn last_wait(&self) -> Duration {
        self.last_wait
    }

    /// One exchange, then the device advances.
    pub fn tick(&mut self, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let (now_us, before_us, start) = (self.now_us, self.rig.now_us(), Instant::now());
        // There is no loop here that is armed.
        self.device().set_armed(true);
        let exchanged = self.device().exchange(now_us, force_n);
        let waited_us = self.rig.now_us().saturating_sub(before_us);
        self.longest_wait_us = self.longest_wait_us.max(waited_us);
        self.last_wait = start.elapsed();
        self.longest_wait = self.longest_wait.max(self.last_wait);
        self.pass(TICK_US);
        exchanged
    }

    /// Advances without an exchange.
    pub fn pass(&mut self, us: u64) {
        let until_us = self.now_us + us;
        self.rig.advance_noting(self.now_us, until_us, TRUTH_PERIOD_US, &mut self.truth);
        self.now_us = until_us;
    }

    /// Writes the zero message past the driver, as a guard does.
    pub fn guard_zero(&mut self, fence: &Fence, path: Option<&GuardPath>) -> Result<(), OpenError> {
        let Some(path) = path else {
            let mut message = [0; MAX_ZERO_MESSAGE];
            let len = fence.page().zero_message(&mut message);
            return self.rig.write_past_driver(&message[..len]);
        };
        Ok(path.send_zero(fence.page())?)
    }

    /// Drops the driver.
    pub fn close(&mut self) {
        self.device = None;
    }

    /// Returns the driver and the time of its next exchange.
    ///
    /// # Panics
    ///
    /// If it was dropped.
    #[must_use]
    pub fn into_device(self) -> (Box<dyn Device>, u64) {
        (self.device.expect("the driver is open"), self.now_us)
    }
}

/// A driver that panics in an exchange on demand.
struct PanicOnDemand {
    inner: Box<dyn Device>,
    panic_flag: Arc<AtomicBool>,
}

impl DeviceWrapper for PanicOnDemand {
    type Inner = dyn Device;

    fn inner(&self) -> &(dyn Device + 'static) {
        &*self.inner
    }

    fn inner_mut(&mut self) -> &mut (dyn Device + 'static) {
        &mut *self.inner
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        assert!(!self.panic_flag.load(Ordering::Relaxed), "planted");
        self.inner.exchange(now_us, hand_force_n)
    }
}

/// The host's loop with controller and organ, on a rig.
pub struct Bench<'l, 'o> {
    /// The rig.
    pub rig: &'l mut dyn Rig,
    /// The controls of the loop, as other threads use them.
    pub controls: &'l Controls,
    haptic: Option<HapticLoop<'l, 'o, 'o, PanicOnDemand, &'l VirtualClock>>,
    clock: &'l VirtualClock,
    records: rtrb::Consumer<TickRecord>,
    panic_flag: Arc<AtomicBool>,
    config: Config,
    workspace: Workspace,
    index: u64,
    last_received_us: Option<u64>,
}

impl Bench<'_, '_> {
    /// The settings of the loop's controller, as `palpate run` makes them.
    #[must_use]
    pub const fn config(&self) -> Config {
        self.config
    }

    /// Placement of the device's workspace in the model.
    #[must_use]
    pub const fn workspace(&self) -> Workspace {
        self.workspace
    }

    /// [`Rig::last_received_us`] after the last exchange: its sample is no newer.
    #[must_use]
    pub const fn last_received_us(&self) -> Option<u64> {
        self.last_received_us
    }

    /// The time of the next tick, us.
    #[must_use]
    pub const fn now_us(&self) -> u64 {
        self.index * TICK_US
    }

    /// One tick, then the device advances. The error means that the device is lost.
    ///
    /// # Panics
    ///
    /// If the loop has ended.
    pub fn step(&mut self) -> Result<TickRecord, DeviceError> {
        let haptic = self.haptic.as_mut().expect("the loop has not ended");
        let deadline_ns = self.index * TICK_US * 1_000;
        self.clock.wait_until(deadline_ns, 0);
        let ticked = haptic.tick(self.index, 0, deadline_ns);
        self.index += 1;
        // Read before the device advances: its next data belongs to the next exchange.
        self.last_received_us = self.rig.last_received_us();
        self.rig.advance(self.index * TICK_US);
        ticked?;
        Ok(self.records.pop().expect("one record per tick"))
    }

    /// Runs `ticks` ticks; fails if the device is lost.
    pub fn run(&mut self, ticks: u64) -> Result<Vec<TickRecord>, DeviceError> {
        (0..ticks).map(|_| self.step()).collect()
    }

    /// Drops the loop and its driver, then advances the device by two ticks.
    pub fn end(&mut self) {
        self.haptic = None;
        self.index += 2;
        self.rig.advance(self.index * TICK_US);
    }

    /// Lets the next exchange panic.
    pub fn panic_in_next_exchange(&mut self) {
        self.panic_flag.store(true, Ordering::Relaxed);
    }
}

/// Opens and homes the device of a rig on an organ, and runs `test` with the disarmed loop. The hand waits in
/// the middle of the workspace, on the surface. There is no guard: it does not act while the loop beats.
pub fn with_loop<T>(
    rig: &mut dyn Rig,
    organ: &Organ<'_>,
    method: Method,
    test: impl FnOnce(&mut Bench<'_, '_>) -> T,
) -> Result<T, OpenError> {
    let workspace = on_organ(organ, rig.profile());
    let profile = Profile { workspace, ..rig.profile().clone() };
    let (device, now_us) = Session::homed(rig, workspace)?.into_device();
    let config = controller_config(&[organ], method, &device.info(), Some(&profile));
    let controller = Controller::new(organ, config)?;
    let (producer, records) = rtrb::RingBuffer::new(4);
    let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let outputs = Outputs { records: producer, latest };
    let (clock, controls, panic_flag) = (VirtualClock::default(), Controls::default(), Arc::default());
    let panicking = PanicOnDemand { inner: device, panic_flag: Arc::clone(&panic_flag) };
    let haptic = HapticLoop::new(controller, panicking, &clock, LoopConfig::default(), &controls, outputs);
    let index = now_us.div_ceil(TICK_US);
    let mut bench = Bench {
        rig,
        controls: &controls,
        haptic: Some(haptic),
        clock: &clock,
        records,
        panic_flag,
        config,
        workspace,
        index,
        last_received_us: None,
    };
    Ok(test(&mut bench))
}

/// Moves out of the organ and in again, from the end of [`press`]; the heights are those of [`press`].
#[must_use]
pub fn press_again(rig: &dyn Rig, above_m: f32, below_m: f32) -> Vec<Waypoint> {
    let path = press(rig, above_m, below_m);
    let (above_m, below_m) = (path[1].position_m, path[3].position_m);
    [(0, below_m), (150_000, above_m), (200_000, above_m), (400_000, below_m)]
        .map(|(t_us, position_m)| Waypoint { t_us, position_m })
        .to_vec()
}

/// Ticks of [`press_again`] until the hand is out.
pub const LIFTED_TICKS: u64 = 155;

/// Ticks of [`press_again`], with some inside the organ.
pub const PRESS_AGAIN_TICKS: u64 = 450;

/// Moves from above the surface into the organ within 0.6 s. Heights in the model, m.
#[must_use]
pub fn press(rig: &dyn Rig, above_m: f32, below_m: f32) -> Vec<Waypoint> {
    let middle_m = rig.traits().middle_m;
    let scale = rig.profile().workspace.scale;
    let at = |t_us, height_m: f32| Waypoint {
        t_us,
        position_m: vec3::add(middle_m, [0.0, 0.0, height_m / scale]),
    };
    vec![at(0, 0.0), at(100_000, above_m), at(200_000, above_m), at(600_000, -below_m)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::FalconRig;

    /// The settings once drifted from those of `palpate run`: half the hysteresis, and an energy guard without
    /// encoder step and delay.
    #[test]
    fn the_bench_runs_the_settings_of_a_session() {
        let blob = golden_organ();
        let organ: Organ<'_> = Organ::read(blob.bytes()).expect("the golden blob is valid");
        let mut rig = FalconRig::new(1);
        let profile = rig.profile().clone();
        let config = with_loop(&mut rig, &organ, Method::Energy, |bench| bench.config()).expect("it opens");
        let count_m = profile.workspace.scale * profile.mechanism.encoder_quantum_m.expect("stated");
        assert!(config.contact.release_height_m >= 4.0 * count_m, "{config:?}");
        assert!(config.passivity.position_step_m >= count_m, "{config:?}");
        assert_eq!(config.passivity.force_delay_us, profile.force_delay_us);
        assert_eq!(config.passivity.workspace_scale, profile.workspace.scale);
    }
}
