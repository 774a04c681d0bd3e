//! Functions shared by the serial drivers: conversion of errors, and the latency timer of an adapter.

use super::nonblocking_port::{NonBlockingPort, Port};
use super::{DeviceError, DeviceErrorKind};
use core::fmt;
use serialport::SerialPort;
use std::io;
use std::path::Path;

/// Converts an error of the crate.
pub(super) fn from_serial(error: serialport::Error) -> DeviceError {
    match error.kind() {
        serialport::ErrorKind::NoDevice => DeviceError::new(DeviceErrorKind::Disconnected),
        serialport::ErrorKind::InvalidInput => DeviceError::new(DeviceErrorKind::Unsupported),
        serialport::ErrorKind::Unknown => DeviceError::new(DeviceErrorKind::Io),
        serialport::ErrorKind::Io(kind) => DeviceError::from(io::Error::from(kind)),
    }
}

/// Opens a port with non-blocking writes.
pub(super) fn open(path: &str, baud: u32) -> Result<Box<dyn Port>, DeviceError> {
    match NonBlockingPort::open(serialport::new(path, baud)) {
        Ok(port) => Ok(Box::new(port)),
        // The crate reports a locked port as one that is not there.
        Err(error) if error.kind() == serialport::ErrorKind::NoDevice && Path::new(path).exists() => {
            Err(DeviceError::new(DeviceErrorKind::InUse))
        }
        Err(error) => Err(from_serial(error)),
    }
}

/// Reads of a port per exchange: a device that sends continuously must not delay the tick.
pub(super) const MAX_READS: usize = 4;

/// Reads the bytes that have arrived, up to the size of `chunk`, without waiting; 0 if there are none.
pub(super) fn read_waiting(port: &mut dyn SerialPort, chunk: &mut [u8]) -> Result<usize, DeviceError> {
    if port.bytes_to_read().map_err(from_serial)? == 0 {
        return Ok(0);
    }
    match port.read(chunk) {
        Err(error) if error.kind() == io::ErrorKind::TimedOut => Ok(0),
        read => Ok(read?),
    }
}

/// Shortest latency timer of an FTDI adapter, ms. The default is 16.
const MIN_LATENCY_MS: u32 = 1;

/// Result of requesting an adapter's low-latency mode.
#[derive(Debug, PartialEq, Eq)]
pub enum LatencyTimer {
    /// The timer is set to the shortest value.
    Granted {
        /// The value before, ms.
        before_ms: u32,
    },
    /// The timer could not be changed.
    Refused {
        /// Its value, ms.
        ms: u32,
        /// Reason.
        why: io::ErrorKind,
    },
}

impl LatencyTimer {
    /// Requests the shortest latency timer of the adapter behind a port. Linux `ftdi_sio` exposes it as
    /// `latency_timer` of /dev/ttyUSBn. `None` for any other port.
    pub fn shorten(port: &str) -> Option<Self> {
        Self::shorten_in(Path::new("/sys/class/tty"), port)
    }

    /// The same with another class folder than /sys/class/tty.
    fn shorten_in(class: &Path, port: &str) -> Option<Self> {
        // A udev symbolic link leads to the name that the kernel uses.
        let port = std::fs::canonicalize(port).unwrap_or_else(|_| port.into());
        let name = port.file_name()?.to_str().filter(|name| name.starts_with("ttyUSB"))?;
        let file = class.join(name).join("device/latency_timer");
        let ms = std::fs::read_to_string(&file).ok()?.trim().parse().ok()?;
        if ms <= MIN_LATENCY_MS {
            return Some(Self::Granted { before_ms: ms });
        }
        Some(match std::fs::write(&file, MIN_LATENCY_MS.to_string()) {
            Ok(()) => Self::Granted { before_ms: ms },
            Err(error) => Self::Refused { ms, why: error.kind() },
        })
    }
}

impl fmt::Display for LatencyTimer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Granted { before_ms } if *before_ms <= MIN_LATENCY_MS => {
                write!(f, "latency timer of the adapter: {before_ms} ms")
            }
            Self::Granted { before_ms } => {
                write!(f, "latency timer of the adapter: {MIN_LATENCY_MS} ms, was {before_ms} ms")
            }
            Self::Refused { ms, why } => write!(
                f,
                "latency timer of the adapter: {ms} ms, not changed ({why}): replies are delayed; install host/deploy/70-palpate.rules and reconnect the adapter"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latency_timer_is_set_or_the_reason_is_reported() {
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
