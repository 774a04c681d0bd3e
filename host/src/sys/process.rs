//! Watching another process, and handing it descriptors.

use core::sync::atomic::{AtomicBool, Ordering};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::prctl;
use nix::sys::signal::{SigSet, Signal};
use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage,
    SendFlags, recvmsg, send, sendmsg,
};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::ffi::CStr;
use std::io::{self, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Largest number of descriptors in a message.
pub const FDS: usize = 3;

/// A descriptor that becomes readable when the process ends. It cannot come to mean another process, unlike a
/// pid. It does not become readable when the process is stopped.
pub fn pidfd(pid: u32) -> io::Result<OwnedFd> {
    let pid = Pid::from_raw(pid as i32).ok_or(io::ErrorKind::InvalidInput)?;
    Ok(pidfd_open(pid, PidfdFlags::empty())?)
}

/// Starts `command` under another name with one end of a socket pair as its standard input; the other end, and the process.
///
/// It gets its own process group: a Ctrl-C or Ctrl-Z of the terminal reaches the caller only.
pub fn start_beside(mut command: Command, name: &str) -> io::Result<(UnixStream, Child)> {
    let (ours, theirs) = UnixStream::pair()?;
    command.arg0(name).stdin(OwnedFd::from(theirs)).stdout(Stdio::null()).process_group(0);
    // The command holds the other end until it is dropped; only the process may hold it.
    Ok((ours, command.spawn()?))
}

/// The socket on the standard input of a process that [`start_beside`] has started, which from now on ends with its session
/// alone, and under a name of its own: what ends every `palpate` must not end it too.
pub fn outlive_signals(name: &CStr) -> io::Result<UnixStream> {
    // A signal to the session's group ends the session; then this process must zero the force. The kernel hangs
    // up a stopped process that its parent's death orphans (and resumes it).
    SigSet::all().thread_block()?;
    // Where the kernel does not, because a parent of the session adopts this process, the session's death does.
    prctl::set_pdeathsig(Signal::SIGCONT)?;
    prctl::set_name(name)?;
    Ok(UnixStream::from(io::stdin().as_fd().try_clone_to_owned()?))
}

/// Waits for a process to exit, at most this long. One that does not may still be zeroing its device; it is not killed.
pub fn wait_exit(child: &mut Child, longest: Duration) {
    let give_up = Instant::now() + longest;
    while Instant::now() < give_up && matches!(child.try_wait(), Ok(None)) {
        std::thread::sleep(EXIT_CHECK);
    }
}

/// Period of checking for an exit.
const EXIT_CHECK: Duration = Duration::from_millis(1);

/// How often a watching thread checks whether it is still needed.
const WATCH_CHECK: Duration = Duration::from_secs(1);

/// Whether another process has ended. A thread waits for it, so that the answer costs one load.
#[derive(Debug, Clone, Default)]
pub struct Ended(Arc<AtomicBool>);

impl Ended {
    /// Watches a descriptor that becomes readable when the process ends: its [`pidfd`], or a socket on which it
    /// sends nothing. The thread ends with the last clone.
    pub fn watch(fd: OwnedFd, thread: &str) -> io::Result<Self> {
        let ended = Self::default();
        let watched = Arc::downgrade(&ended.0);
        std::thread::Builder::new().name(thread.into()).spawn(move || {
            while let Some(has_ended) = watched.upgrade() {
                if wait_readable(fd.as_fd(), WATCH_CHECK) {
                    has_ended.store(true, Ordering::Release);
                    return;
                }
            }
        })?;
        Ok(ended)
    }

    /// Notes the end that another path has noticed.
    pub fn note(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether it has ended. Wait-free.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// A duplicate of an open descriptor; from now on neither blocks.
pub fn duplicate_non_blocking(owner: &impl AsRawFd) -> io::Result<OwnedFd> {
    // SAFETY: `owner` keeps the descriptor open during the call, which is all that the borrow lasts.
    let fd = unsafe { BorrowedFd::borrow_raw(owner.as_raw_fd()) }.try_clone_to_owned()?;
    let flags = OFlag::from_bits_retain(fcntl(&fd, FcntlArg::F_GETFL)?);
    fcntl(&fd, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK))?;
    Ok(fd)
}

/// Writes to a descriptor once; the number of bytes.
pub fn write(fd: BorrowedFd<'_>, bytes: &[u8]) -> io::Result<usize> {
    Ok(nix::unistd::write(fd, bytes)?)
}

/// Sends bytes and at most [`FDS`] descriptors in one message; the number of bytes that the socket accepted.
pub fn send_fds(socket: &UnixStream, bytes: &[u8], fds: &[BorrowedFd<'_>]) -> io::Result<usize> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(FDS))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    control.push(SendAncillaryMessage::ScmRights(fds));
    Ok(sendmsg(socket, &[IoSlice::new(bytes)], &mut control, SendFlags::empty())?)
}

/// Sends bytes if the socket has room for them now; whether it had. Bytes of a few kilobytes are sent as a whole
/// or not at all.
pub fn send_now(socket: &UnixStream, bytes: &[u8]) -> io::Result<bool> {
    match send(socket, bytes, SendFlags::DONTWAIT | SendFlags::NOSIGNAL) {
        Ok(count) if count == bytes.len() => Ok(true),
        Ok(_) => Err(io::ErrorKind::WriteZero.into()),
        Err(Errno::AGAIN) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Receives what [`send_fds`] has sent: the number of bytes, and the descriptors that came with them.
pub fn receive_fds(socket: &UnixStream, bytes: &mut [u8]) -> io::Result<(usize, Vec<OwnedFd>)> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(FDS))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let received = recvmsg(socket, &mut [IoSliceMut::new(bytes)], &mut control, RecvFlags::CMSG_CLOEXEC)?;
    let fds = control.drain().filter_map(|message| match message {
        RecvAncillaryMessage::ScmRights(fds) => Some(fds),
        _ => None,
    });
    Ok((received.bytes, fds.flatten().collect()))
}

/// Waits until one of the descriptors is readable or closed at its other end, for at most `timeout`; whether
/// any is.
///
/// It uses a high-resolution timer: a read timeout of a socket is rounded up to kernel ticks of 4 ms.
#[must_use]
pub fn wait_any(fds: [BorrowedFd<'_>; 2], timeout: Duration) -> bool {
    let mut fds = fds.map(|fd| PollFd::new(fd, PollFlags::POLLIN));
    // An interruption counts as a timeout: the caller checks and waits again.
    ppoll(&mut fds, Some(timeout.into()), None).is_ok_and(|ready| ready > 0)
}

/// Waits until a descriptor is readable or closed at its other end, for at most `timeout`.
#[must_use]
pub fn wait_readable(fd: BorrowedFd<'_>, timeout: Duration) -> bool {
    let mut fds = [PollFd::new(fd.as_fd(), PollFlags::POLLIN)];
    ppoll(&mut fds, Some(timeout.into()), None).is_ok_and(|ready| ready > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::process::{Command, Stdio};

    #[test]
    fn a_pidfd_becomes_readable_when_its_process_ends() {
        let mut child = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().expect("cat");
        let fd = pidfd(child.id()).expect("Linux 5.3");
        assert!(!wait_readable(fd.as_fd(), Duration::from_millis(20)));
        child.kill().expect("it runs");
        assert!(wait_readable(fd.as_fd(), Duration::from_secs(20)));
        child.wait().expect("it ended");
        assert!(pidfd(0).is_err());
    }

    #[test]
    fn descriptors_arrive_with_their_bytes() {
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        let (mut near, far) = UnixStream::pair().expect("sockets");
        send_fds(&ours, b"setup", &[far.as_fd(), far.as_fd()]).expect("room");
        let mut bytes = [0; 16];
        let (count, mut fds) = receive_fds(&theirs, &mut bytes).expect("they arrive");
        assert_eq!((&bytes[..count], fds.len()), (&b"setup"[..], 2));
        std::io::Write::write_all(&mut UnixStream::from(fds.remove(0)), b"x").expect("the same socket");
        let mut byte = [0];
        near.read_exact(&mut byte).expect("it arrives");
        assert_eq!(&byte, b"x");
    }
}
