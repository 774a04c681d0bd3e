//! The supervisor's side: owns the device, executes orders, zeroes the force when they stop.

use super::watch::Watch;
use super::wire::{OPEN_RESULT_LEN, OpenResult, Order, OrderMessage, Report, ReportedPosition};
use crate::device::{Device, DeviceError, EmergencyStop};
use crate::sys::{self, Policy};
use palpate_core::{Sample, Vec3, vec3};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixDatagram;
use std::time::Duration;

/// Period of checking for the host while no watch is active.
const HOST_CHECK_NS: u64 = 100_000_000;
/// Time for which the last zero is retried while the line does not accept it.
const FINAL_ZERO_TIMEOUT_NS: u64 = 10_000_000_000;
/// Pause between two attempts.
const RETRY: Duration = Duration::from_millis(1);
/// Largest number of orders processed at a time.
const MAX_ORDERS: usize = 64;
/// Timeout of the first order.
const HELLO_TIMEOUT: Duration = Duration::from_secs(5);
/// Number of exchanges kept in the history: three times the stale limit at 1 kHz.
const HISTORY_LEN: usize = 32;

/// Statistics of a supervisor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ServeSummary {
    /// Number of exchanges on an order.
    pub exchanges: u64,
    /// Number of times the force was zeroed for lack of an order.
    pub silences: u64,
    /// Datagrams that were not valid orders of the host.
    pub strays: u64,
    /// Whether the host ended without a Leave order.
    pub abandoned: bool,
}

/// Stops the device when dropped, also while a panic unwinds.
struct StopOnDrop<D: Device>(D);

impl<D: Device> Drop for StopOnDrop<D> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// Like [`serve`], on the socket that a supervisor process receives as its standard input.
pub fn serve_stdin<D: Device>(
    policy: Policy,
    open: impl FnOnce() -> Result<D, String>,
) -> io::Result<ServeSummary> {
    let socket = UnixDatagram::from(io::stdin().as_fd().try_clone_to_owned()?);
    serve(&socket, policy, open)
}

/// Waits for the host's first order, opens the device and executes orders until the host leaves or is gone.
/// The force is zero on every exit.
///
/// An error of `open` is one line for the user and is sent to the host. An error of this function means that
/// there is no host.
pub fn serve<D: Device>(
    socket: &UnixDatagram,
    policy: Policy,
    open: impl FnOnce() -> Result<D, String>,
) -> io::Result<ServeSummary> {
    let (nonce, limit_us) = receive_hello(socket)?;
    socket.set_nonblocking(true)?;
    let device = match open() {
        Ok(device) => device,
        Err(text) => {
            socket.send(&OpenResult::Refused { text }.encode(nonce))?;
            return Ok(ServeSummary::default());
        }
    };
    let mut device = StopOnDrop(device);
    let fifo_priority = if let Policy::Fifo(priority) = policy { priority } else { 0 };
    let opened = OpenResult::Opened { info: device.0.info(), state: device.0.state(), fifo_priority };
    socket.send(&opened.encode(nonce))?;
    let mut server = Server {
        socket,
        nonce,
        begun_ns: sys::monotonic_ns(),
        newest: 0,
        watch: Watch::new(u64::from(limit_us) * 1_000),
        emergency_stop: device.0.emergency_stop(),
        device: &mut device.0,
        exchanges: [(0, 0); HISTORY_LEN],
        summary: ServeSummary::default(),
    };
    server.run();
    Ok(server.summary)
}

/// Receives the first order.
fn receive_hello(socket: &UnixDatagram) -> io::Result<(u32, u32)> {
    socket.set_read_timeout(Some(HELLO_TIMEOUT))?;
    let mut bytes = [0; OPEN_RESULT_LEN];
    let count = socket.recv(&mut bytes)?;
    match OrderMessage::decode(&bytes[..count]) {
        Some(OrderMessage { nonce, order: Order::Hello { limit_us }, .. }) => Ok((nonce, limit_us)),
        _ => Err(io::Error::new(io::ErrorKind::InvalidData, "the first datagram is not from a host")),
    }
}

/// Whether the host is present.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Host {
    Present,
    Gone,
}

/// The newest order that requires an exchange.
#[derive(Debug, Clone, Copy)]
struct ExchangeRequest {
    number: u64,
    force_n: Vec3,
}

struct Server<'d, D: Device> {
    socket: &'d UnixDatagram,
    nonce: u32,
    begun_ns: u64,
    /// Number of the newest order.
    newest: u64,
    watch: Watch,
    device: &'d mut D,
    /// Path past an exchange that hangs; without one, `Device::stop` is used.
    emergency_stop: Option<Box<dyn EmergencyStop>>,
    /// Times of the last exchanges and their orders, newest first.
    exchanges: [(u64, u64); HISTORY_LEN],
    summary: ServeSummary,
}

impl<D: Device> Server<'_, D> {
    fn now_us(&self) -> u64 {
        sys::monotonic_ns().saturating_sub(self.begun_ns) / 1_000
    }

    fn run(&mut self) {
        loop {
            let now_ns = sys::monotonic_ns();
            let due_ns = self.watch.due_ns().unwrap_or(now_ns + HOST_CHECK_NS);
            let readable =
                sys::wait_readable(self.socket.as_fd(), Duration::from_nanos(due_ns.saturating_sub(now_ns)));
            // First process the orders that have arrived: if this process itself was late, the host is not at
            // fault.
            let host = if readable { self.process_orders() } else { Host::Present };
            let host = match host {
                Host::Present if self.watch.is_overdue(sys::monotonic_ns()) => {
                    self.summary.silences += 1;
                    // If it fails, the next limit tries again.
                    let _ = self.zero();
                    self.report_exchange(0, None)
                }
                Host::Present if !readable => self.report_exchange(0, None),
                host => host,
            };
            if host == Host::Gone {
                self.zero_finally();
                return;
            }
        }
    }

    /// Processes all orders that have arrived, then exchanges for the newest that requires it.
    fn process_orders(&mut self) -> Host {
        let mut request = None;
        let mut bytes = [0; OPEN_RESULT_LEN];
        for _ in 0..MAX_ORDERS {
            let count = match self.socket.recv(&mut bytes) {
                Ok(count) => count,
                Err(error) if is_transient(&error) => break,
                Err(_) => return self.abandoned(),
            };
            let order = OrderMessage::decode(&bytes[..count]);
            let order = order.filter(|order| order.nonce == self.nonce && order.number > self.newest);
            let Some(OrderMessage { number, sent_ns, order, .. }) = order else {
                self.summary.strays += 1;
                continue;
            };
            self.newest = number;
            match order {
                Order::Hello { .. } => {}
                Order::Tick { session, force_n } => {
                    let force_n = self.watch.tick(sys::monotonic_ns(), sent_ns, session, force_n);
                    request = Some(ExchangeRequest { number, force_n });
                }
                Order::Poll => {
                    self.watch.pause();
                    request = Some(ExchangeRequest { number, force_n: vec3::ZERO });
                }
                Order::Zero => {
                    self.watch.latch();
                    request = None;
                    let _ = self.zero();
                }
                Order::Stop | Order::Leave => {
                    self.watch.pause();
                    request = None;
                    self.device.stop();
                    let reported = self.report(number, true, None);
                    if order == Order::Leave || reported == Host::Gone {
                        return Host::Gone;
                    }
                }
            }
        }
        request.map_or(Host::Present, |request| self.exchange(request))
    }

    fn exchange(&mut self, ExchangeRequest { number, force_n }: ExchangeRequest) -> Host {
        let now_us = self.now_us();
        self.exchanges.rotate_right(1);
        self.exchanges[0] = (now_us, number);
        self.summary.exchanges += 1;
        let sample = self.device.exchange(now_us, force_n);
        self.report_exchange(number, Some(sample))
    }

    /// The order whose exchange sent the request of a sample.
    fn order_of(&self, t_us: u64) -> Option<u64> {
        let (_, number) =
            self.exchanges.iter().find(|(exchanged_us, number)| *exchanged_us <= t_us && *number > 0)?;
        Some(*number)
    }

    fn report_exchange(&mut self, answers: u64, result: Option<Result<Option<Sample>, DeviceError>>) -> Host {
        self.report(answers, false, result)
    }

    fn report(
        &mut self,
        answers: u64,
        stopped: bool,
        result: Option<Result<Option<Sample>, DeviceError>>,
    ) -> Host {
        let (sample, error) = match result {
            Some(Ok(sample)) => (sample, None),
            Some(Err(error)) => (None, Some(error)),
            None => (None, None),
        };
        let place = sample.and_then(|Sample { t_us, position_m, buttons }| {
            self.order_of(t_us).map(|order_number| ReportedPosition { order_number, position_m, buttons })
        });
        let (session, device) = (self.watch.session(), self.device.state());
        let report = Report { answers, session, stopped, device, place, error };
        match self.socket.send(&report.encode(self.nonce)) {
            Ok(_) => Host::Present,
            // A host that does not read is stalled: it is detected by its silence, not by its full queue.
            Err(error) if is_transient(&error) => Host::Present,
            Err(_) => self.abandoned(),
        }
    }

    fn abandoned(&mut self) -> Host {
        self.summary.abandoned = true;
        Host::Gone
    }

    /// Zeroes the force on two paths: past the driver, which then pauses for silence, and through it, which
    /// updates its state. False if the line did not accept it now.
    fn zero(&mut self) -> bool {
        let Some(emergency_stop) = &mut self.emergency_stop else {
            self.device.stop();
            return true;
        };
        let is_refused = emergency_stop.zero().is_err_and(|error| error.kind().is_transient());
        let now_us = self.now_us();
        // If the device cannot be reached, the next limit tries again.
        let _ = self.device.exchange(now_us, vec3::ZERO);
        !is_refused
    }

    /// The final zero, retried while the line does not accept it.
    fn zero_finally(&mut self) {
        let give_up_ns = sys::monotonic_ns() + FINAL_ZERO_TIMEOUT_NS;
        while !self.zero() && sys::monotonic_ns() < give_up_ns {
            std::thread::sleep(RETRY);
        }
    }
}

/// Whether an error of the socket is transient.
pub(super) fn is_transient(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
        || error.raw_os_error() == Some(NO_BUFFER_SPACE)
}

/// ENOBUFS, which the standard library does not name.
const NO_BUFFER_SPACE: i32 = 105;
