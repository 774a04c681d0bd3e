//! The testbed of the processes: an emulated device in real time, and the observed forces at its motors.

use super::host::{Host, happens_within};
use super::process::{Device, Role, command};
use crate::force_record::ForceRecord;
use crate::link::EmulatedLink;
use crate::polhem::EmulatedPolhem;
use crate::rig::SerialDevice;
use crate::transport::PtyTransport;
use palpate_core::{Vec3, vec3};
use palpate_host::device::profile::Profile;
use palpate_host::sys::{self, RtRequest};
use serialport::{SerialPort, TTYPort};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Poll period of the device.
const POLL_PERIOD: Duration = Duration::from_micros(100);
/// Largest step of the testbed's clock between two polls, us. A longer pause is one of the whole machine,
/// with host and guard, and does not count.
const MAX_CLOCK_STEP_US: u64 = 2_000;

/// Observed forces at the motors. Times are on the testbed's clock, us.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Present force, N.
    pub force_n: Vec3,
    /// Valid requests so far.
    pub requests: u64,
    /// Time of the last request with a force.
    pub last_force_us: Option<u64>,
    /// Time at which the force last became zero.
    pub zeroed_us: Option<u64>,
    /// Time of the newest look.
    pub now_us: u64,
    /// Time of the signal to a process.
    pub signal_us: u64,
    /// Time since which the device's own watchdog has been latched; `None` while it is not, or without one.
    pub latched_us: Option<u64>,
}

impl Observation {
    /// Time from the signal to zero force, us; `None` while there is a force.
    #[must_use]
    pub fn zeroed_since_signal_us(&self) -> Option<u64> {
        self.zeroed_us.filter(|_| self.force_n == vec3::ZERO)?.checked_sub(self.signal_us)
    }

    /// Time from the last request with a force to the latch of the device's own watchdog, us.
    #[must_use]
    pub fn latch_after_us(&self) -> Option<u64> {
        Some(self.latched_us?.saturating_sub(self.last_force_us?))
    }
}

/// An emulated device that is observed from outside.
trait ObservedDevice: Send + 'static {
    /// Serves the requests that have arrived by `now_us`.
    fn poll(&mut self, now_us: u64);
    fn force_record(&self) -> ForceRecord;
    fn reset_record(&mut self);
    fn requests(&self) -> u64;

    /// Whether its own watchdog is latched.
    fn has_latched(&self) -> bool {
        false
    }
}

struct TerminalDevice<E> {
    device: E,
    link: PtyTransport,
    /// Requests before the last reset of the record.
    requests_before_reset: u64,
    /// Keeps the terminal open.
    _driver_end: TTYPort,
}

impl<E: SerialDevice> ObservedDevice for TerminalDevice<E> {
    fn poll(&mut self, now_us: u64) {
        self.device.poll(now_us, &mut self.link).expect("the terminal is open");
    }

    fn force_record(&self) -> ForceRecord {
        *self.device.handle().force_record()
    }

    fn reset_record(&mut self) {
        self.requests_before_reset = self.requests();
        self.device.handle_mut().reset_record();
    }

    fn requests(&self) -> u64 {
        self.requests_before_reset + self.device.handle().force_record().commands
    }

    fn has_latched(&self) -> bool {
        self.device.has_latched()
    }
}

/// A device on a pseudo terminal, and the name of the driver's end.
fn terminal_device<E: SerialDevice>() -> (Box<dyn ObservedDevice>, String) {
    let (link, driver_end) = PtyTransport::pair().expect("a pseudo terminal");
    let address = driver_end.name().expect("the terminal has a name");
    let profile = Profile::bundled(E::profile()).expect("an emulated device has a bundled profile");
    let device = E::new(&profile);
    (Box::new(TerminalDevice { device, link, requests_before_reset: 0, _driver_end: driver_end }), address)
}

/// An emulated device and the thread that serves it.
pub struct Testbed {
    device: Device,
    observed_device: Arc<Mutex<(Box<dyn ObservedDevice>, Observation)>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    address: String,
}

impl Testbed {
    /// A device that waits for a driver.
    ///
    /// # Panics
    ///
    /// Where there are no pseudo terminals or sockets.
    #[must_use]
    pub fn new(device: Device) -> Self {
        let (observed_device, address): (Box<dyn ObservedDevice>, String) = match device {
            Device::Polhem => terminal_device::<EmulatedPolhem>(),
            Device::Link => terminal_device::<EmulatedLink>(),
        };
        let seen = Observation {
            force_n: vec3::ZERO,
            requests: 0,
            last_force_us: None,
            zeroed_us: None,
            now_us: 0,
            signal_us: 0,
            latched_us: None,
        };
        let (observed_device, ends) =
            (Arc::new(Mutex::new((observed_device, seen))), Arc::new(AtomicBool::new(false)));
        let (served, stop) = (Arc::clone(&observed_device), Arc::clone(&ends));
        let serve = move || {
            // A real device does not depend on this machine's scheduler: a priority above hosts and guards,
            // where allowed.
            let above = RtRequest { fifo_priority: Some(52), ..RtRequest::none() };
            let (_, _held) = sys::enter_real_time(&above);
            let (mut now_us, mut looked) = (0, Instant::now());
            while !stop.load(Ordering::Relaxed) {
                let before = std::mem::replace(&mut looked, Instant::now());
                now_us += (looked.duration_since(before).as_micros() as u64).min(MAX_CLOCK_STEP_US);
                observe(&mut served.lock().unwrap_or_else(PoisonError::into_inner), now_us);
                std::thread::sleep(POLL_PERIOD);
            }
        };
        Self { device, observed_device, ends, thread: Some(std::thread::spawn(serve)), address }
    }

    /// The observation so far.
    #[must_use]
    pub fn observed(&self) -> Observation {
        self.observed_device.lock().unwrap_or_else(PoisonError::into_inner).1
    }

    /// Notes that a signal is sent to a process now.
    pub fn note_signal(&self) {
        let mut observed = self.observed_device.lock().unwrap_or_else(PoisonError::into_inner);
        observed.1.signal_us = observed.1.now_us;
    }

    /// Record of the force on the hand.
    #[must_use]
    pub fn force_record(&self) -> ForceRecord {
        self.observed_device.lock().unwrap_or_else(PoisonError::into_inner).0.force_record()
    }

    /// Resets the record of the force on the hand.
    pub fn reset_record(&self) {
        self.observed_device.lock().unwrap_or_else(PoisonError::into_inner).0.reset_record();
    }

    /// Starts a host process that renders a force. Its guard sets zero force `limit_ms` after the last tick.
    ///
    /// # Panics
    ///
    /// If `program` does not start.
    #[must_use]
    pub fn host(&self, program: &Path, role: Role, limit_ms: u32, force_n: Vec3) -> Host {
        Host::start(command(program, role, self.device, &self.address, limit_ms, force_n))
    }

    /// Whether the device has the host's force on its motors within a time and still receives requests.
    fn has_force(&self, force_n: Vec3, time: Duration) -> bool {
        happens_within(time, || {
            let before = self.observed().requests;
            std::thread::sleep(Duration::from_millis(20));
            let seen = self.observed();
            let error_n = vec3::distance(seen.force_n, force_n);
            error_n <= 0.1 * vec3::norm(force_n) && seen.requests > before
        })
    }

    /// [`Host::hold`] on this testbed.
    pub fn hold(&self, host: &Host, force_n: Vec3) -> Result<(), &'static str> {
        host.hold(|time| self.has_force(force_n, time))
    }

    /// Whether the force stays zero for this time.
    #[must_use]
    pub fn is_zero_for(&self, time: Duration) -> bool {
        let (start, last_force_us) = (Instant::now(), self.observed().last_force_us);
        while start.elapsed() < time {
            std::thread::sleep(2 * POLL_PERIOD);
            let seen = self.observed();
            if seen.force_n != vec3::ZERO || seen.last_force_us != last_force_us {
                return false;
            }
        }
        true
    }
}

impl Drop for Testbed {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn observe((observed_device, seen): &mut (Box<dyn ObservedDevice>, Observation), now_us: u64) {
    observed_device.poll(now_us);
    let (force_n, requests) = (observed_device.force_record().force_n, observed_device.requests());
    if requests > seen.requests && force_n != vec3::ZERO {
        seen.last_force_us = Some(now_us);
    }
    if force_n == vec3::ZERO && seen.force_n != vec3::ZERO {
        seen.zeroed_us = Some(now_us);
    }
    seen.latched_us = observed_device.has_latched().then(|| seen.latched_us.unwrap_or(now_us));
    (seen.force_n, seen.requests, seen.now_us) = (force_n, requests, now_us);
}
