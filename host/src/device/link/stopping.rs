//! Removal of the torque: Disable from the driver, in its drop, and from a second handle; and the writing of
//! messages.

use super::Link;
use crate::device::{DeviceError, DeviceErrorKind, EmergencyStop};
use core::sync::atomic::{AtomicU32, Ordering};
use palpate_link::{HostMessage, MAX_FRAME, encode};
use serialport::SerialPort;
use std::sync::Arc;

impl Link {
    pub(super) fn disable(&mut self) {
        // If the port is gone, the error cannot be handled here.
        let _ = write(&mut *self.port, &disable(&self.session));
        (self.enabled, self.rendering) = (false, false);
    }

    /// Sends Disable twice: a frame is rarely lost, two in a row very rarely.
    pub(super) fn disable_twice(&mut self) {
        for _ in 0..2 {
            self.disable();
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.disable_twice();
    }
}

/// A second handle of the same port. The device executes Disable whatever its number, and the driver sees
/// that the device is no longer enabled.
pub(super) struct SecondHandle {
    port: Box<dyn SerialPort>,
    session: Arc<AtomicU32>,
}

impl SecondHandle {
    /// `None` if the port cannot be cloned.
    pub(super) fn of(link: &Link) -> Option<Self> {
        let port = link.port.try_clone().ok()?;
        Some(Self { port, session: Arc::clone(&link.session) })
    }
}

impl EmergencyStop for SecondHandle {
    fn zero(&mut self) -> Result<(), DeviceError> {
        let disable = disable(&self.session);
        let first = write(&mut *self.port, &disable);
        write(&mut *self.port, &disable).and(first)
    }
}

fn disable(session: &AtomicU32) -> HostMessage {
    HostMessage::Disable { session: session.load(Ordering::Acquire), seq: 0 }
}

/// Writes one message with a leading 00, which ends an incomplete frame before it.
pub(super) fn write(port: &mut dyn SerialPort, message: &HostMessage) -> Result<(), DeviceError> {
    let (mut frame, mut bytes) = ([0; MAX_FRAME], [0; MAX_FRAME + 1]);
    // No message exceeds the size of a frame.
    let frame = encode(message, &mut frame).map_err(|_| DeviceError::new(DeviceErrorKind::Unsupported))?;
    bytes[1..=frame.len()].copy_from_slice(frame);
    port.write_all(&bytes[..=frame.len()]).map_err(DeviceError::from)
}
