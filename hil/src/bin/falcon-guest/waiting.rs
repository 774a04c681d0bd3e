//! A device that is waited for: time in the loop is virtual and goes on by a tick when the reply has come, however slow the machine is.

use palpate_core::{Sample, Vec3};
use palpate_host::device::{DeviceState, DeviceWrapper};
use palpate_host::{Device, DeviceError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// For a device without a sample to give: it is not homed.
const UNHOMED: Duration = Duration::from_millis(2);
/// Lost exchanges that are told of.
const TOLD: u64 = 3;
/// Looks that a reply is waited for at least, however long they take: on a machine that stands still time goes on and nobody else does.
const LOOKS: u32 = 80;
/// Between two looks.
const PAUSE: Duration = Duration::from_micros(250);

/// What came of the exchanges.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    /// Exchanges that brought a sample.
    pub answered: AtomicU64,
    /// Exchanges of a homed device that brought none in time.
    pub lost: AtomicU64,
    /// Time spent on those that did, us.
    pub spent_us: AtomicU64,
    /// The longest of them, us.
    pub longest_us: AtomicU64,
    /// The device was last said to be disconnected.
    pub gone: AtomicBool,
    /// A fault is on: replies may be missing, and are not waited for as long as where none is.
    pub struck: AtomicBool,
}

/// For a reply where none is to be missing, and where some are: a machine that stands still is waited for, a fault is not.
const PATIENT: Duration = Duration::from_secs(2);
pub(crate) const IMPATIENT: Duration = Duration::from_millis(20);

/// The device, and how long its reply is waited for.
#[derive(Debug)]
pub(crate) struct Waiting<D> {
    pub device: D,
    pub tally: Arc<Tally>,
}

impl<D: Device> DeviceWrapper for Waiting<D> {
    type Inner = D;

    fn inner(&self) -> &D {
        &self.device
    }

    fn inner_mut(&mut self) -> &mut D {
        &mut self.device
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let begun = Instant::now();
        let mut looks = 0;
        loop {
            looks += 1;
            let result = self.device.exchange(now_us, hand_force_n);
            let is_homed = self.device.state() == DeviceState::Homed;
            let patience = match (is_homed, self.tally.struck.load(Ordering::Relaxed)) {
                (true, false) => PATIENT,
                (true, true) => IMPATIENT,
                (false, _) => UNHOMED,
            };
            let elapsed = begun.elapsed();
            let tally = &self.tally;
            tally.gone.store(self.device.state() == DeviceState::Disconnected, Ordering::Relaxed);
            match result {
                Ok(None) if elapsed < patience || is_homed && looks < LOOKS => std::thread::sleep(PAUSE),
                Ok(Some(_)) => {
                    tally.answered.fetch_add(1, Ordering::Relaxed);
                    tally.spent_us.fetch_add(elapsed.as_micros() as u64, Ordering::Relaxed);
                    tally.longest_us.fetch_max(elapsed.as_micros() as u64, Ordering::Relaxed);
                    return result;
                }
                _ => {
                    let before = tally.lost.fetch_add(u64::from(is_homed), Ordering::Relaxed);
                    if is_homed && before < TOLD {
                        let why = result.as_ref().map_or_else(ToString::to_string, |_| "no reply".into());
                        println!("lost after {} us: {why}", elapsed.as_micros());
                    }
                    return result;
                }
            }
        }
    }
}
