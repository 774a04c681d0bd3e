//! The emulated Falcon in the driver's own process: the chip's transfers as the host's trait calls them.
//!
//! Time is virtual, and then a waiting call moves it, or it is that of the wall.

use super::descriptors::PACKET_LEN;
use super::{EmulatedFalcon, Setup};
use palpate_host::device::falcon::Ftdi;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How far virtual time goes at a time while a call waits, us.
const VIRTUAL_STEP_US: u64 = 10;
/// How long a call sleeps at a time while it waits in real time.
const REAL_STEP: Duration = Duration::from_micros(50);

/// A cable, a clock, and somebody who puts the one in by the other: what faults need of a link.
pub trait Link: Ftdi {
    /// The time, us.
    fn now_us(&self) -> u64;

    /// Pulls the cable.
    fn unplug(&self);

    /// Puts it in again. Who has the device open has lost it all the same.
    fn replug(&self);

    /// Opens the device anew, on the same handle.
    fn reopen(&self) -> Result<(), DeviceError>;
}

impl<L: Link + ?Sized> Link for Arc<L> {
    fn now_us(&self) -> u64 {
        (**self).now_us()
    }

    fn unplug(&self) {
        (**self).unplug();
    }

    fn replug(&self) {
        (**self).replug();
    }

    fn reopen(&self) -> Result<(), DeviceError> {
        (**self).reopen()
    }
}

/// An open handle of an emulated device.
///
/// Virtual time is the test's: `falcon().advance(t)`. A call with a timeout moves it until there is something or the timeout is over; one with
/// a zero timeout looks and does not move it. Two threads that both wait would both move it: give them real time.
#[derive(Debug)]
pub struct MemoryFtdi {
    falcon: Arc<Mutex<EmulatedFalcon>>,
    /// Real time: when it began, and what the device's time was then, us.
    begun: Option<(Instant, u64)>,
    /// The device's count of plugs when this handle was opened.
    plugs: AtomicU64,
}

const fn gone() -> DeviceError {
    DeviceError::new(DeviceErrorKind::Disconnected)
}

const fn nothing() -> DeviceError {
    DeviceError::new(DeviceErrorKind::Timeout)
}

impl MemoryFtdi {
    /// A device on virtual time.
    #[must_use]
    pub fn new(falcon: EmulatedFalcon) -> Self {
        let plugs = falcon.plugs().into();
        Self { falcon: Arc::new(Mutex::new(falcon)), begun: None, plugs }
    }

    /// A device on real time, which begins now.
    #[must_use]
    pub fn in_real_time(falcon: EmulatedFalcon) -> Self {
        let begun = Some((Instant::now(), falcon.now_us()));
        Self { begun, ..Self::new(falcon) }
    }

    /// Another handle of the same device, opened now.
    pub fn open_again(&self) -> Result<Self, DeviceError> {
        let falcon = self.falcon();
        if !falcon.is_plugged() {
            return Err(gone());
        }
        let plugs = falcon.plugs().into();
        Ok(Self { falcon: Arc::clone(&self.falcon), begun: self.begun, plugs })
    }

    /// The device behind it, at the time that it is.
    pub fn falcon(&self) -> MutexGuard<'_, EmulatedFalcon> {
        // A test that panicked elsewhere leaves the device as it was.
        let mut falcon = self.falcon.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((begun, from_us)) = self.begun {
            falcon.advance(from_us + begun.elapsed().as_micros() as u64);
        }
        falcon
    }

    /// The device, if this handle still is one of it.
    fn opened(&self) -> Result<MutexGuard<'_, EmulatedFalcon>, DeviceError> {
        let falcon = self.falcon();
        let is_open = falcon.is_plugged() && falcon.plugs() == self.plugs.load(Ordering::Relaxed);
        if is_open { Ok(falcon) } else { Err(gone()) }
    }

    /// Does something again and again until it says that it is done or the timeout is over.
    fn wait(
        &self,
        timeout: Duration,
        mut attempt: impl FnMut(&mut EmulatedFalcon) -> bool,
    ) -> Result<(), DeviceError> {
        let mut falcon = self.opened()?;
        let until_us = falcon.now_us() + timeout.as_micros() as u64;
        while !attempt(&mut falcon) && falcon.now_us() < until_us {
            if self.begun.is_some() {
                drop(falcon);
                std::thread::sleep(REAL_STEP);
                falcon = self.opened()?;
            } else {
                let next_us = (falcon.now_us() + VIRTUAL_STEP_US).min(until_us);
                falcon.advance(next_us);
            }
        }
        Ok(())
    }
}

impl Ftdi for MemoryFtdi {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        let answer = self.opened()?.control(Setup::vendor(request, value), &[]);
        answer.map(|_| ()).map_err(|_| DeviceError::new(DeviceErrorKind::Unsupported))
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        let mut count = 0;
        self.wait(timeout, |falcon| {
            count += falcon.bulk_out(&bytes[count..]);
            count == bytes.len()
        })?;
        if count == 0 && !bytes.is_empty() { Err(nothing()) } else { Ok(count) }
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        if buffer.len() < PACKET_LEN {
            // A packet that does not fit is lost, and the controller says overflow.
            return Err(DeviceError::new(DeviceErrorKind::Io));
        }
        let mut count = 0;
        self.wait(timeout, |falcon| {
            let Some(packets) = falcon.bulk_in(buffer.len() - count) else { return false };
            buffer[count..count + packets.len()].copy_from_slice(&packets);
            count += packets.len();
            // A short packet ends a transfer, and so does a full buffer.
            count % PACKET_LEN != 0 || buffer.len() - count < PACKET_LEN
        })?;
        if count == 0 { Err(nothing()) } else { Ok(count) }
    }
}

impl Link for MemoryFtdi {
    fn now_us(&self) -> u64 {
        self.falcon().now_us()
    }

    fn unplug(&self) {
        self.falcon().unplug();
    }

    fn replug(&self) {
        self.falcon().replug();
    }

    fn reopen(&self) -> Result<(), DeviceError> {
        let falcon = self.falcon();
        if !falcon.is_plugged() {
            return Err(gone());
        }
        self.plugs.store(falcon.plugs(), Ordering::Relaxed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falcon::FalconConfig;

    const LONG: Duration = Duration::from_secs(1);

    fn device() -> EmulatedFalcon {
        EmulatedFalcon::new(FalconConfig { firmware_runs: true, ..FalconConfig::default() })
    }

    #[test]
    fn looking_takes_no_time_and_waiting_takes_as_much_as_it_needs() {
        let ftdi = MemoryFtdi::new(device());
        let mut buffer = [0; 512];
        let looked = ftdi.read(&mut buffer, Duration::ZERO);
        assert_eq!((looked.map_err(|error| error.kind()), ftdi.now_us()), (Err(DeviceErrorKind::Timeout), 0));
        assert_eq!((ftdi.read(&mut buffer, LONG), ftdi.now_us()), (Ok(2), 16_000));
        let too_soon = ftdi.read(&mut buffer, Duration::from_micros(2_500));
        assert_eq!((too_soon.is_err(), ftdi.now_us()), (true, 18_500));
        assert!(ftdi.read(&mut [0; 63], LONG).is_err());
    }

    #[test]
    fn a_long_write_waits_for_room() {
        let ftdi = MemoryFtdi::new(device());
        ftdi.control(3, 2).expect("a rate");
        assert_eq!(ftdi.write(&[0; 300], Duration::ZERO), Ok(128));
        assert_eq!(
            ftdi.write(&[0; 300], Duration::ZERO).map_err(|e| e.kind()),
            Err(DeviceErrorKind::Timeout)
        );
        assert_eq!(ftdi.write(&[0; 300], LONG), Ok(300));
        // All but what is still in the buffer has gone over the wire.
        assert!((300 * 6_666..300 * 6_666 + 50_000).contains(&(ftdi.now_us() * 1_000)));
    }

    #[test]
    fn a_pulled_cable_loses_the_handle_for_good() {
        let ftdi = MemoryFtdi::new(device());
        ftdi.unplug();
        let kind = |error: DeviceError| error.kind();
        assert_eq!(ftdi.control(0, 0).map_err(kind), Err(DeviceErrorKind::Disconnected));
        assert_eq!(ftdi.write(b"x", LONG).map_err(kind), Err(DeviceErrorKind::Disconnected));
        assert_eq!(ftdi.read(&mut [0; 64], LONG).map_err(kind), Err(DeviceErrorKind::Disconnected));
        assert!(ftdi.reopen().is_err() && ftdi.open_again().is_err());
        ftdi.replug();
        assert_eq!(ftdi.control(0, 0).map_err(kind), Err(DeviceErrorKind::Disconnected));
        let other = ftdi.open_again().expect("it is in again");
        assert_eq!(other.control(0, 0), Ok(()));
        ftdi.reopen().expect("it is in again");
        assert_eq!(ftdi.control(0, 0), Ok(()));
    }

    /// At least as long as the latency timer says; how much longer is the machine's affair.
    #[test]
    fn real_time_goes_by_itself() {
        let ftdi = MemoryFtdi::in_real_time(device());
        let begun = Instant::now();
        assert_eq!(ftdi.read(&mut [0; 64], Duration::from_secs(10)), Ok(2));
        assert!(begun.elapsed() >= Duration::from_millis(15));
        assert!(ftdi.now_us() >= 16_000);
    }
}
