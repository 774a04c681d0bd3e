//! The chip with waits that fit a machine whose time is not real.

use palpate_host::DeviceError;
use palpate_host::device::falcon::{Ftdi, UsbFtdi};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A driver reads, and has not lost its device.
#[derive(Debug, Default)]
pub(crate) struct Reader {
    pub reads: AtomicBool,
}

/// The chip on the guest's USB.
#[derive(Debug)]
pub(crate) struct Patient {
    chip: UsbFtdi,
    /// Shortest wait of a write.
    write: Duration,
    /// Longest wait of a read.
    read: Duration,
    reader: Arc<Reader>,
}

impl Patient {
    /// A write may take at least so long, a read at most.
    pub(crate) fn new(chip: UsbFtdi, write: Duration, read: Duration) -> Self {
        Self { chip, write, read, reader: Arc::default() }
    }

    /// Who reads.
    pub(crate) fn reader(&self) -> Arc<Reader> {
        Arc::clone(&self.reader)
    }

    /// An error after which nobody reads any more.
    fn noted<T>(&self, result: Result<T, DeviceError>) -> Result<T, DeviceError> {
        if result.as_ref().is_err_and(|error| !error.kind().is_transient()) {
            self.reader.reads.store(false, Ordering::Release);
        }
        result
    }
}

impl Ftdi for Patient {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.chip.control(request, value)
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        self.chip.write(bytes, timeout.max(self.write))
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        self.noted(self.chip.read(buffer, timeout.min(self.read)))
    }
}
