//! The processes: a host that renders a force, with a guard or without, and the guard.

use palpate_core::Vec3;
use palpate_host::DeviceErrorKind;
use palpate_host::device::link::{Link, LinkConfig};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::profile::Profile;
use palpate_host::guard::{GuardOptions, Guarded, Guarding, guard_stdin};
use palpate_host::sys::{self, RtRequest};
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
    /// A controller of the device link on a pseudo terminal.
    Link,
}

impl Device {
    /// All devices.
    pub const ALL: [Self; 2] = [Self::Polhem, Self::Link];

    /// Name of device and link in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Polhem => "polhem-pty",
            Self::Link => "link-pty",
        }
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
            Self::Link => "link",
        };
        Profile::bundled(name).expect("bundled")
    }

    fn open(self, address: &str) -> Result<Box<dyn palpate_host::Device>, String> {
        match self {
            Self::Polhem => Polhem::open(address, PolhemConfig::default())
                .map(|device| Box::new(device) as _)
                .map_err(|error| error.to_string()),
            Self::Link => {
                let config =
                    LinkConfig::of(&self.profile(), TIMEOUT).ok_or("the profile has no [capstan]")?;
                Link::open(address, BAUD, config)
                    .map(|device| Box::new(device) as _)
                    .map_err(|error| error.to_string())
            }
        }
    }
}

/// Role of a host process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A host as in the product, with a guard.
    Host,
    /// A host without a guard.
    Unguarded,
}

impl Role {
    const fn name(self) -> &'static str {
        match self {
            Self::Host => "host",
            Self::Unguarded => "unguarded",
        }
    }
}

/// The word for the guard's process.
const GUARD: &str = "guard";

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
    if words == [GUARD] {
        return guard_stdin().map(drop).map_err(|error| error.to_string());
    }
    let [role, device, address, limit_ms, force_n @ ..] = &words[..] else {
        return Err("guard, or ROLE DEVICE ADDRESS LIMIT_MS FORCE".into());
    };
    let limit_ms = limit_ms.parse().map_err(|_| "LIMIT_MS must be an integer in ms")?;
    let device = Device::ALL.into_iter().find(|known| known.name() == *device).ok_or("unknown DEVICE")?;
    let numbers: Vec<f32> = force_n.iter().filter_map(|word| word.parse().ok()).collect();
    let force_n: Vec3 = numbers.try_into().map_err(|_| "FORCE must have three components")?;
    let device = device.open(address)?;
    if *role == Role::Unguarded.name() {
        return home_and_render(device, force_n);
    }
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut guard = Command::new(program);
    guard.args(["process", GUARD]);
    host(device, guard, limit_ms, force_n)
}

/// Main function of a host with a guard, which `guard` starts.
pub fn host<D: palpate_host::Device>(
    device: D,
    guard: Command,
    limit_ms: u32,
    force_n: Vec3,
) -> Result<(), String> {
    let options = GuardOptions { limit_ms, fifo_priority: Some(51), locks_memory: true };
    match Guarded::start(device, guard, options).map_err(|error| error.to_string())? {
        Guarding::Guarded(guarded) => {
            println!("guard {}", guarded.status().pid.unwrap_or_default());
            home_and_render(*guarded, force_n)
        }
        Guarding::Unneeded(_) => Err("the device offers no path to a guard".into()),
    }
}

fn home_and_render(mut device: impl palpate_host::Device, force_n: Vec3) -> Result<(), String> {
    device.home(&AtomicBool::new(false)).map_err(|error| error.to_string())?;
    render(device, force_n);
    Ok(())
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
                // Dropping the device zeroes it.
                assert!(matches!(error.kind(), DeviceErrorKind::Disconnected | DeviceErrorKind::GuardLost));
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
