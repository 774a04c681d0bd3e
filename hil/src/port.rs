//! A serial port whose other end is in the same process, for a real driver on virtual time. It needs no
//! terminal, no kernel and no waiting.
//!
//! A read with a timeout advances the time of the other end until data arrives or the timeout ends. A read
//! with a zero timeout does not advance it.

use crate::transport::{MemoryTransport, Transport};
use palpate_host::device::nonblocking_port::Port;
use serialport::{ClearBuffer, DataBits, FlowControl, Parity, Result as SerialResult, SerialPort, StopBits};
use std::io::{self, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Time step of a blocking read, us.
const STEP_US: u64 = 100;
/// Error of a terminal after its cable was pulled.
const EIO: i32 = 5;

/// The device at the other end, and its clock.
pub trait FarEnd: Send {
    /// Its time, us.
    fn now_us(&self) -> u64;

    /// Advances to a time.
    fn advance(&mut self, until_us: u64);
}

/// An open port; a clone is a second handle of it.
#[derive(Clone)]
pub struct MemoryPort {
    wire: MemoryTransport,
    far: Arc<Mutex<dyn FarEnd>>,
    plugged: Arc<AtomicBool>,
    timeout: Duration,
}

impl MemoryPort {
    /// A port on the driver's end of a wire whose other end `far` serves. Once `plugged` is false the port is
    /// lost permanently.
    #[must_use]
    pub fn new(wire: MemoryTransport, far: Arc<Mutex<dyn FarEnd>>, plugged: Arc<AtomicBool>) -> Self {
        Self { wire, far, plugged, timeout: Duration::ZERO }
    }

    fn check(&self) -> io::Result<()> {
        if self.plugged.load(Ordering::Relaxed) { Ok(()) } else { Err(io::Error::from_raw_os_error(EIO)) }
    }

    fn far(&self) -> MutexGuard<'_, dyn FarEnd + 'static> {
        self.far.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Read for MemoryPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let until_us = self.far().now_us().saturating_add(self.timeout.as_micros() as u64);
        loop {
            self.check()?;
            let count = self.wire.receive(0, buffer)?;
            if count > 0 {
                return Ok(count);
            }
            let mut far = self.far();
            let now_us = far.now_us();
            if now_us >= until_us {
                return Err(io::ErrorKind::TimedOut.into());
            }
            far.advance((now_us + STEP_US).min(until_us));
        }
    }
}

impl Write for MemoryPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.check()?;
        self.wire.send(0, bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.check()
    }
}

impl Port for MemoryPort {}

/// The modem lines and settings have no effect on USB CDC, and none here.
impl SerialPort for MemoryPort {
    fn name(&self) -> Option<String> {
        Some("memory".into())
    }

    fn baud_rate(&self) -> SerialResult<u32> {
        Ok(115_200)
    }

    fn data_bits(&self) -> SerialResult<DataBits> {
        Ok(DataBits::Eight)
    }

    fn flow_control(&self) -> SerialResult<FlowControl> {
        Ok(FlowControl::None)
    }

    fn parity(&self) -> SerialResult<Parity> {
        Ok(Parity::None)
    }

    fn stop_bits(&self) -> SerialResult<StopBits> {
        Ok(StopBits::One)
    }

    fn timeout(&self) -> Duration {
        self.timeout
    }

    fn set_baud_rate(&mut self, _baud_rate: u32) -> SerialResult<()> {
        Ok(())
    }

    fn set_data_bits(&mut self, _data_bits: DataBits) -> SerialResult<()> {
        Ok(())
    }

    fn set_flow_control(&mut self, _flow_control: FlowControl) -> SerialResult<()> {
        Ok(())
    }

    fn set_parity(&mut self, _parity: Parity) -> SerialResult<()> {
        Ok(())
    }

    fn set_stop_bits(&mut self, _stop_bits: StopBits) -> SerialResult<()> {
        Ok(())
    }

    fn set_timeout(&mut self, timeout: Duration) -> SerialResult<()> {
        self.timeout = timeout;
        Ok(())
    }

    fn write_request_to_send(&mut self, _level: bool) -> SerialResult<()> {
        Ok(())
    }

    fn write_data_terminal_ready(&mut self, _level: bool) -> SerialResult<()> {
        Ok(())
    }

    fn read_clear_to_send(&mut self) -> SerialResult<bool> {
        Ok(true)
    }

    fn read_data_set_ready(&mut self) -> SerialResult<bool> {
        Ok(true)
    }

    fn read_ring_indicator(&mut self) -> SerialResult<bool> {
        Ok(false)
    }

    fn read_carrier_detect(&mut self) -> SerialResult<bool> {
        Ok(true)
    }

    fn bytes_to_read(&self) -> SerialResult<u32> {
        self.check()?;
        Ok(self.wire.waiting() as u32)
    }

    fn bytes_to_write(&self) -> SerialResult<u32> {
        Ok(0)
    }

    fn clear(&self, which: ClearBuffer) -> SerialResult<()> {
        self.check()?;
        // Written bytes have already reached the other end.
        if which != ClearBuffer::Output {
            self.wire.clear();
        }
        Ok(())
    }

    fn try_clone(&self) -> SerialResult<Box<dyn SerialPort>> {
        self.check()?;
        Ok(Box::new(self.clone()))
    }

    fn set_break(&self) -> SerialResult<()> {
        Ok(())
    }

    fn clear_break(&self) -> SerialResult<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends one byte at a given time.
    struct Alarm {
        now_us: u64,
        at_us: u64,
        wire: MemoryTransport,
    }

    impl FarEnd for Alarm {
        fn now_us(&self) -> u64 {
            self.now_us
        }

        fn advance(&mut self, until_us: u64) {
            if (self.now_us..until_us).contains(&self.at_us) {
                self.wire.send(0, b"!").expect("memory");
            }
            self.now_us = until_us;
        }
    }

    #[test]
    fn a_read_advances_virtual_time_and_unplugging_is_an_error_for_every_handle() {
        let (wire, driver) = MemoryTransport::pair();
        let far = Arc::new(Mutex::new(Alarm { now_us: 0, at_us: 5_050, wire }));
        let plugged = Arc::new(AtomicBool::new(true));
        let mut port =
            MemoryPort::new(driver, Arc::clone(&far) as Arc<Mutex<dyn FarEnd>>, Arc::clone(&plugged));
        let mut buffer = [0; 8];
        let kind = |read: io::Result<usize>| read.map_err(|error| error.kind());
        assert_eq!(kind(port.read(&mut buffer)), Err(io::ErrorKind::TimedOut));
        assert_eq!(far.lock().expect("valid").now_us, 0, "polling takes no time");
        port.set_timeout(Duration::from_millis(2)).expect("a setting");
        assert_eq!(kind(port.read(&mut buffer)), Err(io::ErrorKind::TimedOut));
        assert_eq!(far.lock().expect("valid").now_us, 2_000);
        port.set_timeout(Duration::from_secs(2)).expect("a setting");
        assert_eq!((kind(port.read(&mut buffer)), buffer[0]), (Ok(1), b'!'));
        assert_eq!(far.lock().expect("valid").now_us, 5_100);

        let mut second = port.try_clone().expect("open");
        second.write_all(b"x").expect("open");
        plugged.store(false, Ordering::Relaxed);
        assert_eq!(second.write(b"x").map_err(|error| error.raw_os_error()), Err(Some(EIO)));
        assert!(port.read(&mut buffer).is_err() && port.bytes_to_read().is_err());
    }
}
