//! The Falcon on the guest's USB as a rig: the real driver here, its device in the bench, whose time goes on when this says so.

use crate::line::Line;
use crate::patient::{Patient, Reader};
use palpate_core::{Sample, Vec3};
use palpate_hil::bench::{Ask, Told};
use palpate_hil::fault::{FaultCounts, Faults};
use palpate_hil::felt::Felt;
use palpate_hil::mechanism::Waypoint;
use palpate_hil::rig::{Cut, FalconRig, Kind, Mishap, OpenError, Rig, Traits};
use palpate_host::device::DeviceWrapper;
use palpate_host::device::falcon::usb::UsbError;
use palpate_host::device::falcon::{Falcon, FalconConfig, FalconError, Image, Mode, UsbFtdi};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_host::{Device, DeviceError};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// For a device that was plugged in to be there, and for one that was pulled to be missed.
const PATIENCE: Duration = Duration::from_secs(60);
/// Shortest wait of a write: the bus of a machine that is not real may be late, and the device's time stands still meanwhile.
const WRITE: Duration = Duration::from_secs(2);
/// Longest wait of a read: what the end of a driver may take, in each of some hundred openings.
const READ: Duration = Duration::from_millis(20);
/// Words of the firmware, which is none.
const FIRMWARE_WORDS: u16 = 500;

/// The line to the bench, for all rigs one after the other.
static LINE: OnceLock<Mutex<Line>> = OnceLock::new();

/// The rig, as the suite makes it; from here on the line is its own.
pub(crate) fn kind(line: Line) -> Kind {
    // Once in the life of the process.
    let _ = LINE.set(Mutex::new(line));
    Kind { name: "falcon-qemu", in_memory: false, make: |seed| Box::new(FarRig::new(seed)) }
}

/// What is asked of the bench.
///
/// # Panics
///
/// If it does not answer: the check that asked fails.
fn ask(ask: Ask) -> Told {
    let mut line = LINE.get().expect("set").lock().unwrap_or_else(PoisonError::into_inner);
    let answer = line.ask(&ask).unwrap_or_else(|error| panic!("{ask}: {error}"));
    answer.parse().unwrap_or_else(|_| panic!("the bench says `{answer}` to `{ask}`"))
}

/// The driver; when it is gone nobody reads.
struct Driver {
    inner: Falcon<Patient>,
    reader: Arc<Reader>,
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.reader.reads.store(false, Ordering::Release);
    }
}

impl DeviceWrapper for Driver {
    type Inner = Falcon<Patient>;

    fn inner(&self) -> &Falcon<Patient> {
        &self.inner
    }

    fn inner_mut(&mut self) -> &mut Falcon<Patient> {
        &mut self.inner
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let exchanged = self.inner.exchange(now_us, hand_force_n);
        // The device's time does not go on before it has what was sent.
        self.inner.wait_attempted(WRITE);
        exchanged
    }
}

struct FarRig {
    profile: Profile,
    traits: Traits,
    now_us: u64,
    reader: Arc<Reader>,
}

impl FarRig {
    fn new(seed: u64) -> Self {
        ask(Ask::Fresh { seed });
        // What the device is like it is in memory too.
        let like = FalconRig::new(seed);
        Self { profile: like.profile().clone(), traits: like.traits(), now_us: 0, reader: Arc::default() }
    }

    fn reads(&self) -> bool {
        self.reader.reads.load(Ordering::Acquire)
    }

    fn try_open(&self, config: FalconConfig, image: &Image) -> Result<Driver, FalconError> {
        let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
        let patient = Patient::new(chip, WRITE, READ);
        let reader = patient.reader();
        Ok(Driver { inner: Falcon::start(Arc::new(patient), config, Some(image))?, reader })
    }

    fn pass(&mut self, from_us: u64, until_us: u64, every_us: u64) -> Vec<Vec3> {
        let told = ask(Ask::Pass { from_us, until_us, every_us, is_read: self.reads() });
        self.now_us = self.now_us.max(until_us);
        match told {
            Told::Was(places) => places,
            other => panic!("{other:?} to a time"),
        }
    }

    fn places(&self) -> (Vec3, Vec3) {
        match ask(Ask::Place) {
            Told::Place(is, said) => (is, said),
            other => panic!("{other:?} to a place"),
        }
    }
}

impl Rig for FarRig {
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
        let (image, until) = (Image::synthetic(FIRMWARE_WORDS), Instant::now() + PATIENCE);
        ask(Ask::Run);
        let driver = loop {
            match self.try_open(config, &image) {
                Ok(driver) => break driver,
                // The guest's kernel has not seen yet what was plugged in or pulled.
                Err(FalconError::Usb(UsbError::NotFound | UsbError::Device(_)) | FalconError::Device(_))
                    if Instant::now() < until => {}
                Err(error) => return Err(error.into()),
            }
        };
        driver.reader.reads.store(true, Ordering::Release);
        ask(Ask::Hold);
        (self.reader, self.now_us) = (Arc::clone(&driver.reader), 0);
        // What opening has left is read before the first exchange.
        self.advance(0);
        Ok(Box::new(driver))
    }

    fn advance(&mut self, now_us: u64) {
        self.pass(now_us, now_us, 1);
    }

    fn advance_noting(&mut self, from_us: u64, until_us: u64, every_us: u64, truth: &mut Vec<(u64, Vec3)>) {
        let places = self.pass(from_us, until_us, every_us);
        truth.extend((from_us..until_us).step_by(every_us as usize).zip(places));
    }

    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn felt(&self) -> Felt {
        match ask(Ask::Felt) {
            Told::Felt(felt) => felt,
            other => panic!("{other:?} to what was felt"),
        }
    }

    fn forget(&mut self) {
        ask(Ask::Forget);
    }

    fn position_m(&self) -> Vec3 {
        self.places().0
    }

    fn reported_m(&self) -> Vec3 {
        self.places().1
    }

    fn follow(&mut self, path: Vec<Waypoint>) {
        ask(Ask::Follow(path));
    }

    fn press(&mut self, buttons: u8) {
        ask(Ask::Press(buttons));
    }

    fn set_faults(&mut self, to_device: Faults, to_host: Faults) {
        ask(Ask::Faults(to_device, to_host));
    }

    fn counts(&self) -> FaultCounts {
        match ask(Ask::Counts) {
            Told::Counts(counts) => counts,
            other => panic!("{other:?} to what went wrong"),
        }
    }

    fn unplug(&mut self, cut: Cut) {
        ask(Ask::Unplug(cut));
        // The guest's kernel takes its own time to miss it; the driver's exchanges are counted from there.
        let until = Instant::now() + PATIENCE;
        while self.reads() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn replug(&mut self) {
        ask(Ask::Replug);
    }

    fn strike(&mut self, mishap: Mishap) -> bool {
        // Each of them can happen to a Falcon.
        ask(Ask::Strike(mishap));
        true
    }
}
