//! The processes: a host that renders a force, with a supervisor or without, and the supervisor.

use crate::falcon::socket::SocketFtdi;
use palpate_core::Vec3;
use palpate_host::DeviceErrorKind;
use palpate_host::device::falcon::{Falcon, FalconConfig, Mode};
use palpate_host::device::link::{Link, LinkConfig};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::profile::Profile;
use palpate_host::supervisor::{Supervised, serve_stdin};
use palpate_host::sys::{self, Policy, RtRequest};
use std::io::BufRead;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest time for a reply of the device on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(10);
/// The baud rate has no effect on a pseudo terminal.
const BAUD: u32 = 1_000_000;

/// The emulated device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Device {
    /// A Polhem on a pseudo terminal.
    Polhem,
    /// A Falcon whose chip is at the other end of a socket.
    Falcon,
    /// A controller of the device link on a pseudo terminal.
    Link,
}

impl Device {
    /// All devices.
    pub const ALL: [Self; 3] = [Self::Polhem, Self::Falcon, Self::Link];

    /// Name of device and link in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Polhem => "polhem-pty",
            Self::Falcon => "falcon-socket",
            Self::Link => "link-pty",
        }
    }

    /// Whether it has a supervisor in the product. The device link has its own watchdog instead.
    #[must_use]
    pub const fn is_supervised(self) -> bool {
        !matches!(self, Self::Link)
    }

    /// Its bundled profile.
    ///
    /// # Panics
    ///
    /// Never: they are bundled.
    #[must_use]
    pub fn profile(self) -> Profile {
        let name = match self {
            Self::Polhem => "polhem",
            Self::Falcon => "falcon",
            Self::Link => "link",
        };
        Profile::bundled(name).expect("bundled")
    }

    fn open(self, address: &str) -> Result<Box<dyn palpate_host::Device>, String> {
        match self {
            Self::Polhem => Polhem::open(address, PolhemConfig::default())
                .map(|device| Box::new(device) as _)
                .map_err(|error| error.to_string()),
            Self::Falcon => {
                let chip = SocketFtdi::connect(address).map_err(|error| error.to_string())?;
                let config = FalconConfig { mode: Mode::Polled, ..FalconConfig::default() };
                Falcon::start(Arc::new(chip), config, None)
                    .map(|device| Box::new(device) as _)
                    .map_err(|error| error.to_string())
            }
            Self::Link => {
                let config =
                    LinkConfig::of(&self.profile(), TIMEOUT).ok_or("the profile has no [capstan]")?;
                let mut device = Link::open(address, BAUD, config).map_err(|error| error.to_string())?;
                device.home(&AtomicBool::new(false)).map_err(|error| error.to_string())?;
                Ok(Box::new(device))
            }
        }
    }
}

/// Role of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A host as in the product: with a supervisor where the device needs one.
    Host,
    /// A host that owns the device itself.
    Unsupervised,
    /// A supervisor, started by a host.
    Supervisor,
}

impl Role {
    const fn name(self) -> &'static str {
        match self {
            Self::Host => "host",
            Self::Unsupervised => "unsupervised",
            Self::Supervisor => "supervisor",
        }
    }
}

/// The command that starts `program` in this role.
#[must_use]
pub(super) fn command(
    program: &Path,
    role: Role,
    device: Device,
    address: &str,
    limit_ms: u32,
    force_n: Vec3,
) -> Command {
    let mut command = Command::new(program);
    command.args(["process", role.name(), device.name(), address, &limit_ms.to_string()]);
    command.args(force_n.map(|component| component.to_string()));
    command
}

/// Main function of a process, with the arguments after `process`. The error is one line.
pub fn process(arguments: &[String]) -> Result<(), String> {
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let [role, device, address, limit_ms, force_n @ ..] = &words[..] else {
        return Err("ROLE DEVICE ADDRESS LIMIT_MS FORCE".into());
    };
    let limit_ms = limit_ms.parse().map_err(|_| "LIMIT_MS must be an integer in ms")?;
    let device = Device::ALL.into_iter().find(|known| known.name() == *device).ok_or("unknown DEVICE")?;
    let numbers: Vec<f32> = force_n.iter().filter_map(|word| word.parse().ok()).collect();
    let force_n: Vec3 = numbers.try_into().map_err(|_| "FORCE must have three components")?;
    if *role == Role::Host.name() && device.is_supervised() {
        let program = std::env::current_exe().map_err(|error| error.to_string())?;
        let supervisor = command(&program, Role::Supervisor, device, address, limit_ms, force_n);
        host(supervisor, limit_ms, device == Device::Falcon, force_n)
    } else if [Role::Host.name(), Role::Unsupervised.name()].contains(role) {
        render(device.open(address)?, force_n);
        Ok(())
    } else {
        supervise(|| device.open(address))
    }
}

/// Main function of a host with a supervisor, which `supervisor` starts.
pub fn host(supervisor: Command, limit_ms: u32, homes: bool, force_n: Vec3) -> Result<(), String> {
    let never = AtomicBool::new(false);
    let mut held = Supervised::start(supervisor, limit_ms, &never).map_err(|error| error.to_string())?;
    println!("supervisor {}", held.supervision().pid.unwrap_or_default());
    if homes {
        held.home(&never).map_err(|error| error.to_string())?;
    }
    render(held, force_n);
    Ok(())
}

/// Main function of a supervisor.
pub fn supervise<D: palpate_host::Device>(open: impl FnOnce() -> Result<D, String>) -> Result<(), String> {
    let request = RtRequest { fifo_priority: Some(51), keep_awake: false, ..RtRequest::default() };
    let (_, _held) = sys::enter_real_time(&request);
    serve_stdin(Policy::Other, open).map(drop).map_err(|error| error.to_string())
}

/// Renders the force at 1 kHz until the device is lost. Unless it holds, it resets after a watchdog that
/// fired on a busy machine.
fn render(mut device: impl palpate_host::Device, force_n: Vec3) {
    let (hold, reset) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let words = (Arc::clone(&hold), Arc::clone(&reset));
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            match &line[..] {
                "hold" => words.0.store(true, Ordering::Relaxed),
                "again" => words.0.store(false, Ordering::Relaxed),
                "reset" => words.1.store(true, Ordering::Relaxed),
                _ => {}
            }
        }
    });
    let request = RtRequest { lock_memory: false, keep_awake: false, ..RtRequest::default() };
    let (_, _held) = sys::enter_real_time(&request);
    let start = sys::monotonic_ns();
    let mut holds = false;
    for tick in 0_u64.. {
        sys::sleep_until_ns(start + tick * 1_000_000);
        let now_us = (sys::monotonic_ns() - start) / 1_000;
        match device.exchange(now_us, force_n) {
            Err(error) if !error.kind().is_transient() => {
                println!("end {:?}", error.kind());
                assert_eq!(error.kind(), DeviceErrorKind::Disconnected);
                return;
            }
            Ok(Some(sample)) => assert!(sample.t_us <= now_us),
            _ => {}
        }
        if device.was_zeroed() {
            if holds {
                println!("zeroed");
            } else {
                device.reset();
            }
        }
        let requested = hold.load(Ordering::Relaxed);
        if requested != holds {
            holds = requested;
            println!("{}", if holds { "holds" } else { "again" });
        }
        if reset.swap(false, Ordering::Relaxed) {
            device.reset();
        }
    }
}
