//! The proxy's process as the session holds it.

use crate::sys::{self, Ended};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::process::Child;
use std::time::Duration;

/// Longest wait for the proxy to exit, so that the device can be opened again.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);

/// The proxy, from the session's side. It ends with this.
#[derive(Debug)]
pub(super) struct Process {
    pub(super) socket: UnixStream,
    /// `None` of a proxy on a thread.
    pub(super) child: Option<Child>,
    pub(super) ended: Ended,
}

impl Process {
    /// Whether it has ended. Wait-free.
    pub(super) fn has_ended(&self) -> bool {
        self.ended.has_ended()
    }
}

impl Drop for Process {
    /// Lets the proxy send its last zero and close the device.
    fn drop(&mut self) {
        let _ = self.socket.shutdown(Shutdown::Both);
        if let Some(child) = &mut self.child {
            sys::wait_exit(child, EXIT_TIMEOUT);
        }
    }
}
