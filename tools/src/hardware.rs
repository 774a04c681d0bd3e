//! Real devices: opened in this process, with a guard that this process starts.

use std::io::IsTerminal;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use palpate_host::device::falcon::{Falcon, FalconConfig, Image, Mode};
use palpate_host::device::link::{Link, LinkConfig, LinkError};
use palpate_host::device::maker::{self, Maker, StartError};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::profile::Profile;
use palpate_host::device::serial::LatencyTimer;
use palpate_host::guard::{self, GuardOptions, GuardStatus, Guarded, Guarding};
use palpate_host::sys::Policy;
use palpate_host::{Device, DeviceError, DeviceErrorKind};

use crate::device_spec::{DeviceSpec, Hardware};
use crate::failure::Failure;

/// Highest requested priority: 99 belongs to the kernel.
const MAX_PRIORITY: i32 = 98;

/// Time limit for opening the device link. A controller that restarts when its port is opened takes a second
/// or two.
const LINK_TIMEOUT: Duration = Duration::from_secs(5);

/// Opens a device in this process. `fifo_priority` is the priority of its own threads.
fn open_device(
    hardware: &Hardware,
    profile: &Profile,
    fifo_priority: Option<i32>,
) -> Result<Box<dyn Device>, Failure> {
    match hardware {
        Hardware::Link { port, baud } => {
            print_latency(port);
            match Link::open(port, *baud, link_config(profile)?) {
                Ok(device) => Ok(Box::new(device)),
                Err(LinkError::Device(error)) => Err(port_failure(port, error)),
                Err(error) => Err(Failure::input(format!("{port}: {error}"))),
            }
        }
        Hardware::Polhem { port } => {
            print_latency(port);
            match Polhem::open(port, polhem_config(profile)) {
                Ok(device) => Ok(Box::new(device)),
                Err(error) => Err(port_failure(port, error)),
            }
        }
        Hardware::Touch { library } => {
            open_maker(Maker::Touch { library: library.clone() }, profile, fifo_priority)
        }
        Hardware::ForceDimension { family, library } => {
            let (family, library) = (*family, library.clone());
            open_force_dimension(
                |may_move| Maker::ForceDimension { family, may_move, library: library.clone() },
                profile,
                fifo_priority,
            )
        }
        Hardware::Haply { address } => {
            open_maker(Maker::Haply { address: address.clone() }, profile, fifo_priority)
        }
        Hardware::Falcon { firmware } => {
            let image = firmware.as_ref().map(|path| {
                let bytes = std::fs::read(path).map_err(|error| Failure::file(path, &error))?;
                Image::new(bytes).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
            });
            let config = FalconConfig::of(profile, Mode::Threaded { fifo_priority });
            let falcon = Falcon::open(config, image.transpose()?.as_ref()).map_err(Failure::input)?;
            Ok(Box::new(falcon))
        }
    }
}

/// A port that cannot be opened, and what to do.
fn port_failure(port: &str, error: DeviceError) -> Failure {
    let fix = match error.kind() {
        DeviceErrorKind::InUse => "end it",
        DeviceErrorKind::Denied => "give this user access (docs/devices.md, Permissions)",
        _ => "check port and power",
    };
    Failure::input(format!("{port}: {error}; {fix}"))
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

/// Starts the process that holds the device of a maker.
fn start_maker(
    maker: Maker,
    profile: &Profile,
    fifo_priority: Option<i32>,
) -> Result<Box<dyn Device>, StartError> {
    let device = maker::start(own_command("proxy")?, maker, profile, fifo_priority)?;
    Ok(Box::new(device))
}

fn maker_failure(error: StartError) -> Failure {
    match error {
        StartError::Refused(_) | StartError::MovesArm(_) => Failure::input(error),
        StartError::Proxy(_) => Failure::work(error.to_string()),
    }
}

/// Opens the device of a maker behind its process.
fn open_maker(
    maker: Maker,
    profile: &Profile,
    fifo_priority: Option<i32>,
) -> Result<Box<dyn Device>, Failure> {
    start_maker(maker, profile, fifo_priority).map_err(maker_failure)
}

/// As [`open_maker`]; an arm that has to move by itself does so with the consent of the user at the terminal.
fn open_force_dimension(
    maker: impl Fn(bool) -> Maker,
    profile: &Profile,
    fifo_priority: Option<i32>,
) -> Result<Box<dyn Device>, Failure> {
    match start_maker(maker(false), profile, fifo_priority) {
        Err(StartError::MovesArm(line)) if std::io::stdin().is_terminal() => {
            let why = line.split_once(';').map_or(&*line, |(why, _)| why);
            eprint!("palpate: {why}\nTake your hands off it. Type `yes` to let the arm move: ");
            let mut typed = String::new();
            std::io::stdin().read_line(&mut typed).map_err(|error| Failure::work(error.to_string()))?;
            if typed.trim() != "yes" {
                return Err(Failure::input("the arm stays where it is: no consent"));
            }
            open_maker(maker(true), profile, fifo_priority)
        }
        opened => opened.map_err(maker_failure),
    }
}

/// The named profile, or that of the device.
pub(crate) fn profile(device: &DeviceSpec, name: Option<&str>) -> Result<Option<Profile>, Failure> {
    let name = name.or_else(|| device.hardware().map(Hardware::own_profile));
    name.map(Profile::load).transpose().map_err(Failure::input)
}

/// One above the priority of the loop, which spins before its deadline; `None` if the loop has none.
pub(crate) fn above(loop_priority: Option<i32>) -> Option<i32> {
    loop_priority.map(|priority| (priority + 1).min(MAX_PRIORITY))
}

/// A device for the loop, and its guard.
pub(crate) type Held = (Box<dyn Device>, Option<Arc<GuardStatus>>);

/// Opens a device with motors, starts its guard, and waits until it is homed or the session is stopped.
pub(crate) fn open(
    hardware: &Hardware,
    profile: &Profile,
    guard: GuardOptions,
    stop: &AtomicBool,
) -> Result<Held, Failure> {
    let device = open_device(hardware, profile, guard.fifo_priority)?;
    let guarding = own_command("guard").and_then(|command| Guarded::start(device, command, guard));
    let (mut device, status): Held = match guarding {
        Ok(Guarding::Guarded(guarded)) => {
            let status = guarded.status();
            (guarded, Some(status))
        }
        // The process that holds the maker's library is its guard.
        Ok(Guarding::Unneeded(device)) if hardware.has_proxy() => (device, None),
        Ok(Guarding::Unneeded(_)) => {
            return Err(Failure::work("the driver of this device offers its guard no path to the motors"));
        }
        Err(error) => {
            return Err(Failure::work(format!(
                "the guard of the device cannot be started ({error}); `palpate doctor` checks it"
            )));
        }
    };
    match hardware {
        Hardware::Falcon { .. } => eprintln!(
            "palpate: home the Falcon: pull its grip all the way out, then push it all the way in (red light: not homed, blue: homed)"
        ),
        Hardware::Link { .. } => {
            eprintln!("palpate: home the device as its manual describes; it has no force before that");
        }
        Hardware::Polhem { .. }
        | Hardware::Touch { .. }
        | Hardware::ForceDimension { .. }
        | Hardware::Haply { .. } => {}
    }
    device.home(stop).map_err(|error| {
        Failure::input(format!("{hardware}: {error}; check cable and power and start again"))
    })?;
    Ok((device, status))
}

/// The command that starts this program as a guard or a proxy.
fn own_command(name: &str) -> std::io::Result<Command> {
    let mut command = Command::new(std::env::current_exe()?);
    command.arg(name);
    Ok(command)
}

/// Starts a guard without a device, and returns the time until it is ready, and its scheduling policy.
pub(crate) fn try_guard(options: GuardOptions) -> std::io::Result<(Duration, Policy)> {
    guard::try_start(own_command("guard")?, options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::device::profile::{DEFAULT_CAP_N_M, Damping};

    #[test]
    fn the_profile_of_a_link_states_a_mechanism() {
        let device: DeviceSpec = "link:/dev/ttyACM0".parse().expect("a device");
        let profile = profile(&device, None).expect("bundled").expect("its own");
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
