//! `palpate run`: the 1 kHz loop on a blob and a device, recorded if asked for; or the replay of a recording.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ, vec3};
use palpate_host::device::mouse::{Mouse, MouseConfig, MouseHandle, mouse};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::replay::ReplayError;
use palpate_host::viewer::ViewerError;
use palpate_host::{BlobFile, Device, Recording, replay};

use super::inspect::certificate;
use super::pack::method;
use crate::blob;
use crate::failure::Failure;
use crate::output;
use crate::touch;
use crate::workbench::stop_flag;

/// Touch the organ in a blob: the 1 kHz loop, a device and the viewer.
///
/// Without a display (or with --headless) PNG frames are written instead of a window. A real device is armed by its
/// button or by the window's key, never by starting. Ctrl-C ends the session with zero force.
///
/// With --record every tick goes into an MCAP file. --device replay:FILE.mcap runs the loop over such a file again, on the same blob,
/// and compares every force: exit code 1 if one differs in a bit. With --method too it is replayed with that method, and the largest
/// difference is shown.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .blob file
    blob: PathBuf,
    /// The device: sim (a simulated hand), mouse (drags the organ in the window), polhem:PORT (Polhem / WoodenHaptics on a serial port), or replay:FILE.mcap (a recording)
    #[arg(long, default_value = "sim")]
    device: String,
    /// Interpolation method; if not given the first that the blob holds of energy, hermite, tricubic, rbf-cubic, rbf-linear,
    /// hybrid, trilinear
    #[arg(long, value_parser = method)]
    method: Option<Method>,
    /// Seconds to run; until Ctrl-C if not given
    #[arg(long)]
    seconds: Option<f64>,
    /// PNG frames instead of a window
    #[arg(long)]
    headless: bool,
    /// With --headless: an animated GIF instead of PNG frames; what is there is lost
    #[arg(long, value_name = "FILE.gif", requires = "headless")]
    gif: Option<PathBuf>,
    /// Run a blob that nobody measured: without a certificate nothing says how far its forces are from finite elements
    #[arg(long)]
    uncertified: bool,
    /// Record every tick to this file (MCAP), which must not be there yet
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Folder for frames and screenshots
    #[arg(long, default_value = "palpate-frames")]
    pictures: PathBuf,
}

/// Height above the first active node at which the mouse's tool begins, m.
const MOUSE_HEIGHT_M: f32 = 0.03;

/// The mouse device and the window's end of it.
fn open_mouse(args: &Args, organ: &Organ<'_>) -> Result<(MouseHandle, Mouse), Failure> {
    if args.headless {
        return Err(Failure::input(touch::MOUSE_NEEDS_WINDOW));
    }
    let start_m = organ.spaces.first().map_or(vec3::ZERO, |space| {
        vec3::add(space.rest_position_m, vec3::scale(space.outward_normal, MOUSE_HEIGHT_M))
    });
    Ok(mouse(start_m, MouseConfig::default()))
}

fn open_device(name: &str, organ: &Organ<'_>) -> Result<Box<dyn Device>, Failure> {
    match name.split_once(':') {
        None if name == "sim" => Ok(Box::new(SimulatedHand::new(organ, SimulatedConfig::default()))),
        Some(("polhem", port)) => {
            let device = Polhem::open(port, PolhemConfig::default());
            Ok(Box::new(
                device.map_err(|error| Failure::input(format!("{port}: {error}; check port and power")))?,
            ))
        }
        _ => Err(Failure::input(format!(
            "no device `{name}`; choose sim, mouse, polhem:PORT or replay:FILE.mcap"
        ))),
    }
}

/// Without --method: the most accurate that costs the same whatever the grid, then the others.
const PREFERENCE: [Method; 7] = [
    Method::Energy,
    Method::Hermite,
    Method::Tricubic,
    Method::RbfCubic,
    Method::RbfLinear,
    Method::Hybrid,
    Method::Trilinear,
];

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let file = blob::load(&args.blob)?;
    let organ = blob::organ(&args.blob, &file)?;
    if let Some(recording) = args.device.strip_prefix("replay:") {
        return run_replay(args, &file, &organ, Path::new(recording));
    }
    let packed = || PREFERENCE.into_iter().find(|m| organ.spaces.iter().all(|s| s.has(*m)));
    let method = args.method.or_else(packed).ok_or_else(|| {
        Failure::input(format!(
            "{}: holds no method for all its active nodes; pack again",
            args.blob.display()
        ))
    })?;
    if !args.uncertified {
        check_certificate(&args.blob, &organ, method)?;
    }
    let blob_blake3 = file.blake3();
    let record = args.record.as_deref().map(|path| touch::Record { path, blob_blake3: &blob_blake3 });
    let stop = stop_flag()?;
    let (handle, mut tool) = match args.device.as_str() {
        "mouse" => open_mouse(args, &organ).map(|(handle, tool)| (Some(handle), Some(tool)))?,
        _ => (None, None),
    };
    let show = touch::Show { mouse: handle.as_ref(), ..show(args, record) };
    let device = || match tool.take() {
        Some(tool) => Ok(Box::new(tool) as Box<dyn Device>),
        None => open_device(&args.device, &organ),
    };
    let touched = touch::run(&organ, method, show, &stop, device, |_| ())?;
    output::line(format!("method       {}\n{}", method.name(), touched.summary))?;
    if let (Some(path), Some(report)) = (&args.record, &touched.recording) {
        let (path, ticks, dropped) = (path.display(), report.ticks, report.dropped);
        output::line(format!("recording    {path}: {ticks} ticks, {dropped} more dropped while writing"))?;
        if let Some(error) = &report.error {
            return Err(Failure::work(format!("{path}: {error}; the recording ends there")));
        }
    }
    touch::judge(&touched.summary)
}

fn show<'a>(args: &'a Args, record: Option<touch::Record<'a>>) -> touch::Show<'a> {
    touch::Show {
        seconds: args.seconds,
        headless: args.headless,
        pictures: &args.pictures,
        record,
        gif: args.gif.as_deref(),
        mouse: None,
    }
}

/// A recording on the blob it was made with. No certificate is asked for: nothing is driven by these forces.
fn run_replay(args: &Args, file: &BlobFile, organ: &Organ<'_>, path: &Path) -> Result<(), Failure> {
    if args.record.is_some() || args.seconds.is_some() {
        return Err(Failure::input(
            "a replay is as long as its recording and is not recorded again: leave --seconds and --record out",
        ));
    }
    let stop = stop_flag()?;
    let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let once = |view| -> Result<_, Failure> {
        let source = File::open(path).map_err(|error| Failure::file(path, &error))?;
        let mut recording =
            Recording::open(BufReader::new(source)).map_err(|error| Failure::input(named(&error)))?;
        Ok(replay(organ, &file.blake3(), &mut recording, args.method, &view, &stop))
    };
    let show = show(args, None);
    let mut replayed = once(show.view())?;
    if let (Err(ReplayError::Viewer(ViewerError::NoDisplay(error))), false) = (&replayed, args.headless) {
        eprintln!("palpate: no window ({error}); writing PNG frames instead");
        replayed = once(show.frames())?;
    }
    let summary = replayed.map_err(|error| match error {
        ReplayError::Viewer(error) => Failure::work(error),
        error => Failure::input(named(&error)),
    })?;
    output::line(format!("method       {}\n{summary}", summary.method.name()))?;
    if summary.method == summary.recorded_method && summary.different > 0 {
        return Err(Failure::work(named(&format!("{} of its ticks come out otherwise", summary.different))));
    }
    if summary.ticks == 0 && !summary.is_stopped {
        return Err(Failure::work(named(&"holds no tick to replay")));
    }
    if summary.lost > 0 {
        return Err(Failure::work(named(&"records are missing, so it was replayed in part only")));
    }
    Ok(())
}

/// Refuses a blob that nobody measured with this method, or only where no position could speak for the others.
fn check_certificate(path: &Path, organ: &Organ<'_>, method: Method) -> Result<(), Failure> {
    let path_name = path.display();
    let Some(certificate) = certificate::of(path, organ)? else {
        return Err(Failure::input(format!(
            "{path_name}: has no certificate, so nothing says how far its forces are from the organ's; pack it without \
             --no-certificate, or run it with --uncertified"
        )));
    };
    for space in &certificate.spaces {
        let measured = space.methods.iter().find(|m| m.method == method.name());
        if measured.is_none_or(|m| m.uniform.count == 0) {
            return Err(Failure::input(format!(
                "{path_name}: its certificate has no position of {} away from folds for {}, so it says nothing about its forces; pack it \
                 on a finer grid or a smaller radius, or run it with --uncertified",
                space.active,
                method.name()
            )));
        }
    }
    Ok(())
}
