//! The Falcon in memory: the real driver on the emulated chip, on virtual time. The driver reads and writes
//! in the exchange, or in threads of its own as on USB. With threads a tick ends when they have finished
//! their work.

use super::{OpenError, Rig, Traits};
use crate::falcon::memory::Link;
use crate::falcon::{EmulatedFalcon, FalconConfig, FaultyFtdi, LoaderOptions, MemoryFtdi, synthetic_image};
use crate::fault::{FaultCounts, FaultKind, Faults};
use crate::force_record::ForceRecord;
use crate::mechanism::Waypoint;
use palpate_core::{Sample, Vec3};
use palpate_host::device::DeviceWrapper;
use palpate_host::device::falcon::kinematics::Kinematics;
use palpate_host::device::falcon::{self as driver, Falcon, Ftdi, Image, Mode};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_host::{Device, DeviceError};
use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

/// Time from a request to a cable pulled during it, us; a request takes 107 us on the wire.
const MID_FRAME_US: u64 = 50;
/// Encoder counts per metre at the handle in the coarsest direction, approximately.
const COUNTS_PER_M: f32 = 1.0 / 54e-6;

/// A position outside the indices of all three axes, m.
const OUTSIDE_M: Vec3 = [0.0, 0.0, 0.145];

/// Longest time of the writing thread for a request on a busy machine.
const MAX_WAIT: Duration = Duration::from_secs(20);

/// The link of one driver.
type FalconLink = Arc<FaultyFtdi<MemoryFtdi>>;

/// The Falcon in memory.
pub struct FalconRig {
    /// The device; each driver has its own handle.
    device: MemoryFtdi,
    /// The link of the latest driver.
    link: Option<FalconLink>,
    mode: Mode,
    profile: Profile,
    firmware: Option<Image>,
    seed: u64,
    /// The device's time when the latest driver was opened, us.
    opened_us: u64,
    /// An earlier driver was opened.
    was_open: bool,
    /// Positions from the emulated counts: the driver's own solver, with a tolerance of one micrometre.
    kinematics: Cell<Kinematics>,
}

impl FalconRig {
    /// A device with running firmware, in a hand that homes it on request.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self::with(seed, Mode::Polled, true, LoaderOptions::default())
    }

    /// The same with a driver that reads and writes in threads of its own, as on USB.
    #[must_use]
    pub fn with_threads(seed: u64) -> Self {
        Self::with(seed, Mode::Threaded { fifo_priority: None }, true, LoaderOptions::default())
    }

    /// A device without firmware, and a user who has the image.
    #[must_use]
    pub fn without_firmware(seed: u64, loader: LoaderOptions) -> Self {
        Self::with(seed, Mode::Polled, false, loader)
    }

    /// A device with these motor torques per count, N m, and a matching profile.
    #[must_use]
    pub fn calibrated(nm_per_motor_count: [f64; 3], profile: Profile) -> Self {
        let config = FalconConfig { firmware_runs: true, nm_per_motor_count, ..FalconConfig::default() };
        Self::from_config(7, Mode::Polled, config, profile)
    }

    fn with(seed: u64, mode: Mode, firmware_runs: bool, loader: LoaderOptions) -> Self {
        let profile = Profile::bundled("falcon").expect("bundled");
        Self::from_config(
            seed,
            mode,
            FalconConfig { firmware_runs, loader, ..FalconConfig::default() },
            profile,
        )
    }

    /// Adds a homing path and the drag of the profile to the configuration.
    fn from_config(seed: u64, mode: Mode, config: FalconConfig, profile: Profile) -> Self {
        let middle_m = profile.workspace.device_origin_m;
        // The grip starts outside the indices and moves in, which homes it within 0.1 s.
        let path = vec![
            Waypoint { t_us: 0, position_m: OUTSIDE_M },
            Waypoint { t_us: 100_000, position_m: middle_m },
        ];
        let falcon = EmulatedFalcon::new(FalconConfig { path, drag: super::drag(&profile), ..config });
        let image = synthetic_image(0x3f_8000, &[(0x3f_8000, &[0x1234; 200])]);
        Self {
            device: match mode {
                Mode::Polled => MemoryFtdi::new(falcon),
                Mode::Threaded { .. } => MemoryFtdi::stepped(falcon),
            },
            link: None,
            mode,
            profile,
            firmware: Some(Image::new(image).expect("a valid stream")),
            seed,
            opened_us: 0,
            was_open: false,
            kinematics: Cell::default(),
        }
    }

    /// A link for one driver, without faults at first.
    pub fn connect(&mut self) -> Result<FalconLink, DeviceError> {
        let link = Arc::new(FaultyFtdi::new(self.device.open_again()?, self.seed));
        self.link = Some(Arc::clone(&link));
        Ok(link)
    }

    fn unplug(&self) {
        match &self.link {
            Some(link) => link.unplug(),
            None => self.device.unplug(),
        }
    }

    /// Starts the clock of a new driver. After the first driver the device has to be homed again, which the
    /// hand does.
    pub fn begin(&mut self) {
        self.opened_us = self.device.falcon().now_us();
        if std::mem::replace(&mut self.was_open, true) {
            self.device.falcon().follow(home_again(self.profile.workspace.device_origin_m));
        }
    }
}

/// A driver with threads. An exchange ends when its request is sent or refused.
struct ThreadedDriver {
    inner: Falcon<FaultyFtdi<MemoryFtdi>>,
    link: FalconLink,
}

impl DeviceWrapper for ThreadedDriver {
    type Inner = Falcon<FaultyFtdi<MemoryFtdi>>;

    fn inner(&self) -> &Self::Inner {
        &self.inner
    }

    fn inner_mut(&mut self) -> &mut Self::Inner {
        &mut self.inner
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let exchanged = self.inner.exchange(now_us, hand_force_n);
        self.inner.wait_attempted(MAX_WAIT);
        exchanged
    }
}

impl Drop for ThreadedDriver {
    fn drop(&mut self) {
        self.link.inner().release();
    }
}

/// Moves out past the indices and in again.
fn home_again(middle_m: Vec3) -> Vec<Waypoint> {
    [(0, middle_m), (200_000, OUTSIDE_M), (300_000, OUTSIDE_M), (400_000, middle_m)]
        .map(|(t_us, position_m)| Waypoint { t_us, position_m })
        .to_vec()
}

impl Rig for FalconRig {
    fn name(&self) -> String {
        match self.mode {
            Mode::Polled => "Falcon in memory".into(),
            Mode::Threaded { .. } => "Falcon in memory, with threads".into(),
        }
    }

    fn profile(&self) -> &Profile {
        &self.profile
    }

    fn traits(&self) -> Traits {
        Traits {
            homes: true,
            virtual_time: true,
            middle_m: self.profile.workspace.device_origin_m,
            // One count of each of the three encoders, rounded down.
            count_m: 100e-6,
            motor_step_n: 5e-3,
            // USB ends at the chip. The UART behind it has no parity.
            checked_requests: false,
            numbered_replies: false,
            has_watchdog: false,
            behind_library: false,
        }
    }

    fn open(&mut self, workspace: Workspace) -> Result<Box<dyn Device>, OpenError> {
        let link = self.connect()?;
        let config = driver::FalconConfig { workspace, ..driver::FalconConfig::of(&self.profile, self.mode) };
        let inner = Falcon::start(Arc::clone(&link), config, self.firmware.as_ref())?;
        if self.mode == Mode::Polled {
            self.begin();
            return Ok(Box::new(inner));
        }
        link.inner().wait_until_reading();
        self.begin();
        Ok(Box::new(ThreadedDriver { inner, link }))
    }

    fn advance(&mut self, now_us: u64) {
        // Advances through the handle of the reading thread, which is waited for.
        let handle = self.link.as_ref().map_or(&self.device, |link| link.inner());
        handle.advance(self.opened_us + now_us);
    }

    fn now_us(&self) -> u64 {
        self.device.falcon().now_us().saturating_sub(self.opened_us)
    }

    fn force_record(&self) -> ForceRecord {
        self.device.falcon().force_record().on_clock(self.opened_us)
    }

    fn reset_record(&mut self) {
        self.device.falcon().reset_record();
    }

    fn position_m(&self) -> Vec3 {
        self.device.falcon().position_m()
    }

    fn reported_m(&self) -> Vec3 {
        let counts = self.device.falcon().counts();
        let mut kinematics = self.kinematics.get();
        kinematics.solve(counts.map(|count| i16::try_from(count).unwrap_or(0)));
        self.kinematics.set(kinematics);
        kinematics.pose().position_m.map(|metres| metres as f32)
    }

    fn follow(&mut self, path: Vec<Waypoint>) {
        self.device.falcon().follow(path);
    }

    fn press(&mut self, buttons: u8) {
        self.device.falcon().press(buttons);
    }

    fn set_faults(&mut self, to_device: Faults, to_host: Faults) {
        if let Some(link) = &self.link {
            link.set_faults(to_device, to_host);
        }
    }

    fn counts(&self) -> FaultCounts {
        self.link.as_ref().map_or_else(FaultCounts::default, |link| {
            let (to_device, to_host) = link.counts();
            to_device + to_host
        })
    }

    fn counts_each(&self) -> Option<[FaultCounts; 2]> {
        self.link.as_ref().map(|link| link.counts().into())
    }

    fn last_received_us(&self) -> Option<u64> {
        let last_received_us = self.link.as_ref().and_then(|link| link.last_received_us());
        last_received_us.map(|us| us.saturating_sub(self.opened_us))
    }

    fn replug(&mut self) {
        self.device.replug();
    }

    fn write_past_driver(&mut self, message: &[u8]) -> Result<(), OpenError> {
        let link = self.link.as_ref().ok_or("the device was not opened")?;
        link.write(message, Duration::ZERO)?;
        Ok(())
    }

    fn inject(&mut self, fault: FaultKind) -> bool {
        match fault {
            FaultKind::UnplugMidFrame => {
                let mut falcon = self.device.falcon();
                let until_us = falcon.now_us() + MID_FRAME_US;
                falcon.advance(until_us);
                drop(falcon);
                self.unplug();
            }
            FaultKind::Replug => self.unplug(),
            FaultKind::HomingLost => self.device.falcon().lose_homing(),
            FaultKind::PowerCycle => self.device.falcon().power_cycle(),
            _ => return false,
        }
        true
    }

    fn jump_encoder(&mut self, axis: usize, by_m: f32) {
        self.device.falcon().jump_encoder(axis, (by_m * COUNTS_PER_M).round() as i32);
    }
}
