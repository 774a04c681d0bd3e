//! Messages over the socket between a session and its solver: progress and the organ before the first tick,
//! lines of text afterwards. Both processes are the same program.
//!
//! A message is its length (u32, little-endian), then its postcard encoding. Descriptors come with the bytes of
//! their message.

use crate::sys;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::time::Duration;

/// A message of the solver.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum FromSolver {
    /// A line about what the solver does.
    Line(String),
    /// The scene cannot be touched: one line.
    Refused(String),
    /// The organ is ready. With it come the shared memory and a file that holds the blob.
    Ready {
        /// Vertices of the surface.
        vertices: u32,
        /// Bytes of the blob.
        blob_len: u64,
    },
}

/// A message of the session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum FromSession {
    /// A request in words, which the command defines.
    Line(String),
}

/// Longest message, bytes: a damaged length must not cause a huge allocation.
const MAX_LEN: usize = 1 << 16;
/// Longest text of a line, bytes: a message of this length is sent as a whole or not at all.
const MAX_TEXT: usize = 4_096;

/// A text that fits a message.
pub(super) fn short(text: &str) -> String {
    let end = (0..=text.len().min(MAX_TEXT)).rev().find(|end| text.is_char_boundary(*end));
    text[..end.unwrap_or(0)].into()
}

/// The bytes of a message.
fn encode(message: &impl Serialize) -> io::Result<Vec<u8>> {
    let body = postcard::to_allocvec(message).map_err(io::Error::other)?;
    Ok([&(body.len() as u32).to_le_bytes()[..], &body].concat())
}

/// Sends a message if the other end has read enough of those before it; whether it has.
pub(super) fn send_now(socket: &UnixStream, message: &impl Serialize) -> io::Result<bool> {
    sys::send_now(socket, &encode(message)?)
}

/// Sends a message with its descriptors.
pub(super) fn send(socket: &UnixStream, message: &impl Serialize, fds: &[BorrowedFd<'_>]) -> io::Result<()> {
    let bytes = encode(message)?;
    let sent = sys::send_fds(socket, &bytes, fds)?;
    io::Write::write_all(&mut &*socket, &bytes[sent..])
}

/// Messages as they arrive.
#[derive(Debug)]
pub(super) struct Inbox {
    socket: UnixStream,
    bytes: Vec<u8>,
    fds: VecDeque<OwnedFd>,
}

impl Inbox {
    pub(super) const fn new(socket: UnixStream) -> Self {
        Self { socket, bytes: Vec::new(), fds: VecDeque::new() }
    }

    pub(super) const fn socket(&self) -> &UnixStream {
        &self.socket
    }

    /// The next message, if one arrives within `timeout`.
    ///
    /// # Errors
    ///
    /// [`ErrorKind::UnexpectedEof`] if the other end is closed; [`ErrorKind::InvalidData`] for other bytes.
    pub(super) fn next<T: for<'de> Deserialize<'de>>(&mut self, timeout: Duration) -> io::Result<Option<T>> {
        loop {
            if let Some(message) = self.decode()? {
                return Ok(Some(message));
            }
            if !sys::wait_readable(self.socket.as_fd(), timeout) {
                return Ok(None);
            }
            let mut part = [0; 4_096];
            match sys::receive_fds(&self.socket, &mut part) {
                Ok((0, _)) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok((count, fds)) => {
                    self.bytes.extend_from_slice(&part[..count]);
                    self.fds.extend(fds);
                }
                Err(error) if error.kind() == ErrorKind::ConnectionReset => {
                    return Err(ErrorKind::UnexpectedEof.into());
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Takes the descriptors that have come so far, in their order.
    pub(super) fn take_fds<const COUNT: usize>(&mut self) -> Option<[OwnedFd; COUNT]> {
        let fds: Vec<OwnedFd> = self.fds.drain(..COUNT.min(self.fds.len())).collect();
        fds.try_into().ok()
    }

    fn decode<T: for<'de> Deserialize<'de>>(&mut self) -> io::Result<Option<T>> {
        let Some((len, body)) = self.bytes.split_first_chunk::<4>() else { return Ok(None) };
        let len = u32::from_le_bytes(*len) as usize;
        if len > MAX_LEN {
            return Err(ErrorKind::InvalidData.into());
        }
        let Some(body) = body.get(..len) else { return Ok(None) };
        let message = postcard::from_bytes(body).map_err(|_| ErrorKind::InvalidData)?;
        self.bytes.drain(..4 + len);
        Ok(Some(message))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOON: Duration = Duration::from_secs(20);

    #[test]
    fn messages_arrive_in_order_however_they_are_cut() {
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        let mut inbox = Inbox::new(theirs);
        assert_eq!(inbox.next::<FromSolver>(Duration::ZERO).expect("open"), None);
        let messages = [
            FromSolver::Line("mesh".into()),
            FromSolver::Ready { vertices: 7, blob_len: 1 << 40 },
            FromSolver::Line(short(&"é".repeat(MAX_LEN))),
        ];
        let sender = std::thread::spawn({
            let messages = messages.clone();
            move || {
                send(&ours, &messages[0], &[]).expect("room");
                send(&ours, &messages[1], &[ours.as_fd(), ours.as_fd()]).expect("room");
                send(&ours, &messages[2], &[]).expect("room");
            }
        });
        for message in &messages {
            assert_eq!(inbox.next(SOON).expect("valid").as_ref(), Some(message));
        }
        assert!(inbox.take_fds::<2>().is_some() && inbox.take_fds::<1>().is_none());
        sender.join().expect("no panic");
        let closed = inbox.next::<FromSolver>(SOON).expect_err("closed");
        assert_eq!(closed.kind(), ErrorKind::UnexpectedEof);
    }

    /// Nobody reads: the sender does not wait, and what it could send is whole.
    #[test]
    fn a_line_that_finds_no_room_is_not_sent() {
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        let line = FromSolver::Line(short(&"x".repeat(MAX_LEN)));
        let sent = (0..10_000).take_while(|_| send_now(&ours, &line).expect("open")).count();
        assert!((4..10_000).contains(&sent), "{sent}");
        let mut inbox = Inbox::new(theirs);
        for _ in 0..sent {
            assert_eq!(inbox.next(SOON).expect("whole"), Some(line.clone()));
        }
        assert!(inbox.next::<FromSolver>(Duration::ZERO).expect("open").is_none());
        assert!(send_now(&ours, &line).expect("open"));
        drop(inbox);
        assert!(send_now(&ours, &line).is_err(), "closed");
    }

    #[test]
    fn other_bytes_are_refused() {
        for bytes in [&b"solid text"[..], &[1, 0, 0, 0, 99]] {
            let (mut ours, theirs) = UnixStream::pair().expect("sockets");
            io::Write::write_all(&mut ours, bytes).expect("room");
            let refused = Inbox::new(theirs).next::<FromSolver>(SOON).expect_err("nonsense");
            assert_eq!(refused.kind(), ErrorKind::InvalidData);
        }
    }
}
