//! The bench on its sockets, in real time.

use super::ask::Ask;
use super::order::{NotUnderstood, Order};
use super::rig::Rig;
use super::stepped::Stepped;
use crate::falcon::{Setup, Stall};
use crate::usbredir::{Session, Traffic, UsbDevice};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long a device in real time is left alone if nothing comes: far below the chip's timer of 1 ms.
const PAUSE: Duration = Duration::from_micros(50);
/// The same for one whose time goes on when it is told to: what does not come from the sockets cannot happen.
const LONG_PAUSE: Duration = Duration::from_millis(5);

/// Where and how long to serve.
#[derive(Debug, Clone)]
pub struct Options {
    /// Socket for QEMU's usb-redir.
    pub usbredir: PathBuf,
    /// Socket for orders, if any.
    pub control: Option<PathBuf>,
    /// Until when, if nobody says `end` or closes the socket before.
    pub longest: Duration,
}

/// A stream that is looked at without waiting.
#[derive(Debug)]
struct Line {
    listener: UnixListener,
    stream: Option<UnixStream>,
    output: Vec<u8>,
}

impl Line {
    fn listen(path: &Path) -> io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, stream: None, output: Vec::new() })
    }

    /// The peer is here, perhaps only now.
    fn is_open(&mut self) -> io::Result<bool> {
        if self.stream.is_none() {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(true)?;
                    self.stream = Some(stream);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
        Ok(self.stream.is_some())
    }

    /// What has come; nothing at all means that there was nothing, and an error of kind `UnexpectedEof` that the peer is gone.
    fn read(&mut self) -> io::Result<Vec<u8>> {
        let Some(stream) = &mut self.stream else { return Ok(Vec::new()) };
        let mut bytes = vec![0; 4096];
        match stream.read(&mut bytes) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                bytes.truncate(count);
                Ok(bytes)
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(Vec::new()),
            Err(error) => Err(error),
        }
    }

    /// What has something for [`Line::is_open`] or [`Line::read`] next.
    fn source(&self) -> BorrowedFd<'_> {
        self.stream.as_ref().map_or_else(|| self.listener.as_fd(), AsFd::as_fd)
    }

    /// Whether bytes wait for room.
    fn is_full(&self) -> bool {
        !self.output.is_empty()
    }

    /// Sends as much as there is room for.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.output.extend(bytes);
        let Some(stream) = &mut self.stream else { return Ok(()) };
        while !self.output.is_empty() {
            match stream.write(&self.output) {
                Ok(count) => drop(self.output.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// Waits until something comes, or for so long.
fn wait(lines: &[Option<&Line>], longest: Duration) -> io::Result<()> {
    let mut sources: Vec<PollFd<'_>> =
        lines.iter().flatten().map(|line| PollFd::new(line.source(), PollFlags::POLLIN)).collect();
    match ppoll(&mut sources, Some(TimeSpec::from(longest)), None) {
        Ok(_) | Err(Errno::EINTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// How long the guest may take to deal with what the device sent, however busy the machine.
const CERTAIN: Duration = Duration::from_secs(60);

/// The device on the bus.
enum Stand {
    /// In real time.
    Free(Box<Rig>),
    /// In the guest's.
    Stepped(Box<Stepped>),
}

impl Stand {
    fn is_plugged(&self) -> bool {
        match self {
            Self::Free(rig) => rig.is_plugged(),
            Self::Stepped(device) => device.is_plugged(),
        }
    }

    /// Does what is due; somebody may wait for what it sends.
    fn poll(&mut self, is_read: bool) {
        match self {
            Self::Free(rig) => rig.poll(),
            Self::Stepped(device) if is_read => device.wait(),
            Self::Stepped(_) => {}
        }
    }

    /// How long it may be left alone if nothing comes; somebody may wait for what it sends.
    fn pause(&self, is_read: bool) -> Duration {
        match self {
            Self::Free(_) => PAUSE,
            Self::Stepped(device) if device.runs() && is_read => Duration::ZERO,
            Self::Stepped(device) if device.runs() => PAUSE,
            Self::Stepped(_) => LONG_PAUSE,
        }
    }

    fn obey(&mut self, order: Order) -> String {
        if let (Self::Stepped(_), Order::Plug { seed }) = (&self, order) {
            *self = Self::Free(Box::new(Rig::new(seed)));
            return "ok".into();
        }
        match self {
            Self::Free(rig) => rig.obey(order),
            Self::Stepped(_) if order == Order::End => "ok".into(),
            Self::Stepped(_) => NotUnderstood.to_string(),
        }
    }

    fn ask(&mut self, ask: Ask) -> String {
        if let (Self::Free(_), Ask::Fresh { seed }) = (&self, &ask) {
            *self = Self::Stepped(Box::new(Stepped::new(*seed)));
        }
        match self {
            Self::Free(_) => NotUnderstood.to_string(),
            Self::Stepped(device) => device.obey(ask).to_string(),
        }
    }
}

impl UsbDevice for Stand {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        match self {
            Self::Free(rig) => rig.control(setup, data),
            Self::Stepped(device) => device.control(setup, data),
        }
    }

    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall> {
        match self {
            Self::Free(rig) => rig.bulk_out(bytes),
            Self::Stepped(device) => device.bulk_out(bytes),
        }
    }

    fn bulk_in(&mut self, max: usize) -> Result<Option<Vec<u8>>, Stall> {
        match self {
            Self::Free(rig) => rig.bulk_in(max),
            Self::Stepped(device) => device.bulk_in(max),
        }
    }
}

/// Serves until the peer is gone, `end` was ordered, or the time is over; writes a log.
pub fn serve(options: &Options, log: &mut impl Write) -> io::Result<Traffic> {
    let begun = Instant::now();
    let mut bus = Line::listen(&options.usbredir)?;
    let mut control = options.control.as_deref().map(Line::listen).transpose()?;
    // Without orders somebody else's machine is to see it at once.
    let rig = if control.is_some() { Rig::put_away() } else { Rig::new(0) };
    let (mut session, mut rig) = (Session::new(), Stand::Free(Box::new(rig)));
    let mut orders = Vec::new();
    // An answer that waits until the driver has dealt with what the device sent, and since when.
    let mut owed: Option<(String, Instant)> = None;
    writeln!(log, "listening")?;
    let ended = loop {
        if begun.elapsed() >= options.longest {
            break "time is over";
        }
        let mut busy = false;
        if bus.is_open()? {
            rig.poll(session.is_read());
            if session.is_greeted() && rig.is_plugged() != session.is_connected() {
                if session.is_connected() {
                    session.disconnect();
                } else {
                    session.connect(&mut rig);
                }
                let what = if session.is_connected() { "in" } else { "out" };
                writeln!(log, "[{:9.3}] the cable is {what}", begun.elapsed().as_secs_f64())?;
            }
            match bus.read() {
                Ok(bytes) => {
                    busy |= !bytes.is_empty();
                    session.receive(&bytes, &mut rig).map_err(io::Error::other)?;
                }
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => break "the virtual machine is gone",
                Err(error) => return Err(error),
            }
            if session.is_connected() && rig.is_plugged() {
                session.poll(&mut rig);
            }
            let output = session.take_output();
            busy |= !output.is_empty();
            bus.write(&output)?;
        }
        if let Some(control) = &mut control
            && control.is_open()?
        {
            match control.read() {
                Ok(bytes) => orders.extend(bytes),
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => break "the virtual machine is gone",
                Err(error) => return Err(error),
            }
            let mut end = false;
            if let Some((answer, since)) = &owed {
                // A cable that is out brings nothing more.
                if session.is_read() || !session.is_connected() {
                    control.write(format!("{answer}\n").as_bytes())?;
                    (owed, busy) = (None, true);
                } else if since.elapsed() > CERTAIN {
                    break "the driver does not read";
                }
            }
            while let Some(at) = orders.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = orders.drain(..=at).collect();
                let line = String::from_utf8_lossy(&line).trim().to_string();
                busy = true;
                if let Ok(ask) = line.parse::<Ask>() {
                    let waits = matches!(ask, Ask::Pass { is_read: true, .. });
                    let answer = rig.ask(ask);
                    if waits {
                        owed = Some((answer, Instant::now()));
                    } else {
                        control.write(format!("{answer}\n").as_bytes())?;
                    }
                    continue;
                }
                let answer = match line.parse::<Order>() {
                    Ok(order) => {
                        end |= order == Order::End;
                        if matches!(order, Order::Plug { .. }) && session.is_connected() {
                            session.disconnect();
                            writeln!(log, "[{:9.3}] the cable is out", begun.elapsed().as_secs_f64())?;
                        }
                        rig.obey(order)
                    }
                    Err(error) => error.to_string(),
                };
                writeln!(log, "[{:9.3}] {line}: {answer}", begun.elapsed().as_secs_f64())?;
                control.write(format!("{answer}\n").as_bytes())?;
            }
            control.write(&[])?;
            if end {
                break "the test has ended";
            }
        }
        if !busy {
            let lines = [Some(&bus), control.as_ref()];
            let is_full = lines.iter().flatten().any(|line| line.is_full());
            wait(&lines, if is_full { PAUSE } else { rig.pause(session.is_read()) })?;
        }
    };
    writeln!(log, "[{:9.3}] {ended}: {:?}", begun.elapsed().as_secs_f64(), session.traffic())?;
    Ok(session.traffic())
}
