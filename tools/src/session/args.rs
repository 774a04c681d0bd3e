//! The arguments that `run` and `live` share: device, length, pictures, recording, timing.

use std::path::{Path, PathBuf};

use clap::{Args as ClapArgs, Parser};
use palpate_host::guard::{DEFAULT_LIMIT_MS, GuardOptions};

use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::hardware;
use crate::timing::Timing;
use crate::touch;

/// Arguments of a session.
#[derive(Debug, ClapArgs)]
pub(crate) struct SessionArgs {
    /// sim, mouse, polhem:PORT, falcon, touch, omega, haply, link:PORT or replay:FILE.mcap (also delta, sigma, lambda)
    ///
    /// sim (a simulated hand on a tour), sim:random:SEED (the same, palpating at random), sim:FILE.csv (on a way with the
    /// columns t_s,x_m,y_m,z_m), mouse (drags the
    /// organ in the window), polhem:PORT (Polhem / WoodenHaptics on a serial port), falcon or falcon:FIRMWARE
    /// (Novint Falcon on USB, with its firmware file for when it is silent), touch or touch:LIBRARY (3D Systems Touch or
    /// Phantom through the OpenHaptics that is installed, or this file), omega, delta, sigma, lambda or dhd-falcon, each
    /// with :LIBRARY or without (Force Dimension, or a Falcon, through the libdrd that is installed, or this file), haply or
    /// haply:HOST:PORT (Inverse3 through the Inverse Service), link:PORT or link:PORT@BAUD (a
    /// controller that speaks the device link), or replay:FILE.mcap (a recording).
    #[arg(long, value_name = "DEVICE", default_value = "sim")]
    pub(crate) device: DeviceSpec,
    /// Capabilities of the device: a bundled profile or a .toml file
    ///
    /// Bundled: delta.3, desktop, dhd-falcon, falcon, haply, lambda.7, link, omega, omni, polhem, premium-1.5, sigma.7,
    /// simulated, touch, touch-x. With sim that device's mechanics are simulated; devices with motors have their own.
    #[arg(long, value_name = "NAME|FILE.toml")]
    pub(crate) profile: Option<String>,
    /// Seconds to run; until Ctrl-C if not given
    #[arg(long, value_name = "S")]
    pub(crate) seconds: Option<f64>,
    /// PNG frames instead of a window
    #[arg(long)]
    pub(crate) headless: bool,
    /// Record every tick to this file, which must not exist yet
    #[arg(long, value_name = "FILE.mcap")]
    pub(crate) record: Option<PathBuf>,
    /// Send no force: for the first power-up of a real device
    ///
    /// Positions are read and forces computed, recorded and shown (five times a second on standard error).
    /// See docs/devices.md.
    #[arg(long)]
    pub(crate) motors_off: bool,
    /// Print also the distributions of times, and the worst misses
    #[arg(long)]
    pub(crate) verbose: bool,
    /// Print only the summary, as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
    /// Frames per second without a window; 0 for none; 2 if not given
    #[arg(long, value_name = "HZ", value_parser = frame_rate, hide_short_help = true,
          help_heading = "Pictures")]
    pub(crate) frame_rate: Option<f32>,
    /// Folder for frames and screenshots; existing ones stay, and the numbers continue
    #[arg(
        long,
        value_name = "DIR",
        default_value = "palpate-frames",
        hide_short_help = true,
        help_heading = "Pictures"
    )]
    pub(crate) pictures: PathBuf,
    /// Coulomb friction, 0 to 1, or stick; 0.3 by default, and 0 under a sphere
    ///
    /// A point or fingertip slides over triangles whose corners are all active, a sphere anywhere.
    #[arg(long, value_name = "MU", value_parser = friction, hide_short_help = true,
          help_heading = "Contact")]
    pub(crate) friction: Option<f32>,
    /// Create this socket, over which `palpate control` disarms, resets and ends the session
    ///
    /// Its mode is 0660 for the group palpate, or 0600 if this user may not give it files.
    #[arg(long, value_name = "SOCKET", hide_short_help = true, help_heading = "Control")]
    pub(crate) control: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) timing: Timing,
    /// Write the histograms of wake-up lateness, device time and compute time to this file
    #[arg(long, value_name = "FILE.csv", hide_short_help = true, help_heading = "Timing")]
    pub(crate) histograms: Option<PathBuf>,
    /// Time without a tick after which the guard of a real device zeroes the force, ms
    #[arg(long, value_name = "MS", help_heading = "Timing", default_value_t = DEFAULT_LIMIT_MS,
          value_parser = clap::value_parser!(u32).range(3..=20), hide_short_help = true)]
    pub(crate) guard_ms: u32,
    #[command(flatten)]
    pub(crate) replace: Replace,
}

fn friction(text: &str) -> Result<f32, String> {
    match text.parse() {
        _ if text == "stick" => Ok(f32::INFINITY),
        Ok(mu) if (0.0..=1.0).contains(&mu) => Ok(mu),
        _ => Err("not within 0 and 1, and not stick".into()),
    }
}

fn frame_rate(text: &str) -> Result<f32, String> {
    let rate_hz: f32 = text.parse().map_err(|_| "not a number".to_string())?;
    if (0.0..=1000.0).contains(&rate_hz) { Ok(rate_hz) } else { Err("not within 0 and 1000".into()) }
}

/// A command line with the arguments of a session alone.
#[derive(Debug, Parser)]
struct Alone {
    #[command(flatten)]
    session: SessionArgs,
}

impl SessionArgs {
    /// A session of a simulated hand, with everything else as it is if it is not given.
    pub(crate) fn of_simulated_hand(seconds: f64, pictures: &Path, headless: bool) -> Self {
        let Alone { session } = Alone::parse_from(["session"]);
        Self { seconds: Some(seconds), pictures: pictures.into(), headless, ..session }
    }

    /// How the guard of a device with motors is started.
    pub(super) fn guard(&self) -> GuardOptions {
        let request = self.timing.request();
        GuardOptions {
            limit_ms: self.guard_ms,
            fifo_priority: hardware::above(request.fifo_priority),
            locks_memory: request.lock_memory,
        }
    }

    /// Refuses values that no session can have.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        match self.seconds.filter(|seconds| !(*seconds >= 0.0 && seconds.is_finite())) {
            Some(seconds) => {
                Err(Failure::input(format!("--seconds {seconds}: give a number that is not negative")))
            }
            None => Ok(()),
        }
    }

    /// The files that the session writes, other than its numbered pictures; `files` knows those that it reads.
    pub(crate) fn outputs(&self, mut files: Files) -> Result<Outputs, Failure> {
        self.device.file().iter().for_each(|path| files.read(path));
        self.profile.iter().for_each(|name| files.read(name.as_ref()));
        Files::not_a_file("--pictures", &self.pictures)?;
        let histograms = self.histograms.as_ref();
        Ok(Outputs {
            record: self.record.as_ref().map(|path| files.write_new("--record", path)).transpose()?,
            histograms: histograms
                .map(|path| files.write("--histograms", path, FileKind::Table))
                .transpose()?,
        })
    }

    /// How the session is shown and how long it lasts.
    pub(crate) fn show<'a>(&'a self, record: Option<touch::Record<'a>>) -> touch::Show<'a> {
        touch::Show {
            seconds: self.seconds,
            headless: self.headless,
            pictures: &self.pictures,
            record,
            friction: self.friction,
            change_every: None,
            profile: None,
            rate_hz: self.frame_rate,
            timing: self.timing,
            mouse: None,
            has_motors: self.device.hardware().is_some(),
            control: None,
            regions: None,
            between: None,
        }
    }
}

/// Files of a session other than its numbered pictures.
#[derive(Debug)]
pub(crate) struct Outputs {
    pub(crate) record: Option<Output>,
    pub(crate) histograms: Option<Output>,
}
