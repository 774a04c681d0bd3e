//! The emulated chip for a driver in another process: its transfers over a socket, one at a time.
//!
//! A request is a letter and a body: `c` with request u8 and value u16; `w` with bytes; `r` with capacity u16
//! and timeout in us u32; `z` with bytes that a guard writes, which has no reply. Any other reply is a letter, `k` for done, `t` for timeout and `g` for disconnected, and a
//! body: the bytes read, or the number of bytes written. Each body is preceded by its length, u16. All
//! numbers are little-endian.

use super::memory::MemoryFtdi;
use palpate_host::device::falcon::Ftdi;
use palpate_host::device::fence::{GuardPath, Wire};
use palpate_host::{DeviceError, DeviceErrorKind};
use std::io::{self, Read, Write};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

const CONTROL: u8 = b'c';
const WRITE: u8 = b'w';
const GUARD_WRITE: u8 = b'z';
const READ: u8 = b'r';
const DONE: u8 = b'k';
const TIMED_OUT: u8 = b't';
const DISCONNECTED: u8 = b'g';

fn send(stream: &mut impl Write, letter: u8, body: &[u8]) -> io::Result<()> {
    let len = u16::try_from(body.len()).map_err(io::Error::other)?;
    stream.write_all(&[&[letter], &len.to_le_bytes()[..], body].concat())
}

fn receive(stream: &mut UnixStream) -> io::Result<(u8, Vec<u8>)> {
    let mut head = [0; 3];
    stream.read_exact(&mut head)?;
    let [letter, low, high] = head;
    let mut body = vec![0; usize::from(u16::from_le_bytes([low, high]))];
    stream.read_exact(&mut body)?;
    Ok((letter, body))
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
        let (letter, body) = receive(&mut stream)?;
        if letter == GUARD_WRITE {
            // A packet always fits.
            let _ = chip.write(&body, Duration::ZERO);
            continue;
        }
        let answer = match (letter, &body[..]) {
            (CONTROL, [request, low, high]) => {
                chip.control(*request, u16::from_le_bytes([*low, *high])).map(|()| Vec::new())
            }
            (WRITE, bytes) => {
                chip.write(bytes, Duration::ZERO).map(|count| (count as u16).to_le_bytes().into())
            }
            (READ, [low, high, us @ ..]) => {
                let us = <[u8; 4]>::try_from(us).map_err(io::Error::other)?;
                let mut buffer = vec![0; u16::from_le_bytes([*low, *high]).into()];
                chip.read(&mut buffer, Duration::from_micros(u32::from_le_bytes(us).into())).map(|count| {
                    buffer.truncate(count);
                    buffer
                })
            }
            _ => return Err(io::ErrorKind::InvalidData.into()),
        };
        match answer {
            Ok(body) => send(&mut stream, DONE, &body)?,
            Err(error) if error.kind().is_transient() => send(&mut stream, TIMED_OUT, &[])?,
            Err(_) => send(&mut stream, DISCONNECTED, &[])?,
        }
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

    fn request(&self, letter: u8, body: &[u8]) -> Result<Vec<u8>, DeviceError> {
        let mut stream = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = send(&mut *stream, letter, body).and_then(|()| receive(&mut stream));
        match answer {
            Ok((DONE, body)) => Ok(body),
            Ok((TIMED_OUT, _)) => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            _ => Err(DeviceError::new(DeviceErrorKind::Disconnected)),
        }
    }
}

impl Ftdi for SocketFtdi {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        let [low, high] = value.to_le_bytes();
        self.request(CONTROL, &[request, low, high]).map(drop)
    }

    /// Does not wait for room, because a packet always fits.
    fn write(&self, bytes: &[u8], _timeout: Duration) -> Result<usize, DeviceError> {
        let count = self.request(WRITE, bytes)?;
        Ok(usize::from(u16::from_le_bytes(count.try_into().unwrap_or_default())))
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        let room = u16::try_from(buffer.len()).unwrap_or(u16::MAX).to_le_bytes();
        let us = u32::try_from(timeout.as_micros()).unwrap_or(u32::MAX).to_le_bytes();
        let bytes = self.request(READ, &[&room[..], &us].concat())?;
        let room = buffer.get_mut(..bytes.len()).ok_or(DeviceError::new(DeviceErrorKind::Io))?;
        room.copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn guard_path(&self) -> io::Result<Option<GuardPath>> {
        let stream = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Some(GuardPath { fd: stream.try_clone()?.into(), wire: Wire::Stream }))
    }

    fn guard_message(&self, packet: &[u8]) -> Vec<u8> {
        let mut message = Vec::new();
        send(&mut message, GUARD_WRITE, packet).expect("a packet is short, and memory accepts it");
        message
    }
}
