//! Removal of the torque: Disable from the driver, in its drop, and from its guard; and the writing of messages.

use super::Link;
use crate::device::fence::{Fence, GuardPath, Wire};
use crate::device::{DeviceError, DeviceErrorKind};
use palpate_link::{HostMessage, MAX_FRAME, encode};
use serialport::SerialPort;

impl Link {
    pub(super) fn disable(&mut self) {
        // If the port is gone, the error cannot be handled here.
        let _ = write(&mut *self.port, &disable(self.session));
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

impl Link {
    /// The guard's path: Disable, twice. The device executes it whatever its number, and the driver sees that
    /// the device is no longer enabled.
    pub(super) fn guarded_by(&mut self, fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        self.fence = fence.clone();
        self.renew_zero_message();
        Ok(self.port.duplicate()?.map(|fd| GuardPath { fd, wire: Wire::Stream }))
    }

    /// The guard's Disable names the session, which changes. Runs in an exchange: it does not allocate.
    pub(super) fn renew_zero_message(&self) {
        let mut frames = [[0; MAX_FRAME + 1]; 2];
        let [first, second] = &mut frames;
        // No message exceeds the size of a frame.
        if let Ok(len) = frame(&disable(self.session), first) {
            *second = *first;
            let message = frames.as_flattened_mut();
            message.copy_within(MAX_FRAME + 1..MAX_FRAME + 1 + len, len);
            self.fence.set_zero_message(&message[..2 * len]);
        }
    }
}

const fn disable(session: u32) -> HostMessage {
    HostMessage::Disable { session, seq: 0 }
}

/// Encodes one message with a leading 00, which ends an incomplete frame before it; the number of bytes.
fn frame(message: &HostMessage, bytes: &mut [u8; MAX_FRAME + 1]) -> Result<usize, DeviceError> {
    let mut frame = [0; MAX_FRAME];
    // No message exceeds the size of a frame.
    let frame = encode(message, &mut frame).map_err(|_| DeviceError::new(DeviceErrorKind::Unsupported))?;
    bytes[0] = 0;
    bytes[1..=frame.len()].copy_from_slice(frame);
    Ok(frame.len() + 1)
}

/// Writes one message.
pub(super) fn write(port: &mut dyn SerialPort, message: &HostMessage) -> Result<(), DeviceError> {
    let mut bytes = [0; MAX_FRAME + 1];
    let len = frame(message, &mut bytes)?;
    port.write_all(&bytes[..len]).map_err(DeviceError::from)
}
