//! The proxy's process: how a session starts it, and what it does.
//!
//! The session sends what to open, with the page and a descriptor of its own process; the proxy opens the device and answers
//! with what it is, or with the line for the user. Both are the same program.

use super::child::Process;
use super::driven::{Driven, Opened, lower};
use super::exchange::Exchange;
use super::force_dimension::{Dhd, Exchanging, Family, ForceDimension, OpenError};
use super::haply::{Address, Haply};
use super::page::Page;
use super::proxied::{Clock, Proxied};
use super::touch::{Hd, Touch};
use crate::device::DeviceInfo;
use crate::device::profile::Profile;
use crate::sys::{self, Ended};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use serde::{Deserialize, Serialize};
use std::ffi::CString;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::sync::Arc;
use std::time::Duration;

/// Longest wait for the device to be opened: an arm may move through its workspace meanwhile.
const OPEN_TIMEOUT: Duration = Duration::from_secs(60);
/// Wait of the proxy for the session's message.
const SETUP_TIMEOUT: Duration = Duration::from_secs(5);
/// Time between two looks at the device's errors.
const LOOK: Duration = Duration::from_millis(50);
/// Longest time in which a device is closed.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);
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
    /// An omega, delta, sigma, lambda or Falcon through libdhd.
    ForceDimension {
        /// The family.
        family: Family,
        /// The user consents to a motion of the arm by itself.
        may_move: bool,
        /// The library's file; `None` for the installed one.
        library: Option<PathBuf>,
    },
    /// An Inverse3 of Haply through its service.
    Haply {
        /// HOST:PORT of the service; `None` for the one of this machine.
        address: Option<String>,
    },
}

/// What to open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Setup {
    maker: Maker,
    max_force_n: f32,
    /// Real-time priority of the proxy's own threads.
    fifo_priority: Option<i32>,
}

/// Why a device cannot be opened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Refusal {
    /// The line for the user: why, and the fix.
    line: String,
    /// The user's consent to a motion of the arm would open it.
    moves_arm: bool,
}

impl<E: fmt::Display> From<E> for Refusal {
    fn from(error: E) -> Self {
        Self { line: error.to_string(), moves_arm: false }
    }
}

/// The proxy's answer.
type Answer = Result<Opened, Refusal>;

/// The proxy's end of the exchange, from the largest force that the device states, N.
pub type ProxyPart = Box<dyn FnOnce(f32) -> Exchange + Send>;

/// Why a device behind a proxy cannot be used.
#[derive(Debug)]
pub enum StartError {
    /// The device cannot be opened; the line says why, and the fix.
    Refused(String),
    /// It finds its position by a motion of its arm; the line says so.
    MovesArm(String),
    /// The proxy cannot be started.
    Proxy(io::Error),
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(line) | Self::MovesArm(line) => f.write_str(line),
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
///
/// `fifo_priority` is the real-time priority of its own threads.
pub fn start(
    command: Command,
    maker: Maker,
    profile: &Profile,
    fifo_priority: Option<i32>,
) -> Result<Proxied, StartError> {
    let (ours, child) = sys::start_beside(command, "haptic-device")?;
    let ended = sys::pidfd(child.id())?;
    let setup = Setup { maker, max_force_n: profile.max_force_n, fifo_priority };
    at(ours, (Some(child), ended), &setup, profile)
}

/// As [`start`], with a proxy that already waits at the other end of `socket`.
fn at(
    mut socket: UnixStream,
    (child, ended): (Option<Child>, OwnedFd),
    setup: &Setup,
    profile: &Profile,
) -> Result<Proxied, StartError> {
    let (page, fd) = Page::shared()?;
    let setup = postcard::to_allocvec(setup).map_err(|_| io::Error::from(ErrorKind::InvalidInput))?;
    let session = sys::pidfd(std::process::id())?;
    sys::send_fds(&socket, &setup, &[fd.as_fd(), session.as_fd()])?;
    socket.set_read_timeout(Some(OPEN_TIMEOUT))?;
    let mut bytes = vec![0; MAX_LEN];
    let count = socket.read(&mut bytes)?;
    let answer: Answer =
        postcard::from_bytes(&bytes[..count]).map_err(|_| io::Error::from(ErrorKind::UnexpectedEof))?;
    let refused = |Refusal { line, moves_arm }| {
        if moves_arm { StartError::MovesArm(line) } else { StartError::Refused(line) }
    };
    let opened = answer.map_err(refused)?;
    let process = Process { socket, child, ended: Ended::watch(ended, "palpate-device")? };
    let info = info(opened, profile);
    Ok(Proxied::new(page.session(), profile.workspace, info, Box::new(sys::monotonic_ns), Some(process)))
}

/// Both ends of a device in one process, on a clock of the caller's: for emulators.
pub fn beside(profile: &Profile, clock: Clock) -> (ProxyPart, impl FnOnce(Opened) -> Proxied) {
    let page = Page::local();
    let (proxy, session) = (page.clone().proxy(), page.session());
    let (limit_n, profile) = (profile.max_force_n, profile.clone());
    let part = move |stated_n: f32| Exchange::new(proxy, lower(stated_n, limit_n));
    (Box::new(part), move |opened: Opened| {
        Proxied::new(session, profile.workspace, info(opened, &profile), clock, None)
    })
}

/// The device in the loop: the lower of its own limits and those of the profile.
fn info(opened: Opened, profile: &Profile) -> DeviceInfo {
    let cap_n_m = lower(opened.max_stiffness_n_m, profile.cap().n_m);
    DeviceInfo {
        name: opened.name,
        self_arming: false,
        max_force_n: lower(opened.max_force_n, profile.max_force_n),
        max_stiffness_n_m: cap_n_m / profile.workspace.scale,
        resolution_m: profile.mechanism.encoder_quantum_m.unwrap_or(0.0) * profile.workspace.scale,
    }
}

/// Holds the device of the session whose socket is this process's standard input, until that ends.
///
/// An error means that no session has started this process.
pub fn serve_stdin() -> io::Result<()> {
    serve(sys::outlive_signals(c"haptic-device")?, || {
        // A library that hangs must not keep the device from the next session.
        std::thread::spawn(|| {
            std::thread::sleep(CLOSE_TIMEOUT);
            std::process::exit(1);
        });
    })
}

/// As [`serve_stdin`], on a socket. `ending` is called before the device is closed.
fn serve(mut socket: UnixStream, ending: impl FnOnce()) -> io::Result<()> {
    socket.set_read_timeout(Some(SETUP_TIMEOUT))?;
    let mut bytes = vec![0; MAX_LEN];
    let (count, fds) = sys::receive_fds(&socket, &mut bytes)?;
    let [page, session] = <[OwnedFd; 2]>::try_from(fds).map_err(|_| ErrorKind::InvalidData)?;
    let setup: Setup = postcard::from_bytes(&bytes[..count]).map_err(|_| ErrorKind::InvalidData)?;
    let has_opened = watch_opening(&session)?;
    let opened = open(&setup, Page::map(&page)?);
    has_opened.store(true, Ordering::Release);
    let answer: Answer = opened.as_ref().map(|device| device.opened().clone()).map_err(Clone::clone);
    let answer = postcard::to_allocvec(&answer).map_err(|_| ErrorKind::InvalidData)?;
    socket.write_all(&answer)?;
    let Ok(mut device) = opened else { return Ok(()) };
    loop {
        let has_ended = sys::wait_any([session.as_fd(), socket.as_fd()], LOOK);
        // A session that ends because the device is lost has its last line here.
        while let Some(line) = device.news() {
            eprintln!("palpate: {line}");
        }
        if has_ended {
            ending();
            return Ok(());
        }
    }
}

/// While a device is opened, its arm may move by itself: the process ends with its session, and the firmware stops the arm.
fn watch_opening(session: &OwnedFd) -> io::Result<Arc<AtomicBool>> {
    let (session, has_opened) = (session.try_clone()?, Arc::new(AtomicBool::new(false)));
    let is_over = has_opened.clone();
    std::thread::spawn(move || {
        while !is_over.load(Ordering::Acquire) {
            if sys::wait_any([session.as_fd(), session.as_fd()], LOOK) && !is_over.load(Ordering::Acquire) {
                std::process::exit(1);
            }
        }
    });
    Ok(has_opened)
}

/// Opens the device.
fn open(setup: &Setup, page: Page) -> Result<Box<dyn Driven>, Refusal> {
    let exchange = |stated_n: f32| Exchange::new(page.proxy(), lower(stated_n, setup.max_force_n));
    match &setup.maker {
        Maker::Touch { library } => {
            let (hd, _) = Hd::load(library.as_deref())?;
            let no_name: Option<CString> = None;
            Ok(Box::new(Touch::start(hd, no_name, exchange, Box::new(sys::monotonic_ns))?))
        }
        Maker::ForceDimension { family, may_move, library } => {
            let (dhd, _) = Dhd::load(library.as_deref())?;
            let clock = Box::new(sys::monotonic_ns);
            let with = (*family, *may_move);
            let opened = Exchanging::open(dhd, with, setup.max_force_n, exchange, clock);
            let opened = opened.map_err(|error| Refusal {
                line: error.to_string(),
                moves_arm: matches!(error, OpenError::MovesArm(_)),
            })?;
            Ok(Box::new(ForceDimension::start(opened, setup.fifo_priority)?))
        }
        Maker::Haply { address } => {
            let haply =
                address.as_deref().map_or(Ok(Address::default()), str::parse).and_then(|address: Address| {
                    Haply::start(&address, exchange, Box::new(sys::monotonic_ns), setup.fifo_priority)
                });
            Ok(Box::new(haply.map_err(Refusal::from)?))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Through the socket, as the process does: without the library there is one line with the fix.
    #[test]
    fn a_missing_library_is_the_answer() {
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        let proxy = std::thread::spawn(move || serve(theirs, || ()));
        let ended = OwnedFd::from(ours.try_clone().expect("a descriptor"));
        let library = Some("/nowhere/libHD.so".into());
        let profile = Profile::bundled("touch").expect("bundled");
        let setup = Setup { maker: Maker::Touch { library }, max_force_n: 3.0, fifo_priority: None };
        let refused = at(ours, (None, ended), &setup, &profile).expect_err("no library");
        let line = refused.to_string();
        assert!(line.contains("OpenHaptics (libHD) is not there (/nowhere/libHD.so"), "{line}");
        proxy.join().expect("no panic").expect("it has answered");
    }
}
