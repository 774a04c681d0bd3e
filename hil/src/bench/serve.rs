//! Serves the bench on its sockets, in real time.

use super::command::{BenchCommand, Reply};
use super::rig::Rig;
use crate::usbredir::{Session, Traffic};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Poll period without traffic: far below the chip's 1 ms timer.
const PAUSE: Duration = Duration::from_micros(50);

/// Sockets and duration of the bench.
#[derive(Debug, Clone)]
pub struct Options {
    /// Socket for QEMU's usb-redir.
    pub usbredir: PathBuf,
    /// Socket for commands, if any.
    pub control: Option<PathBuf>,
    /// Longest duration, unless `end` or a closed socket ends the bench before.
    pub longest: Duration,
}

/// A listening socket and its peer, read without blocking.
#[derive(Debug)]
struct PolledSocket {
    listener: UnixListener,
    stream: Option<UnixStream>,
    output: Vec<u8>,
}

impl PolledSocket {
    fn listen(path: &Path) -> io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, stream: None, output: Vec::new() })
    }

    /// Whether a peer is connected; accepts one if it waits.
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

    /// Received bytes; empty if there are none. An error of kind `UnexpectedEof` means that the peer has
    /// closed.
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

    /// The descriptor to poll for [`PolledSocket::is_open`] or [`PolledSocket::read`].
    fn source(&self) -> BorrowedFd<'_> {
        self.stream.as_ref().map_or_else(|| self.listener.as_fd(), AsFd::as_fd)
    }

    /// Sends as many bytes as the socket takes.
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

/// Waits for input, or for `longest`.
fn wait(lines: &[Option<&PolledSocket>], longest: Duration) -> io::Result<()> {
    let mut sources: Vec<PollFd<'_>> =
        lines.iter().flatten().map(|line| PollFd::new(line.source(), PollFlags::POLLIN)).collect();
    match ppoll(&mut sources, Some(TimeSpec::from(longest)), None) {
        Ok(_) | Err(Errno::EINTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

fn json_line(reply: &Reply) -> Vec<u8> {
    let mut line = serde_json::to_vec(reply).expect("plain data");
    line.push(b'\n');
    line
}

/// Serves until the peer closes, the command `end`, or the time limit. Writes a log.
pub fn serve(options: &Options, log: &mut impl Write) -> io::Result<Traffic> {
    let start = Instant::now();
    let mut bus = PolledSocket::listen(&options.usbredir)?;
    let mut control = options.control.as_deref().map(PolledSocket::listen).transpose()?;
    // Without a command socket the guest is to see the device at once.
    let mut rig = if control.is_some() { Rig::unplugged() } else { Rig::new(0) };
    let mut session = Session::new();
    let mut commands = Vec::new();
    writeln!(log, "listening")?;
    let ended = loop {
        if start.elapsed() >= options.longest {
            break "the time limit is reached";
        }
        let mut busy = false;
        if bus.is_open()? {
            rig.poll();
            if session.is_handshake_done() && rig.is_plugged() != session.is_connected() {
                if session.is_connected() {
                    session.disconnect();
                } else {
                    session.connect(&mut rig);
                }
                let what = if session.is_connected() { "in" } else { "out" };
                writeln!(log, "[{:9.3}] the cable is {what}", start.elapsed().as_secs_f64())?;
            }
            match bus.read() {
                Ok(bytes) => {
                    busy |= !bytes.is_empty();
                    session.receive(&bytes, &mut rig).map_err(io::Error::other)?;
                }
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                    break "the virtual machine has closed its socket";
                }
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
                Ok(bytes) => commands.extend(bytes),
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                    break "the virtual machine has closed its socket";
                }
                Err(error) => return Err(error),
            }
            let mut end = false;
            while let Some(at) = commands.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = commands.drain(..=at).collect();
                busy = true;
                let answer = match serde_json::from_slice(&line) {
                    Ok(command) => {
                        end |= command == BenchCommand::End;
                        if matches!(command, BenchCommand::Plug { .. }) && session.is_connected() {
                            session.disconnect();
                            writeln!(log, "[{:9.3}] the cable is out", start.elapsed().as_secs_f64())?;
                        }
                        rig.execute(command)
                    }
                    Err(_) => Reply::Unknown,
                };
                let line = String::from_utf8_lossy(&line);
                writeln!(log, "[{:9.3}] {}: {answer:?}", start.elapsed().as_secs_f64(), line.trim())?;
                control.write(&json_line(&answer))?;
            }
            control.write(&[])?;
            if end {
                break "the test has ended";
            }
        }
        if !busy {
            wait(&[Some(&bus), control.as_ref()], PAUSE)?;
        }
    };
    writeln!(log, "[{:9.3}] {ended}: {:?}", start.elapsed().as_secs_f64(), session.traffic())?;
    Ok(session.traffic())
}
