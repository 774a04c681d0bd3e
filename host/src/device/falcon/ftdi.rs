//! The FTDI chip between USB and a device's UART: the functions that the driver needs.
//!
//! Two bulk pipes and vendor requests. Every packet of the IN pipe (at most 64 bytes) begins with two status
//! bytes; a transfer of several packets has them in each packet. Reads and writes may run at the same time on
//! two threads, so an IN transfer can be pending before a request is sent.

use crate::device::DeviceError;
use core::time::Duration;

/// Size of a bulk packet, status bytes included.
pub const PACKET_LEN: usize = 64;
/// Status bytes at the head of every packet from the chip.
pub const STATUS_LEN: usize = 2;

/// A chip, real or emulated.
pub trait Ftdi: Send + Sync {
    /// One vendor request without data: bmRequestType 0x40, wIndex 0.
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError>;

    /// Sends bytes to the UART and returns the number sent.
    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError>;

    /// Reads one transfer from the chip: packets with their status bytes. A transient timeout error if
    /// nothing arrived; a timeout of zero only polls.
    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError>;
}

impl<F: Ftdi + ?Sized> Ftdi for std::sync::Arc<F> {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        (**self).control(request, value)
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        (**self).write(bytes, timeout)
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        (**self).read(buffer, timeout)
    }
}
