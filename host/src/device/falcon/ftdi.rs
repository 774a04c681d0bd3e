//! The FTDI chip between USB and a device's UART: the functions that the driver needs.
//!
//! Two bulk pipes and vendor requests. Every packet of the IN pipe (at most 64 bytes) begins with two status
//! bytes; a transfer of several packets has them in each packet. Reads and writes may run at the same time on
//! two threads, so an IN transfer can be pending before a request is sent.

use crate::device::DeviceError;
use crate::device::fence::GuardPath;
use core::time::Duration;
use std::io;

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

    /// A guard's path to the chip; `None` for a chip in memory.
    fn guard_path(&self) -> io::Result<Option<GuardPath>> {
        Ok(None)
    }

    /// The bytes by which a guard sends a packet on its path.
    fn guard_message(&self, packet: &[u8]) -> Vec<u8> {
        packet.to_vec()
    }
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

    fn guard_path(&self) -> io::Result<Option<GuardPath>> {
        (**self).guard_path()
    }

    fn guard_message(&self, packet: &[u8]) -> Vec<u8> {
        (**self).guard_message(packet)
    }
}
