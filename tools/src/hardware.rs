//! Real devices: opened in this process, or by a supervisor that this process starts.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use palpate_host::device::falcon::{Falcon, FalconConfig, Image, Mode, UsbFtdi};
use palpate_host::device::link::{Link, LinkConfig};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::profile::Profile;
use palpate_host::device::serial::LatencyTimer;
use palpate_host::supervisor::{self, StartError, Supervised, Supervision};
use palpate_host::{Device, DeviceError};

use crate::failure::Failure;

/// Highest requested priority: 99 belongs to the kernel.
const MAX_PRIORITY: i32 = 98;

/// A name that matches no device.
const NO_DEVICE: &str = "none";
/// Default speed of the serial line of a device link, baud. USB CDC ignores it.
const LINK_BAUD: u32 = 1_000_000;
/// Time limit for opening the device link. A controller that restarts when its port is opened takes a second
/// or two.
const LINK_TIMEOUT: Duration = Duration::from_secs(5);

/// A device with motors, as the command line names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hardware<'n> {
    /// `polhem:PORT`
    Polhem {
        /// The serial port.
        port: &'n str,
    },
    /// `falcon[:FIRMWARE]`
    Falcon {
        /// The firmware file to load if the device does not respond.
        firmware: Option<&'n Path>,
    },
    /// `link:PORT[@BAUD]`
    Link {
        /// The serial port.
        port: &'n str,
        /// Speed of the serial line.
        baud: u32,
    },
}

impl<'n> Hardware<'n> {
    /// The device with this name; `None` if it is not a device with motors.
    pub(crate) fn named(name: &'n str) -> Option<Self> {
        let (kind, rest) = name.split_once(':').map_or((name, None), |(kind, rest)| (kind, Some(rest)));
        match (kind, rest) {
            ("polhem", Some(port)) => Some(Self::Polhem { port }),
            ("link", Some(place)) => Some(match place.rsplit_once('@') {
                // A port name may contain an @.
                Some((port, baud)) if baud.parse::<u32>().is_ok_and(|baud| baud > 0) => {
                    Self::Link { port, baud: baud.parse().unwrap_or(LINK_BAUD) }
                }
                _ => Self::Link { port: place, baud: LINK_BAUD },
            }),
            ("falcon", firmware) => Some(Self::Falcon { firmware: firmware.map(Path::new) }),
            _ => None,
        }
    }

    /// The name of its bundled profile.
    const fn own_profile(self) -> &'static str {
        match self {
            Self::Polhem { .. } => "polhem",
            Self::Falcon { .. } => "falcon",
            Self::Link { .. } => "link",
        }
    }

    /// Whether a separate process must zero its force. The device link has a watchdog of 5 to 20 ms of its
    /// own.
    pub(crate) const fn needs_supervisor(self) -> bool {
        !matches!(self, Self::Link { .. })
    }

    /// Opens it in this process. `fifo_priority` is the priority of a reader thread.
    pub(crate) fn open(self, profile: &Profile, fifo_priority: Option<i32>) -> Result<Opened, Failure> {
        match self {
            Self::Link { port, baud } => {
                print_latency(port);
                let device = Link::open(port, baud, link_config(profile)?);
                device
                    .map(|device| Opened::Link(Box::new(device)))
                    .map_err(|error| Failure::input(format!("{port}: {error}")))
            }
            Self::Polhem { port } => {
                print_latency(port);
                let device = Polhem::open(port, polhem_config(profile));
                device
                    .map(|device| Opened::Polhem(Box::new(device)))
                    .map_err(|error| Failure::input(format!("{port}: {error}; check port and power")))
            }
            Self::Falcon { firmware } => {
                let image = firmware.map(|path| {
                    let bytes = std::fs::read(path).map_err(|error| Failure::file(path, &error))?;
                    Image::new(bytes).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
                });
                let config = FalconConfig::of(profile, Mode::Threaded { fifo_priority });
                let falcon = Falcon::open(config, image.transpose()?.as_ref()).map_err(Failure::input)?;
                Ok(Opened::Falcon(Box::new(falcon)))
            }
        }
    }
}

/// Requests low latency from the port's USB adapter, if it has one, and reports the result.
fn print_latency(port: &str) {
    if let Some(timer) = LatencyTimer::shorten(port) {
        eprintln!("palpate: {port}: {timer}");
    }
}

/// The configuration of a device link from a profile.
fn link_config(profile: &Profile) -> Result<LinkConfig, Failure> {
    LinkConfig::of(profile, LINK_TIMEOUT).ok_or_else(|| {
        Failure::input(format!(
            "{}: the profile states no mechanism; add [capstan] (docs/devices.md, Profiles)",
            profile.name
        ))
    })
}

/// The configuration of a Polhem from a profile.
fn polhem_config(profile: &Profile) -> PolhemConfig {
    PolhemConfig {
        workspace: profile.workspace,
        max_force_n: profile.max_force_n,
        max_stiffness_n_m: profile.cap().n_m,
        ..PolhemConfig::default()
    }
}

/// An open device, in this process or in the supervisor.
#[derive(Debug)]
pub(crate) enum Opened {
    Polhem(Box<Polhem>),
    Falcon(Box<Falcon<UsbFtdi>>),
    Link(Box<Link>),
    Supervised(Box<Supervised>),
}

impl Opened {
    /// The device as the loop uses it.
    pub(crate) fn into_device(self) -> Box<dyn Device> {
        match self {
            Self::Polhem(device) => device,
            Self::Falcon(device) => device,
            Self::Link(device) => device,
            Self::Supervised(device) => device,
        }
    }

    fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        match self {
            Self::Polhem(_) => Ok(true),
            Self::Link(device) => device.home(stop),
            Self::Falcon(device) => device.home(stop),
            Self::Supervised(device) => device.home(stop),
        }
    }
}

/// The named profile, or that of the device.
pub(crate) fn profile(device: &str, name: Option<&str>) -> Result<Option<Profile>, Failure> {
    let name = name.or_else(|| Hardware::named(device).map(Hardware::own_profile));
    name.map(Profile::load).transpose().map_err(Failure::input)
}

/// One above the priority of the loop, which spins before its deadline; `None` if the loop has none.
pub(crate) fn above(loop_priority: Option<i32>) -> Option<i32> {
    loop_priority.map(|priority| (priority + 1).min(MAX_PRIORITY))
}

/// A device for the loop, and its supervisor.
pub(crate) type Held = (Box<dyn Device>, Option<Arc<Supervision>>);

/// How a device is opened.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Holding<'a> {
    /// As the command line names it.
    pub device: &'a str,
    /// The profile as the command line names it.
    pub profile_name: Option<&'a str>,
    /// Priority of the loop.
    pub loop_priority: Option<i32>,
    /// Silence after which a supervisor zeroes the device, ms; `None` for no supervisor.
    pub supervisor_ms: Option<u32>,
}

/// Opens a device with motors and waits until it is homed, or until the session is stopped.
pub(crate) fn open(
    hardware: Hardware<'_>,
    holding: Holding<'_>,
    profile: &Profile,
    stop: &AtomicBool,
) -> Result<Held, Failure> {
    let supervisor_ms = holding.supervisor_ms.filter(|_| hardware.needs_supervisor());
    let (mut opened, supervision) = match supervisor_ms {
        Some(limit_ms) => {
            let device = supervised(holding, limit_ms, stop)?;
            let supervision = device.supervision();
            (Opened::Supervised(Box::new(device)), Some(supervision))
        }
        None => (hardware.open(profile, above(holding.loop_priority))?, None),
    };
    if let Hardware::Falcon { .. } = hardware {
        eprintln!(
            "palpate: home the Falcon: pull its grip all the way out, then push it all the way in (red light: not homed, blue: homed)"
        );
    }
    if let Hardware::Link { .. } = hardware {
        eprintln!("palpate: home the device as its manual describes; it has no force before that");
    }
    opened.home(stop).map_err(|error| {
        Failure::input(format!("{}: {error}; check cable and power and start again", holding.device))
    })?;
    Ok((opened.into_device(), supervision))
}

/// The command that starts this program as a supervisor of the device.
fn supervisor(device: &str) -> std::io::Result<Command> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["supervise", device]);
    Ok(command)
}

/// Starts a supervisor for a device that does not exist, and returns the time until it reports that. This
/// checks all parts except the device.
pub(crate) fn try_supervisor() -> Result<Duration, StartError> {
    try_command(supervisor(NO_DEVICE)?)
}

fn try_command(command: Command) -> Result<Duration, StartError> {
    let begun = Instant::now();
    match Supervised::start(command, supervisor::DEFAULT_LIMIT_MS, &AtomicBool::new(false)) {
        Ok(_) | Err(StartError::Refused(_)) => Ok(begun.elapsed()),
        Err(error) => Err(error),
    }
}

fn supervised(holding: Holding<'_>, limit_ms: u32, stop: &AtomicBool) -> Result<Supervised, Failure> {
    let mut command = supervisor(holding.device).map_err(|error| {
        Failure::work(format!(
            "the path of this program is unknown ({error}); --no-supervisor runs without a supervisor"
        ))
    })?;
    if let Some(profile) = holding.profile_name {
        command.args(["--profile", profile]);
    }
    if let Some(priority) = above(holding.loop_priority) {
        command.args(["--fifo", &priority.to_string()]);
    }
    Supervised::start(command, limit_ms, stop).map_err(|error| match error {
        StartError::Refused(text) => Failure::input(text),
        error => Failure::work(error),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::device::profile::{DEFAULT_CAP_N_M, Damping};

    #[test]
    fn what_is_no_supervisor_is_told_from_one() {
        assert!(Hardware::named(NO_DEVICE).is_none());
        assert!(matches!(try_command(Command::new("/no/such/program")), Err(StartError::Io(_))));
        assert!(matches!(try_command(Command::new("true")), Err(StartError::Ended)));
    }

    #[test]
    fn a_link_is_a_port_and_perhaps_a_speed_and_its_profile_states_a_mechanism() {
        let link = |port, baud| Some(Hardware::Link { port, baud });
        assert_eq!(Hardware::named("link:/dev/ttyACM0"), link("/dev/ttyACM0", LINK_BAUD));
        assert_eq!(Hardware::named("link:/dev/ttyUSB0@3000000"), link("/dev/ttyUSB0", 3_000_000));
        assert_eq!(Hardware::named("link:/dev/a@b"), link("/dev/a@b", LINK_BAUD));
        assert_eq!(Hardware::named("link"), None);
        let profile = profile("link:/dev/ttyACM0", None).expect("bundled").expect("its own");
        assert!(link_config(&profile).is_ok());
        let other = Profile::load("polhem").expect("bundled");
        let refused = link_config(&other).expect_err("no mechanism").line();
        assert!(refused.contains("[capstan]"), "{refused}");
    }

    /// A profile with a stated damping may exceed the conservative default, up to the limit of the formulas.
    #[test]
    fn a_stated_damping_lifts_the_cap_of_a_polhem() {
        let mut profile = Profile::load("polhem").expect("bundled");
        assert_eq!(polhem_config(&profile).max_stiffness_n_m, DEFAULT_CAP_N_M);
        profile.mechanism.damping = Some(Damping { n_s_m: 3.5, measured: true });
        let config = polhem_config(&profile);
        assert!(config.max_stiffness_n_m > 1.2 * DEFAULT_CAP_N_M, "{config:?}");
        assert_eq!(config.max_stiffness_n_m, profile.cap().n_m);
        assert_eq!((config.max_force_n, config.workspace), (5.0, profile.workspace));
    }
}
