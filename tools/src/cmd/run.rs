//! `palpate run`: the 1 kHz loop on a blob and a device, recorded if asked for; or the replay of a recording.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ};
use palpate_host::device::polhem::{Polhem, PolhemConfig};
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::replay::ReplayError;
use palpate_host::rt::Miss;
use palpate_host::rt::watchdog::DEFAULT_LIMIT_MS;
use palpate_host::viewer::ViewerError;
use palpate_host::{BlobFile, Device, Recording, replay};

use super::inspect::certificate;
use super::pack::method;
use crate::blob;
use crate::failure::Failure;
use crate::output;
use crate::timing::Timing;
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
    /// The device: sim (a simulated hand), polhem:PORT (Polhem / WoodenHaptics on a serial port), or replay:FILE.mcap (a recording)
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
    /// Frames a second without a window; 0 for none
    #[arg(long, value_name = "HZ", default_value_t = touch::HEADLESS_RATE_HZ, value_parser = frame_rate)]
    frame_rate: f32,
    /// Run a blob that nobody measured: without a certificate nothing says how far its forces are from finite elements
    #[arg(long)]
    uncertified: bool,
    /// Record every tick to this file (MCAP), which must not be there yet
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Write the histograms of wake-up lateness, device time and compute time to this file, and show them
    #[arg(long, value_name = "FILE.csv")]
    histograms: Option<PathBuf>,
    #[command(flatten)]
    timing: Timing,
    /// Standstill of the loop after which the watchdog takes the force away past it, ms; not below the 10 ms at which a sample is stale
    #[arg(long, value_name = "MS", help_heading = "Timing", default_value_t = DEFAULT_LIMIT_MS)]
    watchdog_ms: u32,
    /// Folder for frames and screenshots
    #[arg(long, default_value = "palpate-frames")]
    pictures: PathBuf,
}

/// The worst deadline misses, and which part of their tick took the time.
fn print_misses(worst: &[Miss]) -> Result<(), Failure> {
    if worst.is_empty() {
        return Ok(());
    }
    output::line(format!(
        "\nworst misses {:>9} {:>9} {:>12} {:>12} {:>12}  (ms)",
        "tick", "late by", "woken late", "device", "controller"
    ))?;
    for Miss { tick, late_ns, times, .. } in worst {
        let ms = |ns: u64| ns as f64 * 1e-6;
        output::line(format!(
            "{:22} {:>9.3} {:>12.3} {:>12.3} {:>12.3}",
            tick,
            ms(*late_ns),
            ms(times.wake_ns),
            ms(times.device_ns),
            ms(times.compute_ns)
        ))?;
    }
    Ok(())
}

fn frame_rate(text: &str) -> Result<f32, String> {
    let rate_hz: f32 = text.parse().map_err(|_| "not a number".to_string())?;
    if (0.0..=1000.0).contains(&rate_hz) { Ok(rate_hz) } else { Err("not within 0 and 1000".into()) }
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
        _ => Err(Failure::input(format!("no device `{name}`; choose sim, polhem:PORT or replay:FILE.mcap"))),
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
    let show = show(args, record);
    let touched = touch::run(&organ, method, show, &stop, || open_device(&args.device, &organ), |_| ())?;
    output::line(format!("method       {}\n{}", method.name(), touched.summary))?;
    if let Some(path) = &args.histograms {
        output::line(format!("\n{}", touched.summary.latency.histograms.bars()))?;
        print_misses(&touched.summary.latency.worst)?;
        output::histograms(path, &touched.summary.latency)?;
    }
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
        rate_hz: args.frame_rate,
        pictures: &args.pictures,
        record,
        timing: args.timing,
        watchdog_ms: args.watchdog_ms,
    }
}

/// A recording on the blob it was made with. No certificate is asked for: nothing is driven by these forces.
fn run_replay(args: &Args, file: &BlobFile, organ: &Organ<'_>, path: &Path) -> Result<(), Failure> {
    if args.record.is_some() || args.seconds.is_some() {
        return Err(Failure::input(
            "a replay is as long as its recording and is not recorded again: leave --seconds and --record out",
        ));
    }
    if args.histograms.is_some() {
        return Err(Failure::input("a replay has no timing of its own: leave --histograms out"));
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
