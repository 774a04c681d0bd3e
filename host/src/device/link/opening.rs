//! Opens a session, before the loop; may block.

use super::stopping::write;
use super::{Counter, Homing, Link, LinkConfig, SlewLimiter};
use crate::device::fence::Fence;
use crate::device::in_flight::Numbered;
use crate::device::nonblocking_port::Port;
use crate::device::serial::{from_serial, open};
use crate::device::{DeviceError, DeviceErrorKind, wait_homed};
use core::fmt;
use core::sync::atomic::AtomicBool;
use palpate_link::{DeviceInfo, DeviceMessage, FrameReader, HostMessage, InfoError, VERSION};
use serialport::SerialPort;
use std::hash::{BuildHasher, RandomState};
use std::io::ErrorKind;
use std::time::{Duration, Instant};

/// Wait for the reply to one Hello: twice the longest latency of an FTDI adapter, in both directions.
const HELLO_WAIT: Duration = Duration::from_millis(70);
/// Largest number of reads in one wait, in case a device sends continuously.
const MAX_READS: usize = 64;

/// Reason why there is no session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkError {
    /// The port failed.
    Device(DeviceError),
    /// No reply.
    Silent,
    /// The device uses another version of the link.
    Version {
        /// Its version.
        theirs: u16,
    },
    /// The device's description of itself is invalid.
    Info(InfoError),
    /// Too few axes.
    Axes {
        /// Number of axes.
        dof: u8,
    },
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(error) => write!(f, "{error}"),
            Self::Silent => {
                f.write_str("no reply to Hello; check power, port and baud rate (link:PORT@BAUD)")
            }
            Self::Version { theirs } => {
                write!(
                    f,
                    "the device speaks version {theirs} of the link, this program version {VERSION}; update one of them"
                )
            }
            Self::Info(error) => write!(f, "{error}; correct the firmware (docs/formats.md, section 7)"),
            Self::Axes { dof } => write!(f, "the device has {dof} axes; use a device with 3"),
        }
    }
}

impl core::error::Error for LinkError {}

impl From<DeviceError> for LinkError {
    fn from(error: DeviceError) -> Self {
        Self::Device(error)
    }
}

impl Link {
    /// Opens a port by its name and a session with the device.
    pub fn open(path: &str, baud: u32, config: LinkConfig) -> Result<Self, LinkError> {
        let port = open(path, baud)?;
        Self::with_port(port, config)
    }

    /// [`Device::home`](crate::Device::home).
    pub(super) fn wait_homed(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        wait_homed(self, stop)?;
        // Open requests have times of another clock: start a new session with the first tick.
        (self.opening_session, self.hello_sent_us) = (true, None);
        Ok(self.homing == Homing::Homed)
    }

    /// Opens a session with the device behind an open port, disabled and without torque. Blocks for at most
    /// the timeout.
    pub fn with_port(mut port: Box<dyn Port>, config: LinkConfig) -> Result<Self, LinkError> {
        port.set_timeout(HELLO_WAIT).map_err(from_serial)?;
        let mut nonce = RandomState::new().hash_one(0) as u32;
        let give_up = Instant::now() + config.open_timeout;
        let mut reader = FrameReader::new();
        let (session, device) = loop {
            nonce = nonce.wrapping_add(1);
            write(&mut *port, &HostMessage::Hello { version: VERSION, nonce })?;
            if let Some(ack) = wait_for_ack(&mut *port, &mut reader, nonce)? {
                break ack;
            }
            if Instant::now() > give_up {
                return Err(LinkError::Silent);
            }
        };
        // From here on a write that does not complete immediately is a fault of the link.
        port.set_timeout(Duration::ZERO).map_err(from_serial)?;
        Ok(Self {
            port,
            config,
            device,
            reader,
            session,
            opening_session: false,
            nonce,
            hello_sent_us: None,
            requests: Numbered::default(),
            homing: Homing::Unknown,
            enabled: false,
            latched: None,
            unreported: false,
            counter: Counter::default(),
            slew: SlewLimiter::default(),
            rendering: false,
            lost: false,
            fence: Fence::default(),
        })
    }
}

/// Waits for the reply to one Hello and returns session and device, if they are valid. Earlier messages are
/// discarded.
fn wait_for_ack(
    port: &mut dyn SerialPort,
    reader: &mut FrameReader<DeviceMessage>,
    expected: u32,
) -> Result<Option<(u32, DeviceInfo)>, LinkError> {
    let mut chunk = [0; 256];
    for _ in 0..MAX_READS {
        let count = match port.read(&mut chunk) {
            Ok(0) => return Ok(None),
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::TimedOut => return Ok(None),
            Err(error) => return Err(DeviceError::from(error).into()),
        };
        let mut bytes = &chunk[..count];
        while let Some(outcome) = reader.read(&mut bytes) {
            let Ok(DeviceMessage::HelloAck { version, nonce, session, info }) = outcome else { continue };
            if nonce != expected {
                continue;
            }
            if version != VERSION {
                return Err(LinkError::Version { theirs: version });
            }
            info.check().map_err(LinkError::Info)?;
            if info.dof < 3 {
                return Err(LinkError::Axes { dof: info.dof });
            }
            if session == 0 {
                return Err(DeviceError::new(DeviceErrorKind::Unsupported).into());
            }
            return Ok(Some((session, info)));
        }
    }
    Ok(None)
}
