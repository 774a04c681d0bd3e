//! The proxy's process: how a session starts it, and what it does.
//!
//! The session sends what to open, with the page and a descriptor of its own process; the proxy opens the device and answers
//! with what it is, or with the line for the user. Both are the same program.

use super::child::Process;
use super::exchange::Exchange;
use super::page::Page;
use super::proxied::Proxied;
use super::touch::{Hd, Touch};
use crate::device::DeviceInfo;
use crate::device::profile::Profile;
use crate::sys::{self, Ended};
use core::fmt;
use serde::{Deserialize, Serialize};
use std::ffi::CString;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::time::Duration;

/// Longest wait for the device to be opened.
const OPEN_TIMEOUT: Duration = Duration::from_secs(20);
/// Wait of the proxy for the session's message.
const SETUP_TIMEOUT: Duration = Duration::from_secs(5);
/// Time between two looks at the device's errors.
const LOOK: Duration = Duration::from_millis(50);
/// Longest message.
const MAX_LEN: usize = 4_096;

/// A maker's device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Maker {
    /// A Touch or Phantom through OpenHaptics.
    Touch {
        /// The library's file; `None` for the installed one.
        library: Option<PathBuf>,
    },
}

/// What to open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Setup {
    maker: Maker,
    max_force_n: f32,
}

/// What the device is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Opened {
    name: String,
    max_force_n: f32,
    max_stiffness_n_m: f32,
}

/// The proxy's answer: the device, or the line for the user.
type Answer = Result<Opened, String>;

/// Why a device behind a proxy cannot be used.
#[derive(Debug)]
pub enum StartError {
    /// The device cannot be opened; the line says why, and the fix.
    Refused(String),
    /// The proxy cannot be started.
    Proxy(io::Error),
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(line) => f.write_str(line),
            Self::Proxy(error) => write!(f, "the process for the device cannot be started ({error})"),
        }
    }
}

impl core::error::Error for StartError {}

impl From<io::Error> for StartError {
    fn from(error: io::Error) -> Self {
        Self::Proxy(error)
    }
}

/// Starts `command` as the proxy of a device, and waits until that is open.
pub fn start(command: Command, maker: Maker, profile: &Profile) -> Result<Proxied, StartError> {
    let (ours, child) = sys::start_beside(command, "haptic-device")?;
    let ended = sys::pidfd(child.id())?;
    at(ours, (Some(child), ended), maker, profile)
}

/// As [`start`], with a proxy that already waits at the other end of `socket`.
fn at(
    mut socket: UnixStream,
    (child, ended): (Option<Child>, OwnedFd),
    maker: Maker,
    profile: &Profile,
) -> Result<Proxied, StartError> {
    let (page, fd) = Page::shared()?;
    let setup = Setup { maker, max_force_n: profile.max_force_n };
    let setup = postcard::to_allocvec(&setup).map_err(|_| io::Error::from(ErrorKind::InvalidInput))?;
    let session = sys::pidfd(std::process::id())?;
    sys::send_fds(&socket, &setup, &[fd.as_fd(), session.as_fd()])?;
    socket.set_read_timeout(Some(OPEN_TIMEOUT))?;
    let mut bytes = vec![0; MAX_LEN];
    let count = socket.read(&mut bytes)?;
    let answer: Answer =
        postcard::from_bytes(&bytes[..count]).map_err(|_| io::Error::from(ErrorKind::UnexpectedEof))?;
    let opened = answer.map_err(StartError::Refused)?;
    let cap_n_m = lower(opened.max_stiffness_n_m, profile.cap().n_m);
    let info = DeviceInfo {
        name: opened.name,
        self_arming: false,
        max_force_n: opened.max_force_n,
        max_stiffness_n_m: cap_n_m / profile.workspace.scale,
        resolution_m: profile.mechanism.encoder_quantum_m.unwrap_or(0.0) * profile.workspace.scale,
    };
    let process = Process { socket, child, ended: Ended::watch(ended, "palpate-device")? };
    Ok(Proxied::new(page.session(), profile.workspace, info, Box::new(sys::monotonic_ns), Some(process)))
}

/// Holds the device of the session whose socket is this process's standard input, until that ends.
///
/// An error means that no session has started this process.
pub fn serve_stdin() -> io::Result<()> {
    serve(sys::outlive_signals(c"haptic-device")?)
}

/// As [`serve_stdin`], on a socket.
fn serve(mut socket: UnixStream) -> io::Result<()> {
    socket.set_read_timeout(Some(SETUP_TIMEOUT))?;
    let mut bytes = vec![0; MAX_LEN];
    let (count, fds) = sys::receive_fds(&socket, &mut bytes)?;
    let [page, session] = <[OwnedFd; 2]>::try_from(fds).map_err(|_| ErrorKind::InvalidData)?;
    let setup: Setup = postcard::from_bytes(&bytes[..count]).map_err(|_| ErrorKind::InvalidData)?;
    let opened = open(&setup, Page::map(&page)?);
    let answer: Answer = match &opened {
        Ok(touch) => {
            let info = touch.info();
            let max_force_n = lower(info.max_force_n, setup.max_force_n);
            Ok(Opened { name: info.name.clone(), max_force_n, max_stiffness_n_m: info.max_stiffness_n_m })
        }
        Err(line) => Err(line.clone()),
    };
    let answer = postcard::to_allocvec(&answer).map_err(|_| ErrorKind::InvalidData)?;
    socket.write_all(&answer)?;
    let Ok(touch) = opened else { return Ok(()) };
    let mut told_hand = false;
    while !sys::wait_any([session.as_fd(), socket.as_fd()], LOOK) {
        if let Some(code) = touch.seen().take_error() {
            eprintln!("palpate: {}: {} ({code:#x})", touch.info().name, touch.error_text(code));
        }
        if touch.seen().needs_hand() && !told_hand {
            eprintln!("palpate: put the stylus of {} into its inkwell to calibrate it", touch.info().name);
        }
        told_hand = touch.seen().needs_hand();
    }
    Ok(())
}

/// The lower of a limit that the device states, if it states one, and that of the profile.
fn lower(stated: f32, profile: f32) -> f32 {
    if stated > 0.0 { stated.min(profile) } else { profile }
}

/// Opens the device; an error is the line for the user.
fn open(setup: &Setup, page: Page) -> Result<Touch, String> {
    let Maker::Touch { library } = &setup.maker;
    let (hd, _) = Hd::load(library.as_deref()).map_err(|error| error.to_string())?;
    let exchange = |max_force_n: f32| Exchange::new(page.proxy(), lower(max_force_n, setup.max_force_n));
    let no_name: Option<CString> = None;
    Touch::start(hd, no_name, |info| exchange(info.max_force_n), Box::new(sys::monotonic_ns))
        .map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Through the socket, as the process does: without the library there is one line with the fix.
    #[test]
    fn a_missing_library_is_the_answer() {
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        let proxy = std::thread::spawn(move || serve(theirs));
        let ended = OwnedFd::from(ours.try_clone().expect("a descriptor"));
        let library = Some("/nowhere/libHD.so".into());
        let profile = Profile::bundled("touch").expect("bundled");
        let refused = at(ours, (None, ended), Maker::Touch { library }, &profile).expect_err("no library");
        let line = refused.to_string();
        assert!(line.contains("OpenHaptics (libHD) is not there (/nowhere/libHD.so"), "{line}");
        proxy.join().expect("no panic").expect("it has answered");
    }
}
