//! The host's side: a device that is held by a supervisor.
//!
//! An exchange takes the reports that have come and sends the next order; it waits for neither. A sample comes a tick later than it would without a
//! supervisor, and is stamped with the time of the tick whose exchange sent its request: it cannot be older than it looks.

use super::serve::is_passing;
use super::wire::{Numbered, OPENING_LEN, Opening, Order, Place, Report};
use crate::device::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState, EmergencyStop};
use crate::sys::{self, Policy};
use core::fmt;
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use palpate_core::{Sample, Vec3};
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixDatagram;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Orders whose times are remembered.
const REMEMBERED: usize = 64;
/// Reports that an exchange takes: more than a socket queues.
const MOST_REPORTS: usize = 64;
/// Longest wait for a stop to be done. The supervisor takes the force away by itself not much later.
const STOP_PATIENCE: Duration = Duration::from_millis(20);
/// Longest wait for its process to end, so that the device can be opened again.
const END_PATIENCE: Duration = Duration::from_secs(2);
/// How often the opening looks whether it is still wanted.
const OPENING_LOOK: Duration = Duration::from_millis(50);
/// Pause between two looks at a device that is being homed.
const HOMING_PAUSE: Duration = Duration::from_millis(1);
/// After this nothing is on its way any more.
const SETTLING: Duration = Duration::from_millis(20);

/// Why there is no supervised device.
#[derive(Debug)]
pub enum StartError {
    /// No socket or no process.
    Io(io::Error),
    /// The supervisor could not open the device: its line.
    Refused(String),
    /// The supervisor ended without a word.
    Ended,
    /// The caller does not want it any more.
    Stopped,
}

/// Whether nobody holds the other end of a socket any more.
fn is_gone(error: &io::Error) -> bool {
    use io::ErrorKind::{BrokenPipe, ConnectionRefused, ConnectionReset, NotConnected};
    matches!(error.kind(), BrokenPipe | ConnectionRefused | ConnectionReset | NotConnected)
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => {
                write!(f, "the supervisor cannot be started: {error}; --no-supervisor does without")
            }
            Self::Refused(text) => f.write_str(text),
            Self::Ended => f.write_str("the supervisor ended at once; --no-supervisor does without"),
            Self::Stopped => f.write_str("stopped while the device was being opened"),
        }
    }
}

impl core::error::Error for StartError {}

impl From<io::Error> for StartError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// What a session says of its supervisor. Stays readable when the device has gone into the loop.
#[derive(Debug)]
pub struct Supervision {
    /// Its process; `None` for one in a thread.
    pub pid: Option<u32>,
    /// Time without a tick after which it takes the force away, ms.
    pub limit_ms: u32,
    /// How it is scheduled.
    pub policy: Policy,
    zeroed: AtomicU64,
}

impl Supervision {
    /// Times that it has taken the force away.
    #[must_use]
    pub fn zeroed(&self) -> u64 {
        self.zeroed.load(Ordering::Relaxed)
    }
}

impl fmt::Display for Supervision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.pid {
            Some(pid) => write!(f, "pid {pid}")?,
            None => f.write_str("in this process")?,
        }
        write!(f, ", zero after {} ms, {}; fired {} times", self.limit_ms, self.policy, self.zeroed())
    }
}

/// Sends orders. Cheap to copy: the watchdog has one of its own.
#[derive(Debug, Clone)]
struct Orders {
    socket: Arc<UnixDatagram>,
    nonce: u32,
    number: Arc<AtomicU64>,
}

impl Orders {
    /// The number it went with.
    fn send(&self, order: Order) -> io::Result<u64> {
        let number = self.number.fetch_add(1, Ordering::Relaxed) + 1;
        let order = Numbered { nonce: self.nonce, number, sent_ns: sys::monotonic_ns(), order };
        self.socket.send(&order.encode())?;
        Ok(number)
    }
}

impl EmergencyStop for Orders {
    fn zero(&mut self) -> Result<(), DeviceError> {
        self.send(Order::Zero).map(|_| ()).map_err(from_socket)
    }
}

/// A full queue is a late supervisor; anything else means that there is none.
fn from_socket(error: io::Error) -> DeviceError {
    let kind = if is_passing(&error) { DeviceErrorKind::Timeout } else { DeviceErrorKind::Disconnected };
    DeviceError::with_os_code(kind, error.raw_os_error())
}

/// A device in the hands of a supervisor.
#[derive(Debug)]
pub struct Supervised {
    orders: Orders,
    info: DeviceInfo,
    state: DeviceState,
    supervision: Arc<Supervision>,
    /// The session that ticks are sent in: entered at the start, then with each reset.
    session: u32,
    /// The one in which the supervisor obeys.
    offered: u32,
    /// It has taken the force away, and the loop has not been told yet.
    zeroed: bool,
    /// Numbers and times of the last ticks, by number.
    sent: [(u64, u64); REMEMBERED],
    child: Option<Child>,
}

impl Supervised {
    /// Starts `command` with one end of a socket pair as its standard input, and waits until it has opened the device or `stop` is raised.
    ///
    /// The process is put into a group of its own: Ctrl-C and Ctrl-Z of the terminal are the host's affair.
    pub fn start(mut command: Command, limit_ms: u32, stop: &AtomicBool) -> Result<Self, StartError> {
        let (ours, theirs) = UnixDatagram::pair()?;
        command.stdin(OwnedFd::from(theirs)).stdout(Stdio::null()).process_group(0);
        let child = command.spawn()?;
        // It holds the other end: the supervisor's must be the only one.
        drop(command);
        Self::greet(ours, Some(child), limit_ms, stop)
    }

    /// With a supervisor that listens at the other end of `socket` already.
    pub fn with_socket(socket: UnixDatagram, limit_ms: u32) -> Result<Self, StartError> {
        Self::greet(socket, None, limit_ms, &AtomicBool::new(false))
    }

    fn greet(
        socket: UnixDatagram,
        mut child: Option<Child>,
        limit_ms: u32,
        stop: &AtomicBool,
    ) -> Result<Self, StartError> {
        // Not the process id: two supervisors of one host must differ, and so must two hosts.
        let nonce = RandomState::new().hash_one(sys::monotonic_ns()) as u32;
        let orders = Orders { socket: Arc::new(socket), nonce, number: Arc::default() };
        let failed = |error: io::Error| if is_gone(&error) { StartError::Ended } else { error.into() };
        orders.send(Order::Hello { limit_us: limit_ms.saturating_mul(1_000) }).map_err(failed)?;
        orders.socket.set_nonblocking(true)?;
        let opening = loop {
            if stop.load(Ordering::Relaxed) {
                return Err(StartError::Stopped);
            }
            let ended = match &mut child {
                Some(child) => child.try_wait()?.is_some(),
                None => false,
            };
            // Its last words may be there all the same.
            let _ =
                sys::wait_readable(orders.socket.as_fd(), if ended { Duration::ZERO } else { OPENING_LOOK });
            let mut bytes = [0; OPENING_LEN];
            match orders.socket.recv(&mut bytes) {
                Ok(count) => {
                    if let Some(opening) = Opening::decode(&bytes[..count], nonce) {
                        break opening;
                    }
                }
                Err(error) if is_passing(&error) && !ended => {}
                Err(error) if is_passing(&error) => return Err(StartError::Ended),
                Err(error) => return Err(failed(error)),
            }
        };
        match opening {
            Opening::Refused { text } => {
                // The device, if it was half open, must be free again.
                child.as_mut().map(Child::wait).transpose()?;
                Err(StartError::Refused(text))
            }
            Opening::Opened { info, state, fifo_priority } => {
                let policy = if fifo_priority > 0 { Policy::Fifo(fifo_priority) } else { Policy::Other };
                let (pid, zeroed) = (child.as_ref().map(Child::id), AtomicU64::new(0));
                Ok(Self {
                    orders,
                    info,
                    state,
                    supervision: Arc::new(Supervision { pid, limit_ms, policy, zeroed }),
                    session: 0,
                    offered: 0,
                    zeroed: false,
                    sent: [(0, 0); REMEMBERED],
                    child,
                })
            }
        }
    }

    /// What there is to say of it.
    #[must_use]
    pub fn supervision(&self) -> Arc<Supervision> {
        Arc::clone(&self.supervision)
    }

    /// Waits until the user has homed the device, or until `stop`; true if it is homed. Before the loop, whose clock begins anew.
    pub fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        let mut last_number = 0;
        while self.state != DeviceState::Homed && !stop.load(Ordering::Relaxed) {
            match self.orders.send(Order::Look).map_err(from_socket) {
                Ok(number) => last_number = number,
                Err(error) if error.kind().is_passing() => {}
                Err(error) => return Err(error),
            }
            std::thread::sleep(HOMING_PAUSE);
            while let Some(report) = self.receive()? {
                self.state = report.device;
            }
        }
        // What is still on its way belongs to another time: let it come, and forget it. The supervisor does not know the numbers of these
        // orders from those of ticks, but `sent` does.
        if last_number > 0 {
            std::thread::sleep(SETTLING);
            while self.receive()?.is_some() {}
        }
        Ok(self.state == DeviceState::Homed)
    }

    /// The next report, if one is there. Strangers' datagrams are passed over.
    fn receive(&self) -> Result<Option<Report>, DeviceError> {
        let mut bytes = [0; OPENING_LEN];
        for _ in 0..MOST_REPORTS {
            match self.orders.socket.recv(&mut bytes) {
                Ok(count) => {
                    if let Some(report) = Report::decode(&bytes[..count], self.orders.nonce) {
                        return Ok(Some(report));
                    }
                }
                Err(error) if is_passing(&error) => break,
                Err(error) => return Err(from_socket(error)),
            }
        }
        Ok(None)
    }

    /// The time of a tick; `None` for one that was not, or is long past.
    fn sent_us(&self, number: u64) -> Option<u64> {
        let (of, t_us) = self.sent[number as usize % REMEMBERED];
        (of == number && number > 0).then_some(t_us)
    }

    /// Takes a report: a sample of it, or what went wrong with the device.
    fn take(&mut self, report: &Report) -> Result<Option<Sample>, DeviceError> {
        self.state = report.device;
        if report.session != self.offered {
            self.offered = report.session;
            self.zeroed = true;
            self.supervision.zeroed.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(error) = report.error {
            return Err(error);
        }
        Ok(report.place.and_then(|Place { asked_by, position_m, buttons }| {
            // One whose request is none of ours, or too old, is of no known age.
            Some(Sample { t_us: self.sent_us(asked_by)?, position_m, buttons })
        }))
    }

    /// Sends an order that must arrive, and waits for its answer a little.
    fn order_and_wait(&mut self, order: Order) {
        let give_up = Instant::now() + STOP_PATIENCE;
        let mut number = None;
        while Instant::now() < give_up {
            if number.is_none() {
                number = match self.orders.send(order) {
                    Ok(number) => Some(number),
                    Err(error) if is_passing(&error) => None,
                    // Nobody is there: the device is in nobody's hands.
                    Err(_) => return,
                };
            }
            match self.receive() {
                Ok(Some(report)) if report.stopped && Some(report.answers) == number => return,
                Ok(Some(_)) => {}
                Ok(None) => {
                    let left = give_up.saturating_duration_since(Instant::now());
                    let _ = sys::wait_readable(self.orders.socket.as_fd(), left.min(HOMING_PAUSE));
                }
                Err(_) => return,
            }
        }
    }
}

impl Device for Supervised {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let mut newest: Option<Sample> = None;
        let mut failed = None;
        // Bounded: a babbling supervisor must not hold the tick.
        for _ in 0..MOST_REPORTS {
            let Some(report) = self.receive()? else { break };
            match self.take(&report) {
                Ok(Some(sample)) if newest.is_none_or(|newest| sample.t_us > newest.t_us) => {
                    newest = Some(sample)
                }
                Ok(_) => {}
                Err(error) if error.kind().is_passing() => failed = Some(error),
                Err(error) => return Err(error),
            }
        }
        match self.orders.send(Order::Tick { session: self.session, force_n: hand_force_n }) {
            Ok(number) => self.sent[number as usize % REMEMBERED] = (number, now_us),
            Err(error) if is_passing(&error) => failed = Some(from_socket(error)),
            Err(error) => {
                self.state = DeviceState::Disconnected;
                return Err(from_socket(error));
            }
        }
        match (newest, failed) {
            (None, Some(error)) => Err(error),
            (newest, _) => Ok(newest),
        }
    }

    fn stop(&mut self) {
        self.order_and_wait(Order::Stop);
    }

    fn info(&self) -> DeviceInfo {
        self.info.clone()
    }

    fn state(&self) -> DeviceState {
        self.state
    }

    fn emergency_stop(&mut self) -> Option<Box<dyn EmergencyStop>> {
        Some(Box::new(self.orders.clone()))
    }

    fn was_zeroed(&mut self) -> bool {
        core::mem::take(&mut self.zeroed)
    }

    fn reset(&mut self) {
        self.session = self.offered;
    }
}

impl Drop for Supervised {
    fn drop(&mut self) {
        self.order_and_wait(Order::Leave);
        let give_up = Instant::now() + END_PATIENCE;
        if let Some(child) = &mut self.child {
            // One that does not end may still be at the device: it is left alone.
            while Instant::now() < give_up && matches!(child.try_wait(), Ok(None)) {
                std::thread::sleep(HOMING_PAUSE);
            }
        }
    }
}
