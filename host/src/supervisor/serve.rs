//! The supervisor's side: holds the device, obeys orders, takes the force away when they stop.

use super::watch::Watch;
use super::wire::{Numbered, OPENING_LEN, Opening, Order, Place, Report};
use crate::device::{Device, EmergencyStop};
use crate::sys::{self, Policy};
use palpate_core::{Sample, Vec3, vec3};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixDatagram;
use std::time::Duration;

/// While nothing is watched: how often it looks whether the host is still there.
const LOOK_NS: u64 = 100_000_000;
/// How long the last zero is tried while the line refuses it.
const LAST_PATIENCE_NS: u64 = 10_000_000_000;
/// Between two tries.
const RETRY: Duration = Duration::from_millis(1);
/// Orders that are taken at a time.
const MOST_ORDERS: usize = 64;
/// Longest wait for the first order.
const HELLO_PATIENCE: Duration = Duration::from_secs(5);
/// Orders whose exchange is remembered: three times the stale limit at 1 kHz.
const REMEMBERED: usize = 32;

/// What it came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Served {
    /// Exchanges on an order.
    pub exchanges: u64,
    /// Times the force was taken away because nothing came.
    pub silences: u64,
    /// Datagrams that were none of the host's orders.
    pub strays: u64,
    /// The host is gone without having said so.
    pub abandoned: bool,
}

/// Takes the force away when dropped, also while a panic unwinds.
struct StopOnDrop<D: Device>(D);

impl<D: Device> Drop for StopOnDrop<D> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// As [`serve`], on the socket that a supervisor process is given as its standard input.
pub fn serve_stdin<D: Device>(
    policy: Policy,
    open: impl FnOnce() -> Result<D, String>,
) -> io::Result<Served> {
    let socket = UnixDatagram::from(io::stdin().as_fd().try_clone_to_owned()?);
    serve(&socket, policy, open)
}

/// Waits for a host's first order, opens the device and obeys until the host leaves or is gone. The force is zero on every way out.
///
/// An error of `open` is a line for people, told to the host; an error of its own means that there is no host.
pub fn serve<D: Device>(
    socket: &UnixDatagram,
    policy: Policy,
    open: impl FnOnce() -> Result<D, String>,
) -> io::Result<Served> {
    let (nonce, limit_us) = hello(socket)?;
    socket.set_nonblocking(true)?;
    let device = match open() {
        Ok(device) => device,
        Err(text) => {
            socket.send(&Opening::Refused { text }.encode(nonce))?;
            return Ok(Served::default());
        }
    };
    let mut device = StopOnDrop(device);
    let fifo_priority = if let Policy::Fifo(priority) = policy { priority } else { 0 };
    let opened = Opening::Opened { info: device.0.info(), state: device.0.state(), fifo_priority };
    socket.send(&opened.encode(nonce))?;
    let mut server = Server {
        socket,
        nonce,
        begun_ns: sys::monotonic_ns(),
        newest: 0,
        watch: Watch::new(u64::from(limit_us) * 1_000),
        past: device.0.emergency_stop(),
        device: &mut device.0,
        asked: [(0, 0); REMEMBERED],
        served: Served::default(),
    };
    server.run();
    Ok(server.served)
}

/// The first order.
fn hello(socket: &UnixDatagram) -> io::Result<(u32, u32)> {
    socket.set_read_timeout(Some(HELLO_PATIENCE))?;
    let mut bytes = [0; OPENING_LEN];
    let count = socket.recv(&mut bytes)?;
    match Numbered::decode(&bytes[..count]) {
        Some(Numbered { nonce, order: Order::Hello { limit_us }, .. }) => Ok((nonce, limit_us)),
        _ => Err(io::Error::new(io::ErrorKind::InvalidData, "no host speaks here")),
    }
}

/// Whether to go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Host {
    There,
    Gone,
}

/// The newest order that wants an exchange.
#[derive(Debug, Clone, Copy)]
struct Wanted {
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
    /// Past an exchange that hangs; and where there is none, `Device::stop`.
    past: Option<Box<dyn EmergencyStop>>,
    /// Times of the last exchanges and the orders they were for, newest first.
    asked: [(u64, u64); REMEMBERED],
    served: Served,
}

impl<D: Device> Server<'_, D> {
    fn now_us(&self) -> u64 {
        sys::monotonic_ns().saturating_sub(self.begun_ns) / 1_000
    }

    fn run(&mut self) {
        loop {
            let now_ns = sys::monotonic_ns();
            let due_ns = self.watch.due_ns().unwrap_or(now_ns + LOOK_NS);
            let readable =
                sys::wait_readable(self.socket.as_fd(), Duration::from_nanos(due_ns.saturating_sub(now_ns)));
            // What has come in the meantime first: a process that was late itself must not blame the host for it.
            let host = if readable { self.obey() } else { Host::There };
            let host = match host {
                Host::There if self.watch.is_overdue(sys::monotonic_ns()) => {
                    self.served.silences += 1;
                    // Refused, it is tried again with the next limit.
                    let _ = self.zero();
                    self.tell(0, None)
                }
                Host::There if !readable => self.tell(0, None),
                host => host,
            };
            if host == Host::Gone {
                self.zero_at_last();
                return;
            }
        }
    }

    /// Takes every order that is there; exchanges for the newest that wants it.
    fn obey(&mut self) -> Host {
        let mut wanted = None;
        let mut bytes = [0; OPENING_LEN];
        for _ in 0..MOST_ORDERS {
            let count = match self.socket.recv(&mut bytes) {
                Ok(count) => count,
                Err(error) if is_passing(&error) => break,
                Err(_) => return self.abandoned(),
            };
            let order = Numbered::decode(&bytes[..count]);
            let order = order.filter(|order| order.nonce == self.nonce && order.number > self.newest);
            let Some(Numbered { number, sent_ns, order, .. }) = order else {
                self.served.strays += 1;
                continue;
            };
            self.newest = number;
            match order {
                Order::Hello { .. } => {}
                Order::Tick { session, force_n } => {
                    let force_n = self.watch.tick(sys::monotonic_ns(), sent_ns, session, force_n);
                    wanted = Some(Wanted { number, force_n });
                }
                Order::Look => {
                    self.watch.rest();
                    wanted = Some(Wanted { number, force_n: vec3::ZERO });
                }
                Order::Zero => {
                    self.watch.latch();
                    wanted = None;
                    let _ = self.zero();
                }
                Order::Stop | Order::Leave => {
                    self.watch.rest();
                    wanted = None;
                    self.device.stop();
                    let told = self.report(number, true, None);
                    if order == Order::Leave || told == Host::Gone {
                        return Host::Gone;
                    }
                }
            }
        }
        wanted.map_or(Host::There, |wanted| self.exchange(wanted))
    }

    fn exchange(&mut self, Wanted { number, force_n }: Wanted) -> Host {
        let now_us = self.now_us();
        self.asked.rotate_right(1);
        self.asked[0] = (now_us, number);
        self.served.exchanges += 1;
        let sample = self.device.exchange(now_us, force_n);
        self.tell(number, Some(sample))
    }

    /// The order with whose exchange the request of a sample went.
    fn asked_by(&self, t_us: u64) -> Option<u64> {
        let (_, number) = self.asked.iter().find(|(asked_us, number)| *asked_us <= t_us && *number > 0)?;
        Some(*number)
    }

    fn tell(&mut self, answers: u64, came: Option<Result<Option<Sample>, crate::DeviceError>>) -> Host {
        self.report(answers, false, came)
    }

    fn report(
        &mut self,
        answers: u64,
        stopped: bool,
        came: Option<Result<Option<Sample>, crate::DeviceError>>,
    ) -> Host {
        let (sample, error) = match came {
            Some(Ok(sample)) => (sample, None),
            Some(Err(error)) => (None, Some(error)),
            None => (None, None),
        };
        let place = sample.and_then(|Sample { t_us, position_m, buttons }| {
            self.asked_by(t_us).map(|asked_by| Place { asked_by, position_m, buttons })
        });
        let (session, device) = (self.watch.session(), self.device.state());
        let report = Report { answers, session, stopped, device, place, error };
        match self.socket.send(&report.encode(self.nonce)) {
            Ok(_) => Host::There,
            // A host that does not read is one that stands still: its silence is judged, not its queue.
            Err(error) if is_passing(&error) => Host::There,
            Err(_) => self.abandoned(),
        }
    }

    fn abandoned(&mut self) -> Host {
        self.served.abandoned = true;
        Host::Gone
    }

    /// Takes the force away, twice over: past the driver, which then distrusts the replies, and through it, which then knows. False if the line did
    /// not take it now.
    fn zero(&mut self) -> bool {
        let Some(past) = &mut self.past else {
            self.device.stop();
            return true;
        };
        let is_refused = past.zero().is_err_and(|error| error.kind().is_passing());
        let now_us = self.now_us();
        // A device that cannot be reached this way cannot be helped; the next limit tries again.
        let _ = self.device.exchange(now_us, vec3::ZERO);
        !is_refused
    }

    /// The same when nobody comes after this: tried again while the line does not take it.
    fn zero_at_last(&mut self) {
        let give_up_ns = sys::monotonic_ns() + LAST_PATIENCE_NS;
        while !self.zero() && sys::monotonic_ns() < give_up_ns {
            std::thread::sleep(RETRY);
        }
    }
}

/// Whether a socket's error says nothing of the other end.
pub(super) fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
        || error.raw_os_error() == Some(NO_BUFFER_SPACE)
}

/// ENOBUFS, for which the standard library has no name.
const NO_BUFFER_SPACE: i32 = 105;
