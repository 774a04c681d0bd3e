//! The ways that take the torque away: Disable from the driver, at its end, and from a second handle; and how a message leaves.

use super::Link;
use crate::device::{DeviceError, DeviceErrorKind, EmergencyStop};
use core::sync::atomic::{AtomicU32, Ordering};
use palpate_core::link::{HostMessage, MAX_FRAME, encode};
use serialport::SerialPort;
use std::sync::Arc;

impl Link {
    pub(super) fn disable(&mut self) {
        // A port that is gone cannot be helped, and there is nobody left to tell.
        let _ = write(&mut *self.port, &disable(&self.session));
        (self.enabled, self.rendering) = (false, false);
    }

    /// Twice: a frame is seldom lost, two in a row hardly ever.
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

/// The same port on a second handle. Disable is obeyed whatever its number, and the driver sees that the device no longer obeys.
pub(super) struct SecondHandle {
    port: Box<dyn SerialPort>,
    session: Arc<AtomicU32>,
}

impl SecondHandle {
    /// Nothing where the port has only one.
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

/// Sends one message, a 00 before it: what was cut short before must not take it along.
pub(super) fn write(port: &mut dyn SerialPort, message: &HostMessage) -> Result<(), DeviceError> {
    let (mut frame, mut bytes) = ([0; MAX_FRAME], [0; MAX_FRAME + 1]);
    // No message is longer than a frame.
    let frame = encode(message, &mut frame).map_err(|_| DeviceError::new(DeviceErrorKind::Unsupported))?;
    bytes[1..=frame.len()].copy_from_slice(frame);
    port.write_all(&bytes[..=frame.len()]).map_err(DeviceError::from)
}
