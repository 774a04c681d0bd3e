//! What the processes play on: an emulated device in real time, and a record of what was seen at its motors.

use super::host::{Host, comes};
use super::process::{Device, Role, command};
use crate::falcon::{EmulatedFalcon, FalconConfig, MemoryFtdi, socket};
use crate::felt::Felt;
use crate::link::EmulatedLink;
use crate::mechanism::Waypoint;
use crate::polhem::EmulatedPolhem;
use crate::rig::SerialDevice;
use crate::transport::PtyTransport;
use palpate_core::{Vec3, vec3};
use palpate_host::device::profile::Profile;
use palpate_host::sys::{self, RtRequest};
use serialport::{SerialPort, TTYPort};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Between two looks at the device.
const LOOK: Duration = Duration::from_micros(100);
/// Most that the stage's clock goes on between two looks, us. What is longer is a machine that stood still, and host and supervisor with it: no
/// time of a device.
const MOST_BETWEEN_US: u64 = 2_000;

/// What was seen at the motors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Their force now, N.
    pub force_n: Vec3,
    /// Good requests so far.
    pub requests: u64,
    /// When the newest request that left a force on them was taken, us on the stage's clock as all that follows.
    pub forced_us: Option<u64>,
    /// When the force last became zero.
    pub released_us: Option<u64>,
    /// Since when the device's own watchdog has been latched; nothing while it is not, or where there is none.
    pub latched_us: Option<u64>,
}

impl Seen {
    /// From the last request with a force to zero, us.
    #[must_use]
    pub fn zero_after_us(&self) -> Option<u64> {
        Some(self.released_us?.saturating_sub(self.forced_us?))
    }

    /// From the last request with a force to the latch of the device's own watchdog, us.
    #[must_use]
    pub fn latch_after_us(&self) -> Option<u64> {
        Some(self.latched_us?.saturating_sub(self.forced_us?))
    }
}

/// An emulated device that is looked at from outside.
trait Watched: Send + 'static {
    /// Serves what has come by `now_us`.
    fn poll(&mut self, now_us: u64);
    fn felt(&self) -> Felt;
    fn forget(&mut self);
    fn requests(&self) -> u64;

    /// Whether its own watchdog is latched.
    fn has_latched(&self) -> bool {
        false
    }
}

struct OnTerminal<E> {
    device: E,
    link: PtyTransport,
    /// Requests that are no longer in the record of what was felt.
    forgotten: u64,
    /// Holds the terminal open.
    _driver_end: TTYPort,
}

impl<E: SerialDevice> Watched for OnTerminal<E> {
    fn poll(&mut self, now_us: u64) {
        self.device.poll(now_us, &mut self.link).expect("the terminal is open");
    }

    fn felt(&self) -> Felt {
        *self.device.handle().felt()
    }

    fn forget(&mut self) {
        self.forgotten = self.requests();
        self.device.handle_mut().forget();
    }

    fn requests(&self) -> u64 {
        self.forgotten + self.device.handle().felt().commands
    }

    fn has_latched(&self) -> bool {
        self.device.has_latched()
    }
}

/// A device on a pseudo terminal, and the name of the driver's end.
fn on_terminal<E: SerialDevice>() -> (Box<dyn Watched>, String) {
    let (link, driver_end) = PtyTransport::pair().expect("a pseudo terminal");
    let place = driver_end.name().expect("a terminal has a name");
    let profile = Profile::bundled(E::profile()).expect("an emulated device has a bundled profile");
    let device = E::new(&profile);
    (Box::new(OnTerminal { device, link, forgotten: 0, _driver_end: driver_end }), place)
}

struct OnSocket {
    chip: MemoryFtdi,
    listener: std::os::unix::net::UnixListener,
}

impl Watched for OnSocket {
    fn poll(&mut self, _now_us: u64) {
        if let Ok((stream, _)) = self.listener.accept() {
            let chip = self.chip.open_again().expect("it is plugged in");
            // Ends with its driver, whose end is no error of ours.
            std::thread::spawn(move || drop(socket::serve(stream, &chip)));
        }
    }

    fn felt(&self) -> Felt {
        *self.chip.falcon().felt()
    }

    fn forget(&mut self) {
        self.chip.falcon().forget();
    }

    fn requests(&self) -> u64 {
        self.chip.falcon().firmware().map_or(0, |firmware| firmware.requests())
    }
}

/// An emulated device with a thread that serves it.
pub struct Stage {
    device: Device,
    watched: Arc<Mutex<(Box<dyn Watched>, Seen)>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    place: String,
}

impl Stage {
    /// A device that waits for a driver.
    ///
    /// # Panics
    ///
    /// Where there are no pseudo terminals or sockets.
    #[must_use]
    pub fn new(device: Device) -> Self {
        let (watched, place): (Box<dyn Watched>, String) = match device {
            Device::Polhem => on_terminal::<EmulatedPolhem>(),
            Device::Link => on_terminal::<EmulatedLink>(),
            Device::Falcon => {
                static NUMBER: AtomicU64 = AtomicU64::new(0);
                let number = NUMBER.fetch_add(1, Ordering::Relaxed);
                let place = format!("palpate-hil-{}-{number}", std::process::id());
                let listener = socket::listen(&place).expect("a name of our own");
                // Held outside its indices, then pushed in.
                let at = |t_us, z| Waypoint { t_us, position_m: [0.0, 0.0, z] };
                let path = vec![at(0, 0.145), at(100_000, 0.12)];
                let config = FalconConfig { path, firmware_runs: true, ..FalconConfig::default() };
                let chip = MemoryFtdi::in_real_time(EmulatedFalcon::new(config));
                (Box::new(OnSocket { chip, listener }), place)
            }
        };
        let seen =
            Seen { force_n: vec3::ZERO, requests: 0, forced_us: None, released_us: None, latched_us: None };
        let (watched, ends) = (Arc::new(Mutex::new((watched, seen))), Arc::new(AtomicBool::new(false)));
        let (served, stop) = (Arc::clone(&watched), Arc::clone(&ends));
        let serve = move || {
            // A real device owes this machine's scheduler nothing: above hosts and supervisors where that is allowed.
            let above = RtRequest { fifo_priority: Some(52), ..RtRequest::none() };
            let (_, _held) = sys::enter_real_time(&above);
            let (mut now_us, mut looked) = (0, Instant::now());
            while !stop.load(Ordering::Relaxed) {
                let before = std::mem::replace(&mut looked, Instant::now());
                now_us += (looked.duration_since(before).as_micros() as u64).min(MOST_BETWEEN_US);
                look(&mut served.lock().unwrap_or_else(PoisonError::into_inner), now_us);
                std::thread::sleep(LOOK);
            }
        };
        Self { device, watched, ends, thread: Some(std::thread::spawn(serve)), place }
    }

    /// What was seen so far.
    #[must_use]
    pub fn seen(&self) -> Seen {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner).1
    }

    /// What the hand felt.
    #[must_use]
    pub fn felt(&self) -> Felt {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner).0.felt()
    }

    /// Begins the record of what the hand felt anew.
    pub fn forget(&self) {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner).0.forget();
    }

    /// Starts a host process that asks for a force; a supervisor of its takes it away after so much silence.
    ///
    /// # Panics
    ///
    /// If `program` does not start.
    #[must_use]
    pub fn host(&self, program: &Path, role: Role, limit_ms: u32, force_n: Vec3) -> Host {
        Host::start(command(program, role, self.device, &self.place, limit_ms, force_n))
    }

    /// Whether the device has a host's force on its motors in time, and goes on to get it.
    fn has_force(&self, force_n: Vec3, time: Duration) -> bool {
        comes(time, || {
            let before = self.seen().requests;
            std::thread::sleep(Duration::from_millis(20));
            let seen = self.seen();
            // A Falcon's torques stand on where the grip was a moment ago.
            let off_n = vec3::distance(seen.force_n, force_n);
            off_n <= 0.1 * vec3::norm(force_n) && seen.requests > before
        })
    }

    /// [`Host::hold`] on this stage.
    pub fn hold(&self, host: &Host, force_n: Vec3) -> Result<(), &'static str> {
        host.hold(|time| self.has_force(force_n, time))
    }

    /// Whether the force is zero for so long on end.
    #[must_use]
    pub fn is_zero_for(&self, time: Duration) -> bool {
        let (begun, forced_us) = (Instant::now(), self.seen().forced_us);
        while begun.elapsed() < time {
            std::thread::sleep(2 * LOOK);
            let seen = self.seen();
            if seen.force_n != vec3::ZERO || seen.forced_us != forced_us {
                return false;
            }
        }
        true
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn look((watched, seen): &mut (Box<dyn Watched>, Seen), now_us: u64) {
    watched.poll(now_us);
    let (force_n, requests) = (watched.felt().force_n, watched.requests());
    if requests > seen.requests && force_n != vec3::ZERO {
        seen.forced_us = Some(now_us);
    }
    if force_n == vec3::ZERO && seen.force_n != vec3::ZERO {
        seen.released_us = Some(now_us);
    }
    seen.latched_us = watched.has_latched().then(|| seen.latched_us.unwrap_or(now_us));
    (seen.force_n, seen.requests) = (force_n, requests);
}
