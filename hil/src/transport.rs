//! Bytes to and from the driver under test: through a pseudo terminal, or through memory.

use serialport::{SerialPort, TTYPort};
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The device's end of a link. Neither call waits. Times are the caller's, so that faults can be repeated.
pub trait Transport {
    /// Reads what has come; 0 if nothing.
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

/// The master end of a pseudo terminal; the driver opens the other one like any serial port.
#[derive(Debug)]
pub struct PtyTransport {
    port: TTYPort,
    /// Bytes that a look has taken from the terminal already.
    seen: Vec<u8>,
}

impl PtyTransport {
    /// A new pseudo terminal: the device's end, and the port for the driver.
    pub fn pair() -> io::Result<(Self, TTYPort)> {
        let (mut device, driver) = TTYPort::pair()?;
        device.set_timeout(Duration::ZERO)?;
        Ok((Self { port: device, seen: Vec::new() }, driver))
    }

    /// Whether there is anything to receive: for certain, without waiting.
    ///
    /// What was written at the other end is handed on by a worker of the kernel, on a busy machine much later, and the count of bytes that
    /// can be read knows nothing of it. A poll lets that worker finish first (`n_tty_poll` of Linux), and a read of the port begins with one.
    pub fn look(&mut self) -> io::Result<bool> {
        drain(&mut self.port, &mut self.seen)?;
        Ok(!self.seen.is_empty())
    }
}

/// Takes all that can be read now. A signal, Ctrl-C for example, may end the wait of a read before it began: then there is another look.
fn drain(port: &mut impl Read, seen: &mut Vec<u8>) -> io::Result<()> {
    let mut chunk = [0; 256];
    loop {
        match port.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(count) => seen.extend(&chunk[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) if error.kind() == io::ErrorKind::TimedOut => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}

impl Transport for PtyTransport {
    fn receive(&mut self, _now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        self.look()?;
        let count = self.seen.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.seen[..count]);
        self.seen.drain(..count);
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
    /// How many bytes wait to be received.
    #[must_use]
    pub fn waiting(&self) -> usize {
        lock(&self.incoming).len()
    }

    /// Throws away what waits to be received.
    pub fn clear(&self) {
        lock(&self.incoming).clear();
    }
}

fn lock(queue: &Mutex<VecDeque<u8>>) -> MutexGuard<'_, VecDeque<u8>> {
    // Bytes in a queue stay bytes, even if another test thread panicked.
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

    /// A read that a signal interrupts, as Ctrl-C once ended `palpate-hil emulate` with an error in place of its summary.
    #[test]
    fn a_signal_is_no_fault_of_the_terminal() {
        struct Signalled(Vec<Result<Vec<u8>, io::ErrorKind>>);
        impl Read for Signalled {
            fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
                let bytes = self.0.remove(0)?;
                buffer[..bytes.len()].copy_from_slice(&bytes);
                Ok(bytes.len())
            }
        }
        let signal = || Err(io::ErrorKind::Interrupted);
        let (mut seen, some) = (Vec::new(), Ok(b"some".to_vec()));
        let mut port = Signalled(vec![signal(), some, signal(), signal(), Err(io::ErrorKind::TimedOut)]);
        drain(&mut port, &mut seen).expect("no fault");
        assert!(seen == b"some" && port.0.is_empty(), "{seen:?}, {} reads to go", port.0.len());
        let mut gone = Signalled(vec![signal(), Err(io::ErrorKind::BrokenPipe)]);
        let fault = drain(&mut gone, &mut seen).expect_err("gone");
        assert_eq!(fault.kind(), io::ErrorKind::BrokenPipe);
    }

    /// Every byte value: a terminal that is not raw would swallow or change some.
    #[test]
    fn a_pseudo_terminal_is_transparent() {
        let (mut device, mut driver) = PtyTransport::pair().expect("a pseudo terminal");
        let all: Vec<u8> = (0..=255).collect();
        driver.write_all(&all).expect("room for 256 bytes");
        let mut got = Vec::new();
        let mut buffer = [0; 64];
        // No waiting: what was written is there.
        while device.look().expect("open") {
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
