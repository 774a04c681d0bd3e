//! The emulated chip for a driver in another process: its transfers over a socket, one at a time.
//!
//! A request is a letter and its body: `c` request u8, value u16; `w` bytes; `r` room u16, timeout in us u32. An answer is a letter, `k` for
//! done, `t` for nothing in time and `g` for gone, and a body: what was read, or how many bytes went. Each body has its length, u16, before it.
//! Little-endian throughout.

use super::memory::MemoryFtdi;
use palpate_host::device::falcon::Ftdi;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::io::{self, Read, Write};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

const CONTROL: u8 = b'c';
const WRITE: u8 = b'w';
const READ: u8 = b'r';
const DONE: u8 = b'k';
const NOTHING: u8 = b't';
const GONE: u8 = b'g';

fn send(stream: &mut UnixStream, letter: u8, body: &[u8]) -> io::Result<()> {
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

/// A name without a file: it is gone with the socket.
fn address(name: &str) -> io::Result<SocketAddr> {
    SocketAddr::from_abstract_name(name)
}

/// Listens for drivers; looking for one does not wait.
pub fn listen(name: &str) -> io::Result<UnixListener> {
    let listener = UnixListener::bind_addr(&address(name)?)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves one driver until it is gone. Blocks.
pub fn serve(mut stream: UnixStream, chip: &MemoryFtdi) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    loop {
        let (letter, body) = receive(&mut stream)?;
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
            Err(error) if error.kind().is_transient() => send(&mut stream, NOTHING, &[])?,
            Err(_) => send(&mut stream, GONE, &[])?,
        }
    }
}

/// The chip as the driver in the other process has it.
#[derive(Debug)]
pub struct SocketFtdi(Mutex<UnixStream>);

impl SocketFtdi {
    /// Connects to who listens under this name.
    pub fn connect(name: &str) -> io::Result<Self> {
        UnixStream::connect_addr(&address(name)?).map(|stream| Self(Mutex::new(stream)))
    }

    fn ask(&self, letter: u8, body: &[u8]) -> Result<Vec<u8>, DeviceError> {
        let mut stream = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = send(&mut stream, letter, body).and_then(|()| receive(&mut stream));
        match answer {
            Ok((DONE, body)) => Ok(body),
            Ok((NOTHING, _)) => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            _ => Err(DeviceError::new(DeviceErrorKind::Disconnected)),
        }
    }
}

impl Ftdi for SocketFtdi {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        let [low, high] = value.to_le_bytes();
        self.ask(CONTROL, &[request, low, high]).map(drop)
    }

    /// Does not wait for room: a packet always finds some.
    fn write(&self, bytes: &[u8], _timeout: Duration) -> Result<usize, DeviceError> {
        let count = self.ask(WRITE, bytes)?;
        Ok(usize::from(u16::from_le_bytes(count.try_into().unwrap_or_default())))
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        let room = u16::try_from(buffer.len()).unwrap_or(u16::MAX).to_le_bytes();
        let us = u32::try_from(timeout.as_micros()).unwrap_or(u32::MAX).to_le_bytes();
        let bytes = self.ask(READ, &[&room[..], &us].concat())?;
        let room = buffer.get_mut(..bytes.len()).ok_or(DeviceError::new(DeviceErrorKind::Io))?;
        room.copy_from_slice(&bytes);
        Ok(bytes.len())
    }
}
