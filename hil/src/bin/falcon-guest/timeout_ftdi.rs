//! The USB chip with timeouts adapted to a machine whose clock is not real time.

use palpate_host::DeviceError;
use palpate_host::device::falcon::{Ftdi, UsbFtdi};
use palpate_host::device::fence::GuardPath;
use std::time::Duration;

/// The chip on the guest's USB.
#[derive(Debug)]
pub(crate) struct TimeoutFtdi {
    chip: UsbFtdi,
    /// Shortest write timeout.
    write: Duration,
}

impl TimeoutFtdi {
    /// Writes time out after at least `write`.
    pub(crate) fn new(chip: UsbFtdi, write: Duration) -> Self {
        Self { chip, write }
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
        self.chip.read(buffer, timeout)
    }

    fn guard_path(&self) -> std::io::Result<Option<GuardPath>> {
        self.chip.guard_path()
    }
}
