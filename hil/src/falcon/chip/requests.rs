//! Control transfers: the standard requests of a device with one configuration, and the vendor requests of
//! the chip.

use super::Chip;
use crate::falcon::descriptors;
use crate::falcon::uart::baud_of;

/// Setup packet of a control transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setup {
    /// bmRequestType.
    pub request_type: u8,
    /// bRequest.
    pub request: u8,
    /// wValue.
    pub value: u16,
    /// wIndex.
    pub index: u16,
    /// wLength.
    pub length: u16,
}

impl Setup {
    /// A vendor request without data.
    #[must_use]
    pub const fn vendor(request: u8, value: u16) -> Self {
        Self { request_type: 0x40, request, value, index: 0, length: 0 }
    }
}

/// An unsupported request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stall;

impl core::fmt::Display for Stall {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("request stalled")
    }
}

impl core::error::Error for Stall {}

impl Chip {
    /// Handles a control transfer. Returns the data for the host, empty for a request out.
    pub fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        let mut answer = match setup.request_type {
            0x40 if data.is_empty() && setup.length == 0 => self.vendor_out(setup).map(|()| Vec::new()),
            0xc0 => self.vendor_in(setup),
            0x00..=0x02 => self.standard_out(setup).map(|()| Vec::new()),
            0x80..=0x82 => self.standard_in(setup),
            _ => Err(Stall),
        }?;
        answer.truncate(usize::from(setup.length));
        Ok(answer)
    }

    fn vendor_out(&mut self, Setup { request, value, index, .. }: Setup) -> Result<(), Stall> {
        // There is one interface, so only two requests carry a value in the index.
        if index != 0 && !matches!(request, 2 | 3) {
            return Err(Stall);
        }
        match (request, value) {
            (0, 0) => self.reset(),
            (0, 1) => self.purge_received(),
            (0, 2) => self.to_board.clear(),
            (1, _) => {
                let [state, mask] = value.to_le_bytes();
                if mask & 1 != 0 {
                    self.lines.dtr = state & 1 != 0;
                }
                if mask & 2 != 0 {
                    self.lines.rts = state & 2 != 0;
                }
            }
            (2, 0) if index == 0 => {}
            (3, _) if index <= 1 => self.baud = baud_of(value, index),
            (4, _) => self.is_8n1 = value == 8,
            (6, _) => self.event = (value & 0x100 != 0).then_some(value as u8),
            (9, 1..=255) => {
                self.latency_ms = value as u8;
                self.restart_timer();
            }
            _ => return Err(Stall),
        }
        Ok(())
    }

    fn vendor_in(&self, setup: Setup) -> Result<Vec<u8>, Stall> {
        match setup.request {
            5 => Ok(self.status().to_vec()),
            10 => Ok(vec![self.latency_ms]),
            _ => Err(Stall),
        }
    }

    const fn standard_out(&mut self, setup: Setup) -> Result<(), Stall> {
        match (setup.request, setup.value) {
            (9, 0 | 1) => self.configuration = setup.value as u8,
            // The host controller assigns the address, a halted pipe is cleared, and the interface has one
            // setting.
            (5, _) | (1 | 11, 0) => {}
            _ => return Err(Stall),
        }
        Ok(())
    }

    fn standard_in(&self, setup: Setup) -> Result<Vec<u8>, Stall> {
        match setup.request {
            0 => Ok(vec![0, 0]),
            6 => descriptors::descriptor(setup.value).ok_or(Stall),
            8 => Ok(vec![self.configuration]),
            10 => Ok(vec![0]),
            _ => Err(Stall),
        }
    }
}
