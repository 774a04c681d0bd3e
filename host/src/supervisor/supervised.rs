//! The host's side: a device owned by a supervisor.
//!
//! An exchange processes the reports that have arrived and sends the next order; it waits for neither. A
//! sample arrives one tick later than without a supervisor. Its time stamp is the time of the tick whose
//! exchange sent its request, so it is not older than stated.

use super::serve::is_transient;
use super::wire::{OPEN_RESULT_LEN, OpenResult, Order, OrderMessage, Report, ReportedPosition};
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

/// Number of orders whose times are kept.
const HISTORY_LEN: usize = 64;
/// Largest number of reports per exchange: more than a socket queues.
const MAX_REPORTS: usize = 64;
/// Longest wait for a stop to be executed. The supervisor zeroes the force by itself soon after.
const STOP_TIMEOUT: Duration = Duration::from_millis(20);
/// Longest wait for the process to exit, so that the device can be opened again.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);
/// Period of checking the stop flag while opening.
const STOP_CHECK: Duration = Duration::from_millis(50);
/// Pause between two polls during homing.
const HOMING_PAUSE: Duration = Duration::from_millis(1);
/// Time after which no report is under way.
const SETTLE_TIME: Duration = Duration::from_millis(20);

/// Reason why the supervised device could not be started.
#[derive(Debug)]
pub enum StartError {
    /// A socket or process could not be created.
    Io(io::Error),
    /// The supervisor could not open the device; its error line.
    Refused(String),
    /// The supervisor exited without a message.
    Ended,
    /// The caller raised the stop flag.
    Stopped,
}

/// Whether the other end of a socket is closed.
fn is_gone(error: &io::Error) -> bool {
    use io::ErrorKind::{BrokenPipe, ConnectionRefused, ConnectionReset, NotConnected};
    matches!(error.kind(), BrokenPipe | ConnectionRefused | ConnectionReset | NotConnected)
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => {
                write!(f, "the supervisor cannot be started: {error}; or run with --no-supervisor")
            }
            Self::Refused(text) => f.write_str(text),
            Self::Ended => f.write_str("the supervisor exited immediately; run with --no-supervisor"),
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

/// Status of a supervisor for the session's report. Stays readable after the device has moved into the loop.
#[derive(Debug)]
pub struct Supervision {
    /// Its process; `None` for a supervisor on a thread.
    pub pid: Option<u32>,
    /// Time without a tick after which it zeroes the force, ms.
    pub limit_ms: u32,
    /// Its scheduling policy.
    pub policy: Policy,
    zeroed: AtomicU64,
}

impl Supervision {
    /// Number of times it has zeroed the force.
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

/// Sends orders. It is cheap to clone: the watchdog has its own.
#[derive(Debug, Clone)]
struct Orders {
    socket: Arc<UnixDatagram>,
    nonce: u32,
    number: Arc<AtomicU64>,
}

impl Orders {
    /// Sends an order and returns its number.
    fn send(&self, order: Order) -> io::Result<u64> {
        let number = self.number.fetch_add(1, Ordering::Relaxed) + 1;
        let order = OrderMessage { nonce: self.nonce, number, sent_ns: sys::monotonic_ns(), order };
        self.socket.send(&order.encode())?;
        Ok(number)
    }
}

impl EmergencyStop for Orders {
    fn zero(&mut self) -> Result<(), DeviceError> {
        self.send(Order::Zero).map(|_| ()).map_err(from_socket)
    }
}

/// A full queue means a late supervisor; any other error means that it is gone.
fn from_socket(error: io::Error) -> DeviceError {
    let kind = if is_transient(&error) { DeviceErrorKind::Timeout } else { DeviceErrorKind::Disconnected };
    DeviceError::with_os_code(kind, error.raw_os_error())
}

/// A device owned by a supervisor.
#[derive(Debug)]
pub struct Supervised {
    orders: Orders,
    info: DeviceInfo,
    state: DeviceState,
    supervision: Arc<Supervision>,
    /// The session of the ticks sent: entered at the start, then with each reset.
    session: u32,
    /// The session in which the supervisor executes forces.
    open_session: u32,
    /// Whether it has zeroed the force and the loop has not yet been informed.
    zeroed: bool,
    /// Numbers and times of the last ticks, indexed by number.
    sent: [(u64, u64); HISTORY_LEN],
    child: Option<Child>,
}

impl Supervised {
    /// Starts `command` with one end of a socket pair as its standard input, and waits until it has opened
    /// the device or `stop` is raised.
    ///
    /// The process gets its own process group: the host handles Ctrl-C and Ctrl-Z of the terminal.
    pub fn start(mut command: Command, limit_ms: u32, stop: &AtomicBool) -> Result<Self, StartError> {
        let (ours, theirs) = UnixDatagram::pair()?;
        command.stdin(OwnedFd::from(theirs)).stdout(Stdio::null()).process_group(0);
        let child = command.spawn()?;
        // The command holds the other end; only the supervisor may hold it.
        drop(command);
        Self::handshake(ours, Some(child), limit_ms, stop)
    }

    /// Uses a supervisor that already listens at the other end of `socket`.
    pub fn with_socket(socket: UnixDatagram, limit_ms: u32) -> Result<Self, StartError> {
        Self::handshake(socket, None, limit_ms, &AtomicBool::new(false))
    }

    fn handshake(
        socket: UnixDatagram,
        mut child: Option<Child>,
        limit_ms: u32,
        stop: &AtomicBool,
    ) -> Result<Self, StartError> {
        // Not the process id: the nonces of two supervisors of one host, and of two hosts, must differ.
        let nonce = RandomState::new().hash_one(sys::monotonic_ns()) as u32;
        let orders = Orders { socket: Arc::new(socket), nonce, number: Arc::default() };
        let failed = |error: io::Error| if is_gone(&error) { StartError::Ended } else { error.into() };
        orders.send(Order::Hello { limit_us: limit_ms.saturating_mul(1_000) }).map_err(failed)?;
        orders.socket.set_nonblocking(true)?;
        let opened = loop {
            if stop.load(Ordering::Relaxed) {
                return Err(StartError::Stopped);
            }
            let ended = match &mut child {
                Some(child) => child.try_wait()?.is_some(),
                None => false,
            };
            // Its last message may have arrived in spite of its end.
            let _ =
                sys::wait_readable(orders.socket.as_fd(), if ended { Duration::ZERO } else { STOP_CHECK });
            let mut bytes = [0; OPEN_RESULT_LEN];
            match orders.socket.recv(&mut bytes) {
                Ok(count) => {
                    if let Some(opened) = OpenResult::decode(&bytes[..count], nonce) {
                        break opened;
                    }
                }
                Err(error) if is_transient(&error) && !ended => {}
                Err(error) if is_transient(&error) => return Err(StartError::Ended),
                Err(error) => return Err(failed(error)),
            }
        };
        match opened {
            OpenResult::Refused { text } => {
                // Wait for its exit, so that a half-open device is free again.
                child.as_mut().map(Child::wait).transpose()?;
                Err(StartError::Refused(text))
            }
            OpenResult::Opened { info, state, fifo_priority } => {
                let policy = if fifo_priority > 0 { Policy::Fifo(fifo_priority) } else { Policy::Other };
                let (pid, zeroed) = (child.as_ref().map(Child::id), AtomicU64::new(0));
                Ok(Self {
                    orders,
                    info,
                    state,
                    supervision: Arc::new(Supervision { pid, limit_ms, policy, zeroed }),
                    session: 0,
                    open_session: 0,
                    zeroed: false,
                    sent: [(0, 0); HISTORY_LEN],
                    child,
                })
            }
        }
    }

    /// Status of the supervisor.
    #[must_use]
    pub fn supervision(&self) -> Arc<Supervision> {
        Arc::clone(&self.supervision)
    }

    /// Waits until the user has homed the device, or until `stop`; true if it is homed. Runs before the loop,
    /// whose clock starts at zero again.
    pub fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        let mut last_number = 0;
        while self.state != DeviceState::Homed && !stop.load(Ordering::Relaxed) {
            match self.orders.send(Order::Poll).map_err(from_socket) {
                Ok(number) => last_number = number,
                Err(error) if error.kind().is_transient() => {}
                Err(error) => return Err(error),
            }
            std::thread::sleep(HOMING_PAUSE);
            while let Some(report) = self.receive()? {
                self.state = report.device;
            }
        }
        // Reports under way have times of another clock: let them arrive and discard them. `sent` does not
        // contain the numbers of these orders.
        if last_number > 0 {
            std::thread::sleep(SETTLE_TIME);
            while self.receive()?.is_some() {}
        }
        Ok(self.state == DeviceState::Homed)
    }

    /// The next report, if one has arrived. Invalid datagrams are skipped.
    fn receive(&self) -> Result<Option<Report>, DeviceError> {
        let mut bytes = [0; OPEN_RESULT_LEN];
        for _ in 0..MAX_REPORTS {
            match self.orders.socket.recv(&mut bytes) {
                Ok(count) => {
                    if let Some(report) = Report::decode(&bytes[..count], self.orders.nonce) {
                        return Ok(Some(report));
                    }
                }
                Err(error) if is_transient(&error) => break,
                Err(error) => return Err(from_socket(error)),
            }
        }
        Ok(None)
    }

    /// Time of a tick; `None` if the number is not of a tick, or is too old.
    fn sent_us(&self, number: u64) -> Option<u64> {
        let (of, t_us) = self.sent[number as usize % HISTORY_LEN];
        (of == number && number > 0).then_some(t_us)
    }

    /// Processes a report: its sample, or the error of the device.
    fn process(&mut self, report: &Report) -> Result<Option<Sample>, DeviceError> {
        self.state = report.device;
        if report.session != self.open_session {
            self.open_session = report.session;
            self.zeroed = true;
            self.supervision.zeroed.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(error) = report.error {
            return Err(error);
        }
        Ok(report.place.and_then(|ReportedPosition { order_number, position_m, buttons }| {
            // A sample without a known request has an unknown age.
            Some(Sample { t_us: self.sent_us(order_number)?, position_m, buttons })
        }))
    }

    /// Sends an order repeatedly until it is sent, and waits for its report for a limited time.
    fn order_and_wait(&mut self, order: Order) {
        let give_up = Instant::now() + STOP_TIMEOUT;
        let mut number = None;
        while Instant::now() < give_up {
            if number.is_none() {
                number = match self.orders.send(order) {
                    Ok(number) => Some(number),
                    Err(error) if is_transient(&error) => None,
                    // The supervisor is gone.
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
        // Bounded: a supervisor that sends continuously must not delay the tick.
        for _ in 0..MAX_REPORTS {
            let Some(report) = self.receive()? else { break };
            match self.process(&report) {
                Ok(Some(sample)) if newest.is_none_or(|newest| sample.t_us > newest.t_us) => {
                    newest = Some(sample)
                }
                Ok(_) => {}
                Err(error) if error.kind().is_transient() => failed = Some(error),
                Err(error) => return Err(error),
            }
        }
        match self.orders.send(Order::Tick { session: self.session, force_n: hand_force_n }) {
            Ok(number) => self.sent[number as usize % HISTORY_LEN] = (number, now_us),
            Err(error) if is_transient(&error) => failed = Some(from_socket(error)),
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
        self.session = self.open_session;
    }
}

impl Drop for Supervised {
    fn drop(&mut self) {
        self.order_and_wait(Order::Leave);
        let give_up = Instant::now() + EXIT_TIMEOUT;
        if let Some(child) = &mut self.child {
            // A process that does not exit may still use the device; it is not killed.
            while Instant::now() < give_up && matches!(child.try_wait(), Ok(None)) {
                std::thread::sleep(HOMING_PAUSE);
            }
        }
    }
}
