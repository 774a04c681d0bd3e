//! What the drivers on a serial line share: errors of the port, and the latency timer of an adapter.

use super::{DeviceError, DeviceErrorKind};
use core::fmt;
use serialport::SerialPort;
use std::io;
use std::path::Path;

/// The crate's error as one of ours.
pub(super) fn from_serial(error: serialport::Error) -> DeviceError {
    match error.kind() {
        serialport::ErrorKind::NoDevice => DeviceError::new(DeviceErrorKind::Disconnected),
        serialport::ErrorKind::InvalidInput => DeviceError::new(DeviceErrorKind::Unsupported),
        serialport::ErrorKind::Unknown => DeviceError::new(DeviceErrorKind::Io),
        serialport::ErrorKind::Io(kind) => DeviceError::from(io::Error::from(kind)),
    }
}

/// Opens a port whose writes do not wait, where the system has such.
pub(super) fn open(builder: serialport::SerialPortBuilder) -> Result<Box<dyn SerialPort>, DeviceError> {
    #[cfg(unix)]
    let port = super::prompt::PromptPort::open(builder).map(|port| Box::new(port) as Box<dyn SerialPort>);
    #[cfg(not(unix))]
    let port = builder.open();
    port.map_err(from_serial)
}

/// Reads in one look at a port: a babbling device must not hold the tick.
pub(super) const MOST_READS: usize = 4;

/// What has come, as far as there is room for it, without waiting for more; 0 if nothing has.
pub(super) fn read_waiting(port: &mut dyn SerialPort, chunk: &mut [u8]) -> Result<usize, DeviceError> {
    if port.bytes_to_read().map_err(from_serial)? == 0 {
        return Ok(0);
    }
    match port.read(chunk) {
        Err(error) if error.kind() == io::ErrorKind::TimedOut => Ok(0),
        read => Ok(read?),
    }
}

/// Shortest time for which an adapter of FTDI holds bytes back, ms; 16 if nobody asks.
const SHORTEST_MS: u32 = 1;

/// What came of asking an adapter for its low-latency mode.
#[derive(Debug, PartialEq, Eq)]
pub enum LatencyTimer {
    /// It has one, set to this, ms.
    Granted {
        /// What it was before.
        before_ms: u32,
    },
    /// It has one that stays as it is.
    Refused {
        /// As it is, ms.
        ms: u32,
        /// Why.
        why: io::ErrorKind,
    },
}

impl LatencyTimer {
    /// Asks for the shortest latency timer of the adapter behind a port, where it has one: `ftdi_sio` of Linux shows it as
    /// `latency_timer` of /dev/ttyUSBn. `None` for any other port.
    pub fn shorten(port: &str) -> Option<Self> {
        Self::shorten_in(Path::new("/sys/class/tty"), port)
    }

    /// The same below another folder than /sys/class/tty.
    fn shorten_in(class: &Path, port: &str) -> Option<Self> {
        // A link that a rule of udev has made leads to the name that the kernel knows.
        let port = std::fs::canonicalize(port).unwrap_or_else(|_| port.into());
        let name = port.file_name()?.to_str().filter(|name| name.starts_with("ttyUSB"))?;
        let file = class.join(name).join("device/latency_timer");
        let ms = std::fs::read_to_string(&file).ok()?.trim().parse().ok()?;
        if ms <= SHORTEST_MS {
            return Some(Self::Granted { before_ms: ms });
        }
        Some(match std::fs::write(&file, SHORTEST_MS.to_string()) {
            Ok(()) => Self::Granted { before_ms: ms },
            Err(error) => Self::Refused { ms, why: error.kind() },
        })
    }
}

impl fmt::Display for LatencyTimer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Granted { before_ms } if *before_ms <= SHORTEST_MS => {
                write!(f, "latency timer of the adapter: {before_ms} ms")
            }
            Self::Granted { before_ms } => {
                write!(f, "latency timer of the adapter: {SHORTEST_MS} ms, was {before_ms} ms")
            }
            Self::Refused { ms, why } => write!(
                f,
                "latency timer of the adapter: {ms} ms, not changed ({why}): answers come late; install host/deploy/70-palpate.rules and connect it again"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latency_timer_is_set_where_there_is_one_and_said_otherwise() {
        let class = tempfile::tempdir().expect("a folder");
        let folder = class.path().join("ttyUSB3/device");
        std::fs::create_dir_all(&folder).expect("a folder");
        let file = folder.join("latency_timer");
        std::fs::write(&file, "16\n").expect("a file");
        let set = LatencyTimer::shorten_in(class.path(), "/dev/ttyUSB3").expect("it has one");
        assert_eq!(
            (&set, std::fs::read_to_string(&file).expect("a file").as_str()),
            (&LatencyTimer::Granted { before_ms: 16 }, "1")
        );
        assert!(set.to_string().ends_with("1 ms, was 16 ms"), "{set}");
        assert_eq!(
            LatencyTimer::shorten_in(class.path(), "/dev/ttyUSB3"),
            Some(LatencyTimer::Granted { before_ms: 1 })
        );
        for other in ["/dev/ttyUSB4", "/dev/ttyACM0", "/dev/pts/3", ""] {
            assert_eq!(LatencyTimer::shorten_in(class.path(), other), None, "{other}");
        }
        let refused = LatencyTimer::Refused { ms: 16, why: io::ErrorKind::PermissionDenied }.to_string();
        assert!(refused.contains("70-palpate.rules") && refused.contains("16 ms"), "{refused}");
    }
}
