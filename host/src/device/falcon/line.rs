//! Vendor requests that configure the FTDI chip and its UART, and removal of its status bytes.

use super::ftdi::{Ftdi, PACKET_LEN, STATUS_LEN};
use crate::device::{DeviceError, DeviceErrorKind};
use core::time::Duration;

/// A vendor request of the chip. Source of the values: libnifalcon, libftdi.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setting {
    /// Reset the chip.
    Reset,
    /// Discard bytes that are received and not yet read.
    PurgeReceived,
    /// Discard bytes that are not yet sent.
    PurgeUnsent,
    /// The DTR line; it is connected to the processor.
    Dtr(bool),
    /// RTS line low.
    RtsLow,
    /// No flow control.
    NoFlowControl,
    /// 9,600 baud: the initial rate of the processor's boot loader.
    Baud9600,
    /// 142,857 baud: the rate for the image.
    BaudImage,
    /// 1.5 Mbaud: the rate of the firmware.
    BaudFirmware,
    /// Eight bits, no parity, one stop bit.
    EightBits,
    /// Latency timer, ms: a packet is sent to the host after this time even if it is not full.
    Latency(u8),
    /// A packet is sent to the host as soon as this byte is received.
    EventByte(u8),
}

impl Setting {
    /// bRequest and wValue.
    #[must_use]
    pub const fn request(self) -> (u8, u16) {
        match self {
            Self::Reset => (0, 0),
            Self::PurgeReceived => (0, 1),
            Self::PurgeUnsent => (0, 2),
            Self::Dtr(false) => (1, 0x100),
            Self::Dtr(true) => (1, 0x101),
            Self::RtsLow => (1, 0x200),
            Self::NoFlowControl => (2, 0),
            Self::Baud9600 => (3, 0x4138),
            Self::BaudImage => (3, 0x15),
            Self::BaudFirmware => (3, 0x2),
            Self::EightBits => (4, 0x0008),
            Self::EventByte(byte) => (6, 0x100 | byte as u16),
            Self::Latency(ms) => (9, ms as u16),
        }
    }

    /// Sends the request to the chip.
    pub fn apply(self, ftdi: &impl Ftdi) -> Result<(), DeviceError> {
        let (request, value) = self.request();
        ftdi.control(request, value)
    }
}

/// Sends several requests in order.
pub fn apply_all(ftdi: &impl Ftdi, settings: &[Setting]) -> Result<(), DeviceError> {
    settings.iter().try_for_each(|setting| setting.apply(ftdi))
}

/// The UART bytes of a transfer from the chip: each packet without its status bytes.
pub fn payload(transfer: &[u8]) -> impl Iterator<Item = &[u8]> {
    transfer.chunks(PACKET_LEN).map(|packet| packet.get(STATUS_LEN..).unwrap_or_default())
}

/// Timeout for a reply.
///
/// It is counted in reads without data: the chip sends its status bytes whenever the latency timer expires,
/// which bounds such a read. An emulator's time may differ from ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReplyTimeout {
    /// Consecutive reads without data.
    pub reads: u32,
    /// Longest duration of one of them.
    pub each: Duration,
}

/// Reads until `is_enough` or the timeout, which is not an error; returns the received bytes.
pub fn read_until(
    ftdi: &impl Ftdi,
    timeout: ReplyTimeout,
    mut is_enough: impl FnMut(&[u8]) -> bool,
) -> Result<Vec<u8>, DeviceError> {
    let mut transfer = [0; 8 * PACKET_LEN];
    let mut received = Vec::new();
    let mut silent_reads = 0;
    while silent_reads < timeout.reads && !is_enough(&received) {
        let count = match ftdi.read(&mut transfer, timeout.each) {
            Ok(count) => count,
            Err(error) if error.kind() == DeviceErrorKind::Timeout => 0,
            Err(error) => return Err(error),
        };
        let before = received.len();
        payload(&transfer[..count]).for_each(|bytes| received.extend_from_slice(bytes));
        silent_reads = if received.len() > before { 0 } else { silent_reads + 1 };
    }
    Ok(received)
}

/// Sends all bytes.
pub fn send(ftdi: &impl Ftdi, mut bytes: &[u8], timeout: Duration) -> Result<(), DeviceError> {
    while !bytes.is_empty() {
        match ftdi.write(bytes, timeout)? {
            0 => return Err(DeviceError::new(DeviceErrorKind::Timeout)),
            sent => bytes = bytes.get(sent..).unwrap_or_default(),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_bytes_are_removed_from_every_packet() {
        let mut transfer = vec![0x01, 0x60];
        transfer.extend(1..=62);
        transfer.extend([0x01, 0x60, 63, 64]);
        let bytes: Vec<u8> = payload(&transfer).flatten().copied().collect();
        assert_eq!(bytes, (1..=64).collect::<Vec<u8>>());
        for nothing in [&[][..], &[1], &[1, 0x60]] {
            assert_eq!(payload(nothing).flatten().count(), 0, "{nothing:?}");
        }
    }
}
