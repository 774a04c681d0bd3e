//! The emulated Falcon in the driver's own process: the chip's transfers as the host's trait calls them.
//!
//! Time is virtual, and then a waiting call moves it, or it is that of the wall. A driver with threads gets time in steps: one thread moves it, calls of
//! the others wait until it has, and no step ends before the reading thread has looked.

use super::descriptors::PACKET_LEN;
use super::{EmulatedFalcon, Setup};
use palpate_host::device::falcon::Ftdi;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::ThreadId;
use std::time::{Duration, Instant};

/// How far virtual time goes at a time while a call waits, us.
const VIRTUAL_STEP_US: u64 = 10;
/// How long a call sleeps at a time while it waits in real time.
const REAL_STEP: Duration = Duration::from_micros(50);
/// How far time goes before a reading thread looks again, us.
const READ_STEP_US: u64 = 250;
/// How long a thread of a busy machine may take for a look.
const CERTAIN: Duration = Duration::from_secs(20);

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

/// Whose time it is.
#[derive(Debug, Clone, Copy)]
enum Time {
    /// The test's, and any call that waits moves it.
    Virtual,
    /// The test's, and calls of this thread move it.
    Stepped(ThreadId),
    /// The wall's: when it began, and what the device's time was then, us.
    Real(Instant, u64),
}

/// The device, for all handles.
#[derive(Debug)]
struct Shared {
    falcon: Mutex<EmulatedFalcon>,
    /// In steps: time has moved, or a reading thread has looked.
    moved: Condvar,
}

/// The thread that reads from a handle whose time goes in steps. Written and read with the device locked.
#[derive(Debug, Default)]
struct Reader {
    reads: AtomicBool,
    /// It is wanted no more.
    released: AtomicBool,
    /// When it has looked in vain, us.
    looked_us: AtomicU64,
}

/// An open handle of an emulated device.
///
/// Virtual time is the test's: `falcon().advance(t)`. A call with a timeout moves it until there is something or the timeout is over; one with
/// a zero timeout looks and does not move it. Two threads that both wait would both move it: give them real time, or time in steps.
#[derive(Debug)]
pub struct MemoryFtdi {
    shared: Arc<Shared>,
    time: Time,
    reader: Reader,
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
        Self::timed(falcon, Time::Virtual)
    }

    /// A device on virtual time that only the caller's thread moves; for a driver with threads. [`MemoryFtdi::advance`] moves it.
    #[must_use]
    pub fn stepped(falcon: EmulatedFalcon) -> Self {
        Self::timed(falcon, Time::Stepped(std::thread::current().id()))
    }

    /// A device on real time, which begins now.
    #[must_use]
    pub fn in_real_time(falcon: EmulatedFalcon) -> Self {
        let from_us = falcon.now_us();
        Self::timed(falcon, Time::Real(Instant::now(), from_us))
    }

    fn timed(falcon: EmulatedFalcon, time: Time) -> Self {
        let plugs = falcon.plugs().into();
        let shared = Arc::new(Shared { falcon: Mutex::new(falcon), moved: Condvar::new() });
        Self { shared, time, reader: Reader::default(), plugs }
    }

    /// Another handle of the same device, opened now.
    pub fn open_again(&self) -> Result<Self, DeviceError> {
        let falcon = self.falcon();
        if !falcon.is_plugged() {
            return Err(gone());
        }
        let plugs = falcon.plugs().into();
        Ok(Self { shared: Arc::clone(&self.shared), time: self.time, reader: Reader::default(), plugs })
    }

    /// Virtual time goes on until then. In steps a thread that reads from this handle has taken all there is by the end of it.
    ///
    /// # Panics
    ///
    /// If that thread does not look for 20 s.
    pub fn advance(&self, until_us: u64) {
        if let Time::Stepped(_) = self.time {
            loop {
                let mut falcon = self.falcon();
                let next_us = (falcon.now_us() + READ_STEP_US).min(until_us);
                falcon.advance(next_us);
                self.shared.moved.notify_all();
                self.wait_looked(falcon);
                if next_us >= until_us {
                    return;
                }
            }
        }
        self.falcon().advance(until_us);
    }

    /// Until the thread that reads has begun and has taken all there is.
    pub(crate) fn wait_reading(&self) {
        let until = Instant::now() + CERTAIN;
        while !self.reader.reads.load(Ordering::Relaxed) {
            assert!(Instant::now() < until, "nobody reads");
            std::thread::yield_now();
        }
        self.wait_looked(self.falcon());
    }

    /// Whoever waits in a call waits no more, and nobody waits for whom reads: the driver is being dropped.
    pub(crate) fn release(&self) {
        let falcon = self.falcon();
        self.reader.released.store(true, Ordering::Relaxed);
        self.reader.reads.store(false, Ordering::Relaxed);
        drop(falcon);
        self.shared.moved.notify_all();
    }

    fn wait_looked(&self, mut falcon: MutexGuard<'_, EmulatedFalcon>) {
        let Reader { reads, looked_us, .. } = &self.reader;
        while reads.load(Ordering::Relaxed) && looked_us.load(Ordering::Relaxed) < falcon.now_us() {
            let waited = self.shared.moved.wait_timeout(falcon, CERTAIN);
            let (woken, waited) = waited.unwrap_or_else(PoisonError::into_inner);
            assert!(!waited.timed_out(), "the thread that reads hangs");
            falcon = woken;
        }
    }

    /// A call of a thread that does not move time waits until somebody does: `None` if its handle is lost.
    fn wait_moved<'f>(
        &'f self,
        falcon: MutexGuard<'f, EmulatedFalcon>,
        reads: bool,
    ) -> Option<MutexGuard<'f, EmulatedFalcon>> {
        let Reader { reads: reading, released, looked_us } = &self.reader;
        if reads && !released.load(Ordering::Relaxed) {
            reading.store(true, Ordering::Relaxed);
            looked_us.store(falcon.now_us(), Ordering::Relaxed);
            self.shared.moved.notify_all();
        }
        let before_us = falcon.now_us();
        let still = |falcon: &mut EmulatedFalcon| {
            falcon.now_us() == before_us && self.is_open(falcon) && !released.load(Ordering::Relaxed)
        };
        let falcon = self.shared.moved.wait_while(falcon, still).unwrap_or_else(PoisonError::into_inner);
        let is_lost = !self.is_open(&falcon) || released.load(Ordering::Relaxed);
        if is_lost {
            reading.store(false, Ordering::Relaxed);
            self.shared.moved.notify_all();
        }
        (!is_lost).then_some(falcon)
    }

    /// The device behind it, at the time that it is.
    pub fn falcon(&self) -> MutexGuard<'_, EmulatedFalcon> {
        // A test that panicked elsewhere leaves the device as it was.
        let mut falcon = self.shared.falcon.lock().unwrap_or_else(PoisonError::into_inner);
        if let Time::Real(begun, from_us) = self.time {
            falcon.advance(from_us + begun.elapsed().as_micros() as u64);
        }
        falcon
    }

    /// Whether this handle still is one of the device.
    fn is_open(&self, falcon: &EmulatedFalcon) -> bool {
        falcon.is_plugged() && falcon.plugs() == self.plugs.load(Ordering::Relaxed)
    }

    /// The device, if this handle still is one of it.
    fn opened(&self) -> Result<MutexGuard<'_, EmulatedFalcon>, DeviceError> {
        let falcon = self.falcon();
        if self.is_open(&falcon) {
            return Ok(falcon);
        }
        // Whoever reads will not any more.
        self.reader.reads.store(false, Ordering::Relaxed);
        self.shared.moved.notify_all();
        Err(gone())
    }

    /// Does something again and again until it says that it is done or the timeout is over.
    fn wait(
        &self,
        timeout: Duration,
        reads: bool,
        mut attempt: impl FnMut(&mut EmulatedFalcon) -> bool,
    ) -> Result<(), DeviceError> {
        let mut falcon = self.opened()?;
        let until_us = falcon.now_us() + timeout.as_micros() as u64;
        while !attempt(&mut falcon) && falcon.now_us() < until_us {
            match self.time {
                Time::Real(..) => {
                    drop(falcon);
                    std::thread::sleep(REAL_STEP);
                    falcon = self.opened()?;
                }
                Time::Stepped(mover) if mover != std::thread::current().id() => {
                    falcon = self.wait_moved(falcon, reads).ok_or_else(gone)?;
                }
                Time::Virtual | Time::Stepped(_) => {
                    let next_us = (falcon.now_us() + VIRTUAL_STEP_US).min(until_us);
                    falcon.advance(next_us);
                    self.shared.moved.notify_all();
                }
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
        self.wait(timeout, false, |falcon| {
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
        self.wait(timeout, true, |falcon| {
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

    /// Whatever the scheduler does: at the end of a step the reading thread has all that was sent by then, and a call that waits ends with its driver.
    #[test]
    fn in_steps_time_is_moved_by_one_thread_and_no_step_ends_before_the_other_has_looked() {
        let ftdi = Arc::new(MemoryFtdi::stepped(device()));
        let read = Arc::new(AtomicU64::new(0));
        let (chip, count) = (Arc::clone(&ftdi), Arc::clone(&read));
        let reader = std::thread::spawn(move || {
            let mut buffer = [0; 512];
            loop {
                match chip.read(&mut buffer, Duration::from_millis(100)) {
                    Ok(got) => drop(count.fetch_add(got as u64, Ordering::Relaxed)),
                    Err(error) if error.kind() == DeviceErrorKind::Timeout => {}
                    Err(error) => return error.kind(),
                }
            }
        });
        ftdi.wait_reading();
        assert_eq!((ftdi.now_us(), read.load(Ordering::Relaxed)), (0, 0));
        for packets in 1..50 {
            // An idle packet each 16 ms.
            ftdi.advance(16_000 * packets);
            assert_eq!((ftdi.now_us(), read.load(Ordering::Relaxed)), (16_000 * packets, 2 * packets));
        }
        ftdi.release();
        assert_eq!(reader.join().expect("it ends"), DeviceErrorKind::Disconnected);
        ftdi.advance(2_000_000);
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
