//! A WebSocket whose reads wait only as long as the cycle permits.

use super::service::{Address, TIMEOUT};
use crate::sys;
use core::fmt;
use core::time::Duration;
use std::io::{self, ErrorKind};
use std::net::{Shutdown, TcpStream};
use std::os::fd::AsFd;
use std::time::Instant;
use tungstenite::{Error, HandshakeError, Message, WebSocket};

/// The connection has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Closed;

/// A connection for texts.
pub(super) trait Line: Send {
    /// Sends a text.
    fn send(&mut self, text: String) -> Result<(), Closed>;

    /// The next text, if one arrives within `wait`.
    fn receive(&mut self, wait: Duration) -> Result<Option<String>, Closed>;

    /// Ends the connection at once.
    fn shut(&mut self);
}

/// A connection to the service.
pub(super) struct Socket(WebSocket<TcpStream>);

impl fmt::Debug for Socket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Socket").field(self.0.get_ref()).finish()
    }
}

impl Socket {
    /// Connects and shakes hands.
    pub(super) fn connect(address: &Address) -> io::Result<Self> {
        let stream = address.connect()?;
        let (socket, _) =
            tungstenite::client(format!("ws://{address}/"), stream).map_err(|error| match error {
                // The stream blocks, and its timeout has passed.
                HandshakeError::Interrupted(_) => io::Error::from(ErrorKind::TimedOut),
                HandshakeError::Failure(error) => io::Error::other(error),
            })?;
        socket.get_ref().set_nonblocking(true)?;
        Ok(Self(socket))
    }

    /// The first text of a service that sends one unasked.
    pub(super) fn first(&mut self) -> Option<String> {
        self.receive(TIMEOUT).ok().flatten()
    }
}

fn would_block(error: &Error) -> bool {
    matches!(error, Error::Io(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted))
}

impl Line for Socket {
    fn send(&mut self, text: String) -> Result<(), Closed> {
        match self.0.send(Message::text(text)) {
            Ok(()) => Ok(()),
            // It stays in the buffer, and the next call writes it.
            Err(error) if would_block(&error) => Ok(()),
            Err(_) => Err(Closed),
        }
    }

    fn receive(&mut self, wait: Duration) -> Result<Option<String>, Closed> {
        let give_up = Instant::now() + wait;
        loop {
            match self.0.read() {
                Ok(Message::Text(text)) => return Ok(Some(text.as_str().to_owned())),
                // Pings are answered by the library. However many there are, the wait has its end.
                Ok(_) if Instant::now() >= give_up => return Ok(None),
                Ok(_) => {}
                Err(error) if would_block(&error) => {
                    let left = give_up.saturating_duration_since(Instant::now());
                    // The reading before has found nothing, so without a wait there is no second one.
                    if left.is_zero() || !sys::wait_readable(self.0.get_ref().as_fd(), left) {
                        return Ok(None);
                    }
                }
                Err(_) => return Err(Closed),
            }
        }
    }

    fn shut(&mut self) {
        let _ = self.0.get_ref().shutdown(Shutdown::Both);
    }
}
