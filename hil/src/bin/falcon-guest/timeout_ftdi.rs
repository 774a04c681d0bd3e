//! The USB chip with timeouts adapted to a machine whose clock is not real time.

use palpate_host::DeviceError;
use palpate_host::device::falcon::{Ftdi, UsbFtdi};
use palpate_host::device::fence::GuardPath;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Whether a driver reads and still has its device.
#[derive(Debug, Default)]
pub(crate) struct Reader {
    pub reads: AtomicBool,
}

/// The chip on the guest's USB.
#[derive(Debug)]
pub(crate) struct TimeoutFtdi {
    chip: UsbFtdi,
    /// Shortest write timeout.
    write: Duration,
    /// Longest read timeout.
    read: Duration,
    reader: Arc<Reader>,
}

impl TimeoutFtdi {
    /// Writes time out after at least `write`, reads after at most `read`.
    pub(crate) fn new(chip: UsbFtdi, write: Duration, read: Duration) -> Self {
        Self { chip, write, read, reader: Arc::default() }
    }

    /// State of the reading driver.
    pub(crate) fn reader(&self) -> Arc<Reader> {
        Arc::clone(&self.reader)
    }

    /// After a permanent error nothing reads any more.
    fn stop_on_error<T>(&self, result: Result<T, DeviceError>) -> Result<T, DeviceError> {
        if result.as_ref().is_err_and(|error| !error.kind().is_transient()) {
            self.reader.reads.store(false, Ordering::Release);
        }
        result
    }
}

impl Ftdi for TimeoutFtdi {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.chip.control(request, value)
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        self.chip.write(bytes, timeout.max(self.write))
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        self.stop_on_error(self.chip.read(buffer, timeout.min(self.read)))
    }

    fn guard_path(&self) -> std::io::Result<Option<GuardPath>> {
        self.chip.guard_path()
    }
}
