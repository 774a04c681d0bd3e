//! Why a Haply device cannot be used, each in one line with the fix.

use super::protocol::Obstacle;
use core::fmt;
use std::io;

/// Why no device can be opened.
#[derive(Debug)]
pub enum HaplyError {
    /// The text is not HOST:PORT.
    Address(String),
    /// Nothing listens at the address.
    NoService {
        /// HOST:PORT.
        address: String,
        /// The system's error.
        error: io::Error,
    },
    /// What listens there does not answer as the service does.
    NotTheService {
        /// HOST:PORT.
        address: String,
        /// What is wrong with the answer.
        why: String,
    },
    /// A version whose protocol is another one.
    OldVersion(String),
    /// The service has no Inverse3.
    NoDevice,
    /// The device cannot render a force now.
    NotReady {
        /// Its name.
        device: String,
        /// What is missing.
        obstacle: Obstacle,
    },
    /// The thread of the exchanges cannot be started.
    Thread(io::Error),
}

impl fmt::Display for HaplyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(text) => write!(f, "`{text}` is no address of a service; give haply:HOST:PORT"),
            Self::NoService { address, error } => write!(
                f,
                "no Haply Inverse Service at {address} ({error}); start it (systemctl start haply-inverse-service)"
            ),
            Self::NotTheService { address, why } => write!(
                f,
                "no Haply Inverse Service answers at {address} ({why}); give its address as haply:HOST:PORT, or restart it"
            ),
            Self::OldVersion(version) => {
                write!(f, "the Haply Inverse Service {version} is too old; install 3.0 or newer")
            }
            Self::NoDevice => {
                f.write_str("the Haply Inverse Service has no Inverse3; check cable and power of the device")
            }
            Self::NotReady { device, obstacle } => write!(f, "{device} {obstacle}"),
            Self::Thread(error) => {
                write!(f, "the thread for the device cannot be started ({error}); free some memory")
            }
        }
    }
}

impl core::error::Error for HaplyError {}
