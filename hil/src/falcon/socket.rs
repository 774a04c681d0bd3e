//! The emulated chip for a driver in another process: its transfers over a socket, one at a time.
//!
//! A message is a [`Call`] or an [`Answer`] in postcard, preceded by its length, u16 little-endian.

use super::memory::MemoryFtdi;
use palpate_host::device::falcon::Ftdi;
use palpate_host::device::fence::{GuardPath, Wire};
use palpate_host::{DeviceError, DeviceErrorKind};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// A transfer that the driver requests.
#[derive(Debug, Serialize, Deserialize)]
enum Call {
    Control {
        request: u8,
        value: u16,
    },
    Write(Vec<u8>),
    /// From a guard; it has no answer.
    GuardWrite(Vec<u8>),
    Read {
        room: u16,
        timeout_us: u32,
    },
}

/// The result of a transfer.
#[derive(Debug, Serialize, Deserialize)]
enum Answer {
    Done,
    Written(u16),
    Read(Vec<u8>),
    TimedOut,
    Disconnected,
}

fn send(stream: &mut impl Write, message: &impl Serialize) -> io::Result<()> {
    let body = postcard::to_allocvec(message).map_err(io::Error::other)?;
    let len = u16::try_from(body.len()).map_err(io::Error::other)?;
    stream.write_all(&[&len.to_le_bytes()[..], &body].concat())
}

fn receive<T: DeserializeOwned>(stream: &mut UnixStream) -> io::Result<T> {
    let mut len = [0; 2];
    stream.read_exact(&mut len)?;
    let mut body = vec![0; usize::from(u16::from_le_bytes(len))];
    stream.read_exact(&mut body)?;
    postcard::from_bytes(&body).map_err(io::Error::other)
}

/// An abstract socket name, which leaves no file behind.
fn address(name: &str) -> io::Result<SocketAddr> {
    SocketAddr::from_abstract_name(name)
}

/// Listens for drivers; accepting does not block.
pub fn listen(name: &str) -> io::Result<UnixListener> {
    let listener = UnixListener::bind_addr(&address(name)?)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves one driver until it closes the socket. Blocks.
pub fn serve(mut stream: UnixStream, chip: &MemoryFtdi) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    loop {
        let answer = match receive(&mut stream)? {
            Call::GuardWrite(bytes) => {
                // A packet always fits.
                let _ = chip.write(&bytes, Duration::ZERO);
                continue;
            }
            Call::Control { request, value } => chip.control(request, value).map(|()| Answer::Done),
            Call::Write(bytes) => {
                chip.write(&bytes, Duration::ZERO).map(|count| Answer::Written(count as u16))
            }
            Call::Read { room, timeout_us } => {
                let mut buffer = vec![0; room.into()];
                chip.read(&mut buffer, Duration::from_micros(timeout_us.into())).map(|count| {
                    buffer.truncate(count);
                    Answer::Read(buffer)
                })
            }
        };
        let failed = |error: DeviceError| {
            if error.kind().is_transient() { Answer::TimedOut } else { Answer::Disconnected }
        };
        send(&mut stream, &answer.unwrap_or_else(failed))?;
    }
}

/// The chip as seen by the driver in the other process.
#[derive(Debug)]
pub struct SocketFtdi(Mutex<UnixStream>);

impl SocketFtdi {
    /// Connects to the listener of this name.
    pub fn connect(name: &str) -> io::Result<Self> {
        UnixStream::connect_addr(&address(name)?).map(|stream| Self(Mutex::new(stream)))
    }

    fn request(&self, call: &Call) -> Result<Answer, DeviceError> {
        let mut stream = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match send(&mut *stream, call).and_then(|()| receive(&mut stream)) {
            Ok(Answer::TimedOut) => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            Ok(Answer::Disconnected) | Err(_) => Err(DeviceError::new(DeviceErrorKind::Disconnected)),
            Ok(answer) => Ok(answer),
        }
    }
}

impl Ftdi for SocketFtdi {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.request(&Call::Control { request, value }).map(drop)
    }

    /// Does not wait for room, because a packet always fits.
    fn write(&self, bytes: &[u8], _timeout: Duration) -> Result<usize, DeviceError> {
        match self.request(&Call::Write(bytes.to_vec()))? {
            Answer::Written(count) => Ok(count.into()),
            _ => Err(DeviceError::new(DeviceErrorKind::Disconnected)),
        }
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        let room = u16::try_from(buffer.len()).unwrap_or(u16::MAX);
        let timeout_us = u32::try_from(timeout.as_micros()).unwrap_or(u32::MAX);
        match self.request(&Call::Read { room, timeout_us })? {
            Answer::Read(bytes) if bytes.len() <= buffer.len() => {
                buffer[..bytes.len()].copy_from_slice(&bytes);
                Ok(bytes.len())
            }
            _ => Err(DeviceError::new(DeviceErrorKind::Disconnected)),
        }
    }

    fn guard_path(&self) -> io::Result<Option<GuardPath>> {
        let stream = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Some(GuardPath { fd: stream.try_clone()?.into(), wire: Wire::Stream }))
    }

    fn guard_message(&self, packet: &[u8]) -> Vec<u8> {
        let mut message = Vec::new();
        send(&mut message, &Call::GuardWrite(packet.to_vec()))
            .expect("a packet is short, and memory accepts it");
        message
    }
}
