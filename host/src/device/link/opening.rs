//! Opening a session, before the loop: may block.

use super::requests::Requests;
use super::stopping::write;
use super::{Counter, Homing, Link, LinkConfig, Rise};
use crate::device::serial::{from_serial, open};
use crate::device::{DeviceError, DeviceErrorKind, wait_homed};
use core::fmt;
use core::sync::atomic::AtomicBool;
use palpate_core::link::{DeviceInfo, DeviceMessage, FrameReader, HostMessage, InfoError, VERSION};
use serialport::SerialPort;
use std::hash::{BuildHasher, RandomState};
use std::io::ErrorKind;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long one Hello is waited for. Twice the longest that an adapter of FTDI may hold bytes back, both ways.
const HELLO_WAIT: Duration = Duration::from_millis(70);
/// Reads of one wait: a device that babbles is no reason to wait for ever.
const MOST_READS: usize = 64;

/// Why there is no session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkError {
    /// The port failed.
    Device(DeviceError),
    /// Nobody answers.
    Silent,
    /// The device speaks another version of the link.
    Version {
        /// Which.
        theirs: u16,
    },
    /// What the device says of itself cannot be worked with.
    Info(InfoError),
    /// Fewer axes than a hand moves in.
    Axes {
        /// How many.
        dof: u8,
    },
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(error) => write!(f, "{error}; check port and power"),
            Self::Silent => {
                f.write_str("no answer to Hello; check power, port and baud rate (link:PORT@BAUD)")
            }
            Self::Version { theirs } => {
                write!(
                    f,
                    "the device speaks version {theirs} of the link, this program version {VERSION}; update one of them"
                )
            }
            Self::Info(error) => write!(f, "{error}; correct the firmware (docs/formats.md, section 7)"),
            Self::Axes { dof } => write!(f, "the device has {dof} axes; only mechanisms of 3 can be driven"),
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
    /// Opens a port by its name and a session with the device behind it.
    pub fn open(path: &str, baud: u32, config: LinkConfig) -> Result<Self, LinkError> {
        let port = open(serialport::new(path, baud))?;
        Self::with_port(port, config)
    }

    /// Waits until it is homed, or until `stop`; true if it is homed. Before the loop, whose clock begins anew.
    pub fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        wait_homed(self, stop)?;
        // What is still open belongs to another time: a new session, whose first Hello goes with the first tick.
        (self.greeting, self.greeted_us) = (true, None);
        Ok(self.homing == Homing::Homed)
    }

    /// Opens a session with the device behind an open port: disabled, without a torque. Blocks for up to the patience.
    pub fn with_port(mut port: Box<dyn SerialPort>, config: LinkConfig) -> Result<Self, LinkError> {
        port.set_timeout(HELLO_WAIT).map_err(from_serial)?;
        let mut nonce = RandomState::new().hash_one(0) as u32;
        let give_up = Instant::now() + config.patience;
        let mut reader = FrameReader::new();
        let (session, device) = loop {
            nonce = nonce.wrapping_add(1);
            write(&mut *port, &HostMessage::Hello { version: VERSION, nonce })?;
            if let Some(acknowledged) = acknowledged(&mut *port, &mut reader, nonce)? {
                break acknowledged;
            }
            if Instant::now() > give_up {
                return Err(LinkError::Silent);
            }
        };
        // From here on what cannot go at once is a fault of the link, not something to wait for.
        port.set_timeout(Duration::ZERO).map_err(from_serial)?;
        Ok(Self {
            port,
            config,
            device,
            reader,
            session: Arc::new(session.into()),
            greeting: false,
            nonce,
            greeted_us: None,
            requests: Requests::default(),
            homing: Homing::Unknown,
            enabled: false,
            latched: None,
            untold: false,
            counter: Counter::default(),
            rise: Rise::default(),
            rendering: false,
            lost: false,
        })
    }
}

/// Waits for the answer to one Hello: session and device, once they are sound. What comes before it is thrown away.
fn acknowledged(
    port: &mut dyn SerialPort,
    reader: &mut FrameReader<DeviceMessage>,
    wanted: u32,
) -> Result<Option<(u32, DeviceInfo)>, LinkError> {
    let mut chunk = [0; 256];
    for _ in 0..MOST_READS {
        let count = match port.read(&mut chunk) {
            Ok(0) => return Ok(None),
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::TimedOut => return Ok(None),
            Err(error) => return Err(DeviceError::from(error).into()),
        };
        let mut bytes = &chunk[..count];
        while let Some(outcome) = reader.read(&mut bytes) {
            let Ok(DeviceMessage::HelloAck { version, nonce, session, info }) = outcome else { continue };
            if nonce != wanted {
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
