//! The Falcon on the guest's USB as a rig: the real driver runs here, and its device in the bench, whose time
//! this rig advances.

use crate::line::Line;
use crate::timeout_ftdi::{Reader, TimeoutFtdi};
use palpate_core::{Sample, Vec3};
use palpate_hil::bench::{Reply, Request, RigReply, RigRequest};
use palpate_hil::fault::{FaultCounts, FaultKind, Faults};
use palpate_hil::force_record::ForceRecord;
use palpate_hil::mechanism::Waypoint;
use palpate_hil::rig::{FalconRig, OpenError, Rig, RigKind, Traits};
use palpate_host::device::DeviceWrapper;
use palpate_host::device::falcon::usb::UsbError;
use palpate_host::device::falcon::{Falcon, FalconConfig, FalconError, Image, Mode, UsbFtdi};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_host::{Device, DeviceError};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Longest time for the guest to detect plugging or unplugging.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Shortest write timeout: the USB of a virtual machine may be late, and the device's time stands still
/// meanwhile.
const MIN_WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest read timeout: it bounds the time to close a driver, some hundred times.
const MAX_READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Number of words of the synthetic firmware.
const FIRMWARE_WORDS: u16 = 500;

/// The line to the bench, shared by all rigs in turn.
static LINE: OnceLock<Mutex<Line>> = OnceLock::new();

/// The rig for the contract suite. Takes over the line.
pub(crate) fn kind(line: Line) -> RigKind {
    // Set once in the process.
    let _ = LINE.set(Mutex::new(line));
    RigKind { name: "falcon-qemu", in_memory: false, make: |seed| Box::new(RemoteRig::new(seed)) }
}

/// Sends a request to the bench.
///
/// # Panics
///
/// If the bench does not answer. The calling check then fails.
fn request(request: RigRequest) -> RigReply {
    let mut line = LINE.get().expect("set").lock().unwrap_or_else(PoisonError::into_inner);
    let request = Request::Rig(request);
    match line.request(&request) {
        Ok(Reply::Rig(reply)) => reply,
        other => panic!("the bench answers {other:?} to {request:?}"),
    }
}

/// The driver. After it is dropped nothing reads from the chip.
struct Driver {
    inner: Falcon<TimeoutFtdi>,
    reader: Arc<Reader>,
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.reader.reads.store(false, Ordering::Release);
    }
}

impl DeviceWrapper for Driver {
    type Inner = Falcon<TimeoutFtdi>;

    fn inner(&self) -> &Falcon<TimeoutFtdi> {
        &self.inner
    }

    fn inner_mut(&mut self) -> &mut Falcon<TimeoutFtdi> {
        &mut self.inner
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let exchanged = self.inner.exchange(now_us, hand_force_n);
        // The device receives the request before its time advances.
        self.inner.wait_attempted(MIN_WRITE_TIMEOUT);
        exchanged
    }
}

struct RemoteRig {
    profile: Profile,
    traits: Traits,
    now_us: u64,
    reader: Arc<Reader>,
}

impl RemoteRig {
    fn new(seed: u64) -> Self {
        request(RigRequest::NewDevice { seed });
        // Profile and traits are those of the rig in memory.
        let like = FalconRig::new(seed);
        Self { profile: like.profile().clone(), traits: like.traits(), now_us: 0, reader: Arc::default() }
    }

    fn reads(&self) -> bool {
        self.reader.reads.load(Ordering::Acquire)
    }

    fn try_open(&self, config: FalconConfig, image: &Image) -> Result<Driver, FalconError> {
        let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
        let chip = TimeoutFtdi::new(chip, MIN_WRITE_TIMEOUT, MAX_READ_TIMEOUT);
        let reader = chip.reader();
        Ok(Driver { inner: Falcon::start(Arc::new(chip), config, Some(image))?, reader })
    }

    fn pass(&mut self, from_us: u64, until_us: u64, every_us: u64) -> Vec<Vec3> {
        let reply =
            request(RigRequest::Advance { from_us, until_us, every_us, wait_for_driver: self.reads() });
        self.now_us = self.now_us.max(until_us);
        match reply {
            RigReply::Positions(positions) => positions,
            other => panic!("{other:?} to an advance"),
        }
    }

    fn positions(&self) -> (Vec3, Vec3) {
        match request(RigRequest::Position) {
            RigReply::Position(actual, reported) => (actual, reported),
            other => panic!("{other:?} to a position request"),
        }
    }
}

impl Rig for RemoteRig {
    fn name(&self) -> String {
        "Falcon on the USB of a virtual machine".into()
    }

    fn profile(&self) -> &Profile {
        &self.profile
    }

    fn traits(&self) -> Traits {
        self.traits
    }

    fn open(&mut self, workspace: Workspace) -> Result<Box<dyn Device>, OpenError> {
        let config = FalconConfig {
            workspace,
            ..FalconConfig::of(&self.profile, Mode::Threaded { fifo_priority: None })
        };
        let (image, until) = (Image::synthetic(FIRMWARE_WORDS), Instant::now() + TIMEOUT);
        request(RigRequest::BeginOpen);
        let driver = loop {
            match self.try_open(config, &image) {
                Ok(driver) => break driver,
                // The guest's kernel has not processed the last plugging or unplugging yet.
                Err(FalconError::Usb(UsbError::NotFound | UsbError::Device(_)) | FalconError::Device(_))
                    if Instant::now() < until => {}
                Err(error) => return Err(error.into()),
            }
        };
        driver.reader.reads.store(true, Ordering::Release);
        request(RigRequest::EndOpen);
        (self.reader, self.now_us) = (Arc::clone(&driver.reader), 0);
        // Data left from opening is read before the first exchange.
        self.advance(0);
        Ok(Box::new(driver))
    }

    fn advance(&mut self, now_us: u64) {
        self.pass(now_us, now_us, 1);
    }

    fn advance_noting(&mut self, from_us: u64, until_us: u64, every_us: u64, truth: &mut Vec<(u64, Vec3)>) {
        let positions = self.pass(from_us, until_us, every_us);
        truth.extend((from_us..until_us).step_by(every_us as usize).zip(positions));
    }

    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn force_record(&self) -> ForceRecord {
        match request(RigRequest::ForceRecord) {
            RigReply::ForceRecord(felt) => felt,
            other => panic!("{other:?} to a record request"),
        }
    }

    fn reset_record(&mut self) {
        request(RigRequest::ResetForceRecord);
    }

    fn position_m(&self) -> Vec3 {
        self.positions().0
    }

    fn reported_m(&self) -> Vec3 {
        self.positions().1
    }

    fn follow(&mut self, path: Vec<Waypoint>) {
        request(RigRequest::Follow(path));
    }

    fn press(&mut self, buttons: u8) {
        request(RigRequest::PressButtons(buttons));
    }

    fn set_faults(&mut self, to_device: Faults, to_host: Faults) {
        request(RigRequest::Faults(to_device, to_host));
    }

    fn counts(&self) -> FaultCounts {
        match request(RigRequest::Counts) {
            RigReply::Counts(counts) => counts,
            other => panic!("{other:?} to a counts request"),
        }
    }

    fn replug(&mut self) {
        request(RigRequest::Replug);
    }

    fn inject(&mut self, fault: FaultKind) -> bool {
        request(RigRequest::InjectFault(fault));
        if matches!(fault, FaultKind::UnplugMidFrame | FaultKind::Replug) {
            // The guest's kernel needs time to detect it. Exchanges are counted from there.
            let until = Instant::now() + TIMEOUT;
            while self.reads() && Instant::now() < until {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        // A Falcon supports every fault.
        true
    }

    fn jump_encoder(&mut self, axis: usize, by_m: f32) {
        request(RigRequest::JumpEncoder { axis, by_m });
    }
}
