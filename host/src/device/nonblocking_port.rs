//! A serial port whose writes do not block.
//!
//! `serialport` calls poll(2) before each write. On Linux poll of a terminal without input waits for the
//! kernel's worker that delivers its input (n_tty_poll), regardless of the timeout: on a busy machine 200 ms
//! were measured, in a thread with SCHED_FIFO. write(2) itself does not wait for that worker, and on a
//! non-blocking port it does not wait for room either.

use crate::sys;
use serialport::{
    ClearBuffer, DataBits, FlowControl, Parity, Result, SerialPort, SerialPortBuilder, StopBits, TTYPort,
};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::time::Duration;

/// A serial port that a guard can share.
pub trait Port: SerialPort {
    /// A duplicate of the open descriptor whose writes do not block; `None` for a port without one.
    fn duplicate(&self) -> io::Result<Option<OwnedFd>> {
        Ok(None)
    }
}

/// The port, and its descriptor for writing. The port is opened once, and stays locked (flock) until the last
/// duplicate of the descriptor is closed.
#[derive(Debug)]
pub struct NonBlockingPort {
    port: TTYPort,
    out: File,
}

impl NonBlockingPort {
    /// Opens the port described by `builder`.
    pub fn open(builder: SerialPortBuilder) -> Result<Self> {
        Self::from_port(builder.open_native()?)
    }

    /// Wraps an open port. Its reads wait for data before they read, so they do not mind that it no longer
    /// blocks.
    pub fn from_port(port: TTYPort) -> Result<Self> {
        let out = File::from(sys::duplicate_non_blocking(&port)?);
        Ok(Self { port, out })
    }
}

impl Port for NonBlockingPort {
    fn duplicate(&self) -> io::Result<Option<OwnedFd>> {
        self.out.try_clone().map(|file| Some(file.into()))
    }
}

impl Read for NonBlockingPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.port.read(buffer)
    }
}

impl Write for NonBlockingPort {
    /// Writes as much as there is room for, without blocking; [`ErrorKind::TimedOut`] if there is no room, as
    /// in `serialport`.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes).map_err(|error| match error.kind() {
            ErrorKind::WouldBlock => ErrorKind::TimedOut.into(),
            _ => error,
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl SerialPort for NonBlockingPort {
    fn name(&self) -> Option<String> {
        self.port.name()
    }

    fn baud_rate(&self) -> Result<u32> {
        self.port.baud_rate()
    }

    fn data_bits(&self) -> Result<DataBits> {
        self.port.data_bits()
    }

    fn flow_control(&self) -> Result<FlowControl> {
        self.port.flow_control()
    }

    fn parity(&self) -> Result<Parity> {
        self.port.parity()
    }

    fn stop_bits(&self) -> Result<StopBits> {
        self.port.stop_bits()
    }

    fn timeout(&self) -> Duration {
        self.port.timeout()
    }

    fn set_baud_rate(&mut self, baud_rate: u32) -> Result<()> {
        self.port.set_baud_rate(baud_rate)
    }

    fn set_data_bits(&mut self, data_bits: DataBits) -> Result<()> {
        self.port.set_data_bits(data_bits)
    }

    fn set_flow_control(&mut self, flow_control: FlowControl) -> Result<()> {
        self.port.set_flow_control(flow_control)
    }

    fn set_parity(&mut self, parity: Parity) -> Result<()> {
        self.port.set_parity(parity)
    }

    fn set_stop_bits(&mut self, stop_bits: StopBits) -> Result<()> {
        self.port.set_stop_bits(stop_bits)
    }

    fn set_timeout(&mut self, timeout: Duration) -> Result<()> {
        self.port.set_timeout(timeout)
    }

    fn write_request_to_send(&mut self, level: bool) -> Result<()> {
        self.port.write_request_to_send(level)
    }

    fn write_data_terminal_ready(&mut self, level: bool) -> Result<()> {
        self.port.write_data_terminal_ready(level)
    }

    fn read_clear_to_send(&mut self) -> Result<bool> {
        self.port.read_clear_to_send()
    }

    fn read_data_set_ready(&mut self) -> Result<bool> {
        self.port.read_data_set_ready()
    }

    fn read_ring_indicator(&mut self) -> Result<bool> {
        self.port.read_ring_indicator()
    }

    fn read_carrier_detect(&mut self) -> Result<bool> {
        self.port.read_carrier_detect()
    }

    fn bytes_to_read(&self) -> Result<u32> {
        self.port.bytes_to_read()
    }

    fn bytes_to_write(&self) -> Result<u32> {
        self.port.bytes_to_write()
    }

    fn clear(&self, which: ClearBuffer) -> Result<()> {
        self.port.clear(which)
    }

    fn try_clone(&self) -> Result<Box<dyn SerialPort>> {
        Ok(Box::new(Self { port: self.port.try_clone_native()?, out: self.out.try_clone()? }))
    }

    fn set_break(&self) -> Result<()> {
        self.port.set_break()
    }

    fn clear_break(&self) -> Result<()> {
        self.port.clear_break()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_bytes_arrive_and_a_full_port_fails_at_once() {
        let (mut far, near) = TTYPort::pair().expect("a pseudo terminal");
        far.set_timeout(Duration::from_secs(2)).expect("set");
        let mut port = NonBlockingPort::from_port(near).expect("it has a name");
        let mut second = port.try_clone().expect("a second handle");
        port.write_all(b"one").expect("room");
        second.write_all(b"two").expect("room");
        let mut six = [0; 6];
        far.read_exact(&mut six).expect("they arrive");
        assert_eq!(&six, b"onetwo");
        // The reader stops: writes fill the buffer, then fail without waiting.
        let started = std::time::Instant::now();
        let full = (0..100_000).find_map(|_| port.write(&[b'x'; 1024]).err()).expect("it is full");
        assert_eq!(full.kind(), ErrorKind::TimedOut);
        assert!(started.elapsed() < Duration::from_secs(5), "{:?}", started.elapsed());
    }
}
