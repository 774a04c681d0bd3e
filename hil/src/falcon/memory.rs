//! The emulated Falcon in the driver's own process, behind the trait of the USB chip.
//!
//! Time is virtual and advanced by blocking calls, or it is real time. A driver with threads uses stepped
//! time: one thread advances it, calls of the other threads wait for that, and a step ends only after the
//! reading thread has polled.

use super::descriptors::PACKET_LEN;
use super::{EmulatedFalcon, Setup};
use palpate_host::device::falcon::Ftdi;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::ThreadId;
use std::time::{Duration, Instant};

/// Step of virtual time during a blocking call, us.
const VIRTUAL_STEP_US: u64 = 10;
/// Sleep between polls in real time.
const REAL_STEP: Duration = Duration::from_micros(50);
/// Step of stepped time before the reading thread polls again, us.
const READ_STEP_US: u64 = 250;
/// Longest time for a poll of another thread on a busy machine.
const MAX_WAIT: Duration = Duration::from_secs(20);

/// A link with a clock and a cable, as fault injection needs it.
pub trait Link: Ftdi {
    /// The time, us.
    fn now_us(&self) -> u64;

    /// Pulls the cable.
    fn unplug(&self);

    /// Plugs the cable in again. Handles that were open before stay lost.
    fn replug(&self);

    /// Opens the device again on the same handle.
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

/// Source of the time.
#[derive(Debug, Clone, Copy)]
enum Time {
    /// Virtual time, advanced by the test and by any blocking call.
    Virtual,
    /// Virtual time, advanced only by calls of this thread.
    Stepped(ThreadId),
    /// Real time: its start, and the device's time at the start, us.
    Real(Instant, u64),
}

/// The device, shared by all handles.
#[derive(Debug)]
struct Shared {
    falcon: Mutex<EmulatedFalcon>,
    /// Signalled when stepped time has advanced or the reading thread has polled.
    time_moved: Condvar,
}

/// State of the reading thread of a stepped handle. Accessed with the device locked.
#[derive(Debug, Default)]
struct Reader {
    reads: AtomicBool,
    /// The driver is being dropped.
    released: AtomicBool,
    /// Time of its last poll without data, us.
    polled_us: AtomicU64,
}

/// An open handle of an emulated device.
///
/// The test advances virtual time by `falcon().advance(t)`. A call with a timeout advances it until data
/// arrives or the timeout ends. A call with a zero timeout does not advance it. Two blocking threads would
/// both advance virtual time, so they need real or stepped time.
#[derive(Debug)]
pub struct MemoryFtdi {
    shared: Arc<Shared>,
    time: Time,
    reader: Reader,
    /// The device's plug count when this handle was opened.
    plug_count: AtomicU64,
}

const fn disconnected() -> DeviceError {
    DeviceError::new(DeviceErrorKind::Disconnected)
}

const fn timed_out() -> DeviceError {
    DeviceError::new(DeviceErrorKind::Timeout)
}

impl MemoryFtdi {
    /// A device on virtual time.
    #[must_use]
    pub fn new(falcon: EmulatedFalcon) -> Self {
        Self::timed(falcon, Time::Virtual)
    }

    /// A device on virtual time that only the caller's thread advances, by [`MemoryFtdi::advance`]. For a
    /// driver with threads.
    #[must_use]
    pub fn stepped(falcon: EmulatedFalcon) -> Self {
        Self::timed(falcon, Time::Stepped(std::thread::current().id()))
    }

    /// A device on real time, which starts now.
    #[must_use]
    pub fn in_real_time(falcon: EmulatedFalcon) -> Self {
        let from_us = falcon.now_us();
        Self::timed(falcon, Time::Real(Instant::now(), from_us))
    }

    fn timed(falcon: EmulatedFalcon, time: Time) -> Self {
        let plug_count = falcon.plug_count().into();
        let shared = Arc::new(Shared { falcon: Mutex::new(falcon), time_moved: Condvar::new() });
        Self { shared, time, reader: Reader::default(), plug_count }
    }

    /// Opens another handle of the same device.
    pub fn open_again(&self) -> Result<Self, DeviceError> {
        let falcon = self.falcon();
        if !falcon.is_plugged() {
            return Err(disconnected());
        }
        let plug_count = falcon.plug_count().into();
        Ok(Self { shared: Arc::clone(&self.shared), time: self.time, reader: Reader::default(), plug_count })
    }

    /// Advances virtual time. In stepped time a thread that reads from this handle has received all data by
    /// the end.
    ///
    /// # Panics
    ///
    /// If that thread does not poll for 20 s.
    pub fn advance(&self, until_us: u64) {
        if let Time::Stepped(_) = self.time {
            loop {
                let mut falcon = self.falcon();
                let next_us = (falcon.now_us() + READ_STEP_US).min(until_us);
                falcon.advance(next_us);
                self.shared.time_moved.notify_all();
                self.wait_for_reader(falcon);
                if next_us >= until_us {
                    return;
                }
            }
        }
        self.falcon().advance(until_us);
    }

    /// Waits until the reading thread has started and has received all data.
    pub(crate) fn wait_until_reading(&self) {
        let until = Instant::now() + MAX_WAIT;
        while !self.reader.reads.load(Ordering::Relaxed) {
            assert!(Instant::now() < until, "no thread reads");
            std::thread::yield_now();
        }
        self.wait_for_reader(self.falcon());
    }

    /// Ends all waits, because the driver is being dropped.
    pub(crate) fn release(&self) {
        let falcon = self.falcon();
        self.reader.released.store(true, Ordering::Relaxed);
        self.reader.reads.store(false, Ordering::Relaxed);
        drop(falcon);
        self.shared.time_moved.notify_all();
    }

    fn wait_for_reader(&self, mut falcon: MutexGuard<'_, EmulatedFalcon>) {
        let Reader { reads, polled_us, .. } = &self.reader;
        while reads.load(Ordering::Relaxed) && polled_us.load(Ordering::Relaxed) < falcon.now_us() {
            let waited = self.shared.time_moved.wait_timeout(falcon, MAX_WAIT);
            let (woken, waited) = waited.unwrap_or_else(PoisonError::into_inner);
            assert!(!waited.timed_out(), "the reading thread hangs");
            falcon = woken;
        }
    }

    /// Waits in a thread that does not advance time until another one does. `None` if the handle is lost.
    fn wait_for_time<'f>(
        &'f self,
        falcon: MutexGuard<'f, EmulatedFalcon>,
        reads: bool,
    ) -> Option<MutexGuard<'f, EmulatedFalcon>> {
        let Reader { reads: reading, released, polled_us } = &self.reader;
        if reads && !released.load(Ordering::Relaxed) {
            reading.store(true, Ordering::Relaxed);
            polled_us.store(falcon.now_us(), Ordering::Relaxed);
            self.shared.time_moved.notify_all();
        }
        let before_us = falcon.now_us();
        let still = |falcon: &mut EmulatedFalcon| {
            falcon.now_us() == before_us && self.is_open(falcon) && !released.load(Ordering::Relaxed)
        };
        let falcon = self.shared.time_moved.wait_while(falcon, still).unwrap_or_else(PoisonError::into_inner);
        let is_lost = !self.is_open(&falcon) || released.load(Ordering::Relaxed);
        if is_lost {
            reading.store(false, Ordering::Relaxed);
            self.shared.time_moved.notify_all();
        }
        (!is_lost).then_some(falcon)
    }

    /// The device at the present time.
    pub fn falcon(&self) -> MutexGuard<'_, EmulatedFalcon> {
        // A panic of another test leaves the device valid.
        let mut falcon = self.shared.falcon.lock().unwrap_or_else(PoisonError::into_inner);
        if let Time::Real(start, from_us) = self.time {
            falcon.advance(from_us + start.elapsed().as_micros() as u64);
        }
        falcon
    }

    /// Whether this handle is still open.
    fn is_open(&self, falcon: &EmulatedFalcon) -> bool {
        falcon.is_plugged() && falcon.plug_count() == self.plug_count.load(Ordering::Relaxed)
    }

    /// The device, if this handle is still open.
    fn opened(&self) -> Result<MutexGuard<'_, EmulatedFalcon>, DeviceError> {
        let falcon = self.falcon();
        if self.is_open(&falcon) {
            return Ok(falcon);
        }
        // The reading thread stops.
        self.reader.reads.store(false, Ordering::Relaxed);
        self.shared.time_moved.notify_all();
        Err(disconnected())
    }

    /// Repeats an attempt until it succeeds or the timeout ends.
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
                    falcon = self.wait_for_time(falcon, reads).ok_or_else(disconnected)?;
                }
                Time::Virtual | Time::Stepped(_) => {
                    let next_us = (falcon.now_us() + VIRTUAL_STEP_US).min(until_us);
                    falcon.advance(next_us);
                    self.shared.time_moved.notify_all();
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
        if count == 0 && !bytes.is_empty() { Err(timed_out()) } else { Ok(count) }
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        if buffer.len() < PACKET_LEN {
            // A packet that does not fit is lost, and a USB controller reports an overflow.
            return Err(DeviceError::new(DeviceErrorKind::Io));
        }
        let mut count = 0;
        self.wait(timeout, true, |falcon| {
            let Some(packets) = falcon.bulk_in(buffer.len() - count) else { return false };
            buffer[count..count + packets.len()].copy_from_slice(&packets);
            count += packets.len();
            // A transfer ends with a short packet or a full buffer.
            count % PACKET_LEN != 0 || buffer.len() - count < PACKET_LEN
        })?;
        if count == 0 { Err(timed_out()) } else { Ok(count) }
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
            return Err(disconnected());
        }
        self.plug_count.store(falcon.plug_count(), Ordering::Relaxed);
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
    fn polling_takes_no_time_and_waiting_takes_the_time_until_data() {
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
        // All bytes have crossed the wire except those in the buffer.
        assert!((300 * 6_666..300 * 6_666 + 50_000).contains(&(ftdi.now_us() * 1_000)));
    }

    #[test]
    fn unplugging_loses_the_handle_permanently() {
        let ftdi = MemoryFtdi::new(device());
        ftdi.unplug();
        let kind = |error: DeviceError| error.kind();
        assert_eq!(ftdi.control(0, 0).map_err(kind), Err(DeviceErrorKind::Disconnected));
        assert_eq!(ftdi.write(b"x", LONG).map_err(kind), Err(DeviceErrorKind::Disconnected));
        assert_eq!(ftdi.read(&mut [0; 64], LONG).map_err(kind), Err(DeviceErrorKind::Disconnected));
        assert!(ftdi.reopen().is_err() && ftdi.open_again().is_err());
        ftdi.replug();
        assert_eq!(ftdi.control(0, 0).map_err(kind), Err(DeviceErrorKind::Disconnected));
        let other = ftdi.open_again().expect("it is plugged in again");
        assert_eq!(other.control(0, 0), Ok(()));
        ftdi.reopen().expect("it is plugged in again");
        assert_eq!(ftdi.control(0, 0), Ok(()));
    }

    /// Under any scheduling the reading thread has all data at the end of a step, and a blocking call ends
    /// when the driver is dropped.
    #[test]
    fn a_time_step_ends_after_the_reading_thread_has_polled() {
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
        ftdi.wait_until_reading();
        assert_eq!((ftdi.now_us(), read.load(Ordering::Relaxed)), (0, 0));
        for packets in 1..50 {
            // One idle packet every 16 ms.
            ftdi.advance(16_000 * packets);
            assert_eq!((ftdi.now_us(), read.load(Ordering::Relaxed)), (16_000 * packets, 2 * packets));
        }
        ftdi.release();
        assert_eq!(reader.join().expect("it ends"), DeviceErrorKind::Disconnected);
        ftdi.advance(2_000_000);
    }

    /// Reading takes at least the latency timer; the machine may add to it.
    #[test]
    fn real_time_advances_by_itself() {
        let ftdi = MemoryFtdi::in_real_time(device());
        let start = Instant::now();
        assert_eq!(ftdi.read(&mut [0; 64], Duration::from_secs(10)), Ok(2));
        assert!(start.elapsed() >= Duration::from_millis(15));
        assert!(ftdi.now_us() >= 16_000);
    }
}
