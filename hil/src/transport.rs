//! Bytes to and from the driver under test, through a pseudo terminal or through memory.

use serialport::{SerialPort, TTYPort};
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The device's end of a link. No call blocks. The caller passes the time, so that faults are repeatable.
pub trait Transport {
    /// Reads available bytes; 0 without any.
    fn receive(&mut self, now_us: u64, buffer: &mut [u8]) -> io::Result<usize>;

    /// Sends one frame.
    fn send(&mut self, now_us: u64, frame: &[u8]) -> io::Result<()>;
}

impl<T: Transport + ?Sized> Transport for Box<T> {
    fn receive(&mut self, now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        (**self).receive(now_us, buffer)
    }

    fn send(&mut self, now_us: u64, frame: &[u8]) -> io::Result<()> {
        (**self).send(now_us, frame)
    }
}

/// The master end of a pseudo terminal. The driver opens the other end like any serial port.
#[derive(Debug)]
pub struct PtyTransport {
    port: TTYPort,
    /// Bytes already read from the terminal.
    buffered: Vec<u8>,
}

impl PtyTransport {
    /// A new pseudo terminal: the device's end, and the driver's port.
    pub fn pair() -> io::Result<(Self, TTYPort)> {
        let (device, driver) = TTYPort::pair()?;
        // Copies are closed in a new process. The originals are not: a host that another test starts would keep
        // the line up after this end is dropped.
        let (mut device, driver) = (device.try_clone_native()?, driver.try_clone_native()?);
        device.set_timeout(Duration::ZERO)?;
        Ok((Self { port: device, buffered: Vec::new() }, driver))
    }

    /// Whether any input is available, reliably and without blocking.
    ///
    /// A kernel worker forwards the bytes written at the other end. On a busy machine it may be late, and the
    /// count of readable bytes does not include the bytes it has not forwarded. A poll waits for that worker
    /// (`n_tty_poll` of Linux), and a read of the port starts with a poll.
    pub fn poll_input(&mut self) -> io::Result<bool> {
        drain(&mut self.port, &mut self.buffered)?;
        Ok(!self.buffered.is_empty())
    }
}

/// Reads all available bytes. A signal, for example Ctrl-C, may interrupt a read before it waits; the read is
/// then repeated.
fn drain(port: &mut impl Read, buffered: &mut Vec<u8>) -> io::Result<()> {
    let mut chunk = [0; 256];
    loop {
        match port.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(count) => buffered.extend(&chunk[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) if error.kind() == io::ErrorKind::TimedOut => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}

impl Transport for PtyTransport {
    fn receive(&mut self, _now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        self.poll_input()?;
        let count = self.buffered.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.buffered[..count]);
        self.buffered.drain(..count);
        Ok(count)
    }

    fn send(&mut self, _now_us: u64, frame: &[u8]) -> io::Result<()> {
        self.port.write_all(frame)
    }
}

/// One end of a link in memory.
#[derive(Debug, Clone)]
pub struct MemoryTransport {
    incoming: Arc<Mutex<VecDeque<u8>>>,
    outgoing: Arc<Mutex<VecDeque<u8>>>,
}

impl MemoryTransport {
    /// Both ends.
    #[must_use]
    pub fn pair() -> (Self, Self) {
        let (one, other) = (Arc::default(), Arc::default());
        let first = Self { incoming: Arc::clone(&one), outgoing: Arc::clone(&other) };
        (first, Self { incoming: other, outgoing: one })
    }
}

impl MemoryTransport {
    /// Number of bytes to receive.
    #[must_use]
    pub fn waiting(&self) -> usize {
        lock(&self.incoming).len()
    }

    /// Discards the bytes to receive.
    pub fn clear(&self) {
        lock(&self.incoming).clear();
    }
}

fn lock(queue: &Mutex<VecDeque<u8>>) -> MutexGuard<'_, VecDeque<u8>> {
    // A panic of another test leaves the queue valid.
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Transport for MemoryTransport {
    fn receive(&mut self, _now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        lock(&self.incoming).read(buffer)
    }

    fn send(&mut self, _now_us: u64, frame: &[u8]) -> io::Result<()> {
        lock(&self.outgoing).extend(frame);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_carries_bytes_both_ways() {
        let (mut one, mut other) = MemoryTransport::pair();
        one.send(0, b"to the other").expect("memory");
        other.send(0, b"back").expect("memory");
        let mut buffer = [0; 64];
        let count = other.receive(0, &mut buffer).expect("memory");
        assert_eq!(&buffer[..count], b"to the other");
        let count = one.receive(0, &mut buffer).expect("memory");
        assert_eq!(&buffer[..count], b"back");
        assert_eq!(one.receive(0, &mut buffer).expect("memory"), 0);
    }

    /// A signal interrupts a read. Ctrl-C once ended `palpate-hil emulate` with an error instead of its
    /// summary.
    #[test]
    fn an_interrupted_read_is_repeated() {
        struct Signalled(Vec<Result<Vec<u8>, io::ErrorKind>>);
        impl Read for Signalled {
            fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
                let bytes = self.0.remove(0)?;
                buffer[..bytes.len()].copy_from_slice(&bytes);
                Ok(bytes.len())
            }
        }
        let signal = || Err(io::ErrorKind::Interrupted);
        let (mut buffered, some) = (Vec::new(), Ok(b"some".to_vec()));
        let mut port = Signalled(vec![signal(), some, signal(), signal(), Err(io::ErrorKind::TimedOut)]);
        drain(&mut port, &mut buffered).expect("no fault");
        assert!(buffered == b"some" && port.0.is_empty(), "{buffered:?}, {} reads to go", port.0.len());
        let mut gone = Signalled(vec![signal(), Err(io::ErrorKind::BrokenPipe)]);
        let fault = drain(&mut gone, &mut buffered).expect_err("gone");
        assert_eq!(fault.kind(), io::ErrorKind::BrokenPipe);
    }

    /// Every byte value passes: a terminal in canonical mode would drop or change some.
    #[test]
    fn a_pseudo_terminal_is_transparent() {
        let (mut device, mut driver) = PtyTransport::pair().expect("a pseudo terminal");
        let all: Vec<u8> = (0..=255).collect();
        driver.write_all(&all).expect("room for 256 bytes");
        let mut got = Vec::new();
        let mut buffer = [0; 64];
        // The written bytes are available without waiting.
        while device.poll_input().expect("open") {
            let count = device.receive(0, &mut buffer).expect("open");
            got.extend_from_slice(&buffer[..count]);
        }
        assert_eq!(got, all);
        device.send(0, &all).expect("room for 256 bytes");
        driver.set_timeout(Duration::from_secs(2)).expect("a setting");
        let mut back = vec![0; all.len()];
        driver.read_exact(&mut back).expect("as many bytes");
        assert_eq!(back, all);
    }
}
