//! The FTDI chip between USB and a device's UART, as far as a driver needs it.
//!
//! Two bulk pipes and vendor requests. Every packet of the pipe in (64 bytes at most) begins with two status bytes; a transfer of several
//! packets has them in each. Reading and writing go on at the same time from two threads, so that a transfer in can be waiting before a
//! request goes out.

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

    /// Sends bytes to the UART; gives how many went.
    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError>;

    /// One transfer from the chip, as it comes: packets with their status bytes. A passing timeout error if nothing came; a zero timeout
    /// only looks.
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
