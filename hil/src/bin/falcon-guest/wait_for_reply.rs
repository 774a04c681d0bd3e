//! A wrapper that waits for the device's reply. The loop's time is virtual and advances by one tick after the
//! reply, so the speed of the machine does not matter.

use palpate_core::{Sample, Vec3};
use palpate_host::device::{DeviceState, DeviceWrapper};
use palpate_host::{Device, DeviceError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Wait for a device that is not homed and therefore sends no sample.
const UNHOMED_TIMEOUT: Duration = Duration::from_millis(2);
/// Lost exchanges that are logged.
const MAX_LOGGED: u64 = 3;
/// Fewest polls of a homed device before its reply counts as lost: on a stopped machine the clock advances
/// without polls.
const MIN_POLLS: u32 = 80;
/// Time between two polls.
const POLL_PERIOD: Duration = Duration::from_micros(250);

/// Counts of the exchanges.
#[derive(Debug, Default)]
pub(crate) struct ExchangeCounts {
    /// Exchanges with a sample.
    pub answered: AtomicU64,
    /// Exchanges of a homed device without a sample in time.
    pub lost: AtomicU64,
    /// Total time of the exchanges with a sample, us.
    pub total_us: AtomicU64,
    /// The longest of them, us.
    pub longest_us: AtomicU64,
    /// The last state of the device was disconnected.
    pub disconnected: AtomicBool,
    /// A fault is being injected: replies may be missing, and the wait is short.
    pub injected: AtomicBool,
}

/// Wait for a reply without a fault, and with one: a stopped machine is waited for, a fault is not.
const LONG_TIMEOUT: Duration = Duration::from_secs(2);
pub(crate) const SHORT_TIMEOUT: Duration = Duration::from_millis(20);

/// The device and its exchange counts.
#[derive(Debug)]
pub(crate) struct WaitForReply<D> {
    pub device: D,
    pub counts: Arc<ExchangeCounts>,
}

impl<D: Device> DeviceWrapper for WaitForReply<D> {
    type Inner = D;

    fn inner(&self) -> &D {
        &self.device
    }

    fn inner_mut(&mut self) -> &mut D {
        &mut self.device
    }

    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let start = Instant::now();
        let mut polls = 0;
        loop {
            polls += 1;
            let result = self.device.exchange(now_us, hand_force_n);
            let is_homed = self.device.state() == DeviceState::Homed;
            let timeout = match (is_homed, self.counts.injected.load(Ordering::Relaxed)) {
                (true, false) => LONG_TIMEOUT,
                (true, true) => SHORT_TIMEOUT,
                (false, _) => UNHOMED_TIMEOUT,
            };
            let elapsed = start.elapsed();
            let counts = &self.counts;
            counts.disconnected.store(self.device.state() == DeviceState::Disconnected, Ordering::Relaxed);
            match result {
                Ok(None) if elapsed < timeout || is_homed && polls < MIN_POLLS => {
                    std::thread::sleep(POLL_PERIOD)
                }
                Ok(Some(_)) => {
                    counts.answered.fetch_add(1, Ordering::Relaxed);
                    counts.total_us.fetch_add(elapsed.as_micros() as u64, Ordering::Relaxed);
                    counts.longest_us.fetch_max(elapsed.as_micros() as u64, Ordering::Relaxed);
                    return result;
                }
                _ => {
                    let before = counts.lost.fetch_add(u64::from(is_homed), Ordering::Relaxed);
                    if is_homed && before < MAX_LOGGED {
                        let why = result.as_ref().map_or_else(ToString::to_string, |_| "no reply".into());
                        println!("lost after {} us: {why}", elapsed.as_micros());
                    }
                    return result;
                }
            }
        }
    }
}
