//! `palpate run`: the 1 kHz loop on a blob and a device with an optional recording, or the replay of a
//! recording.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ, vec3};
use palpate_host::device::motors_off::MotorsOff;
use palpate_host::device::mouse::{Mouse, MouseConfig, MouseHandle, mouse};
use palpate_host::device::palpation::RandomConfig;
use palpate_host::device::profile::Profile;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::first_place::first_place;
use palpate_host::guard::{DEFAULT_LIMIT_MS, GuardOptions};
use palpate_host::rt::Miss;
use palpate_host::{BlobFile, Device};
use palpate_record::Recording;
use palpate_record::replay::{self, Pace, ReplayError};
use serde_json::json;

use super::inspect::certificate;
use super::pack::method;
use crate::control::Control;
use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::hardware;
use crate::interrupt::stop_flag;
use crate::output::Table;
use crate::resident::Resident;
use crate::timing::Timing;
use crate::{blob, motors_off, output, regions, summary, touch};
use palpate_precompute::certificate::Verdict;

/// Palpate a blob: the 1 kHz loop, a device and the viewer.
///
/// With --headless PNG frames are written instead of a window, and for a device without motors also if there
/// is no display. The device's button or a chord of keys in the window arms a real device; a start does not.
/// Ctrl-C ends the session with zero force.
///
/// A guard, a separate process, zeroes the force of a real device if this process ends, stops or hangs; this
/// process zeroes it and ends if the guard does.
///
/// --record writes every tick to an MCAP file. --device replay:FILE.mcap runs the loop over such a file
/// again, on the same blob, and compares every force: exit code 1 if one differs in a bit. With --method it
/// replays with that method and shows the largest difference.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The .blob file
    blob: PathBuf,
    /// More .blob files, models of the same organ; key N changes to the next
    ///
    /// The force has no step at the change.
    more: Vec<PathBuf>,
    /// sim, mouse, polhem:PORT, falcon, link:PORT or replay:FILE.mcap
    ///
    /// sim (a simulated hand on a tour), sim:random:SEED (the same, palpating at random), mouse (drags the
    /// organ in the window), polhem:PORT (Polhem / WoodenHaptics on a serial port), falcon or falcon:FIRMWARE
    /// (Novint Falcon on USB, with its firmware file for when it is silent), link:PORT or link:PORT@BAUD (a
    /// controller that speaks the device link), or replay:FILE.mcap (a recording).
    #[arg(long, value_name = "DEVICE", default_value = "sim")]
    device: DeviceSpec,
    /// Capabilities of the device: a bundled profile or a .toml file
    ///
    /// Bundled: delta.3, desktop, falcon, link, omega, omni, polhem, premium-1.5, sigma.7, simulated, touch.
    /// With sim that device's mechanics are simulated; polhem:PORT, falcon and link:PORT have their own.
    #[arg(long, value_name = "NAME|FILE.toml")]
    profile: Option<String>,
    /// Interpolation method; the blob's most accurate if not given
    ///
    /// The first that the blob holds of energy, kernel, hermite, tricubic, rbf-cubic, rbf-linear, hybrid,
    /// trilinear.
    #[arg(long, value_name = "M", value_parser = method)]
    method: Option<Method>,
    /// Seconds to run; until Ctrl-C if not given
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// PNG frames instead of a window
    #[arg(long)]
    headless: bool,
    /// Record every tick to this file, which must not exist yet
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Send no force: for the first power-up of a real device
    ///
    /// Positions are read and forces computed, recorded and shown (five times a second on standard error).
    /// See docs/devices.md.
    #[arg(long)]
    motors_off: bool,
    /// Run a blob that has no certificate
    ///
    /// The error of its forces against finite elements is unknown. A red blob drives no motors in any case.
    #[arg(long)]
    uncertified: bool,
    /// Print also the distributions of times, and the worst misses
    #[arg(long)]
    verbose: bool,
    /// Print only the summary, as one JSON object
    #[arg(long)]
    json: bool,
    /// Frames per second without a window; 0 for none; 2 if not given
    #[arg(long, value_name = "HZ", value_parser = frame_rate, hide_short_help = true, help_heading = "Pictures")]
    frame_rate: Option<f32>,
    /// Folder for frames and screenshots; existing ones stay, and the numbers continue
    #[arg(
        long,
        value_name = "DIR",
        default_value = "palpate-frames",
        hide_short_help = true,
        help_heading = "Pictures"
    )]
    pictures: PathBuf,
    /// The scene of the blob: the side view shows its inclusions, where the skin round them moves them
    #[arg(long, value_name = "SCENE.toml", hide_short_help = true, help_heading = "Pictures")]
    scene: Option<PathBuf>,
    /// Coulomb friction of a pushing tool where it may slide, over triangles whose corners are all active: a
    /// number, or stick
    #[arg(long, value_name = "MU", value_parser = friction, hide_short_help = true, help_heading = "Contact")]
    friction: Option<f32>,
    /// Change to the next of several blobs every S seconds
    #[arg(long, value_name = "S", value_parser = seconds, hide_short_help = true, help_heading = "Contact")]
    change_every: Option<Duration>,
    /// Create this socket, over which `palpate control` disarms, resets and ends the session
    ///
    /// Its mode is 0660 for the group palpate, or 0600 if this user may not give it files.
    #[arg(long, value_name = "SOCKET", hide_short_help = true, help_heading = "Control")]
    control: Option<PathBuf>,
    #[command(flatten)]
    timing: Timing,
    /// Write the histograms of wake-up lateness, device time and compute time to this file
    #[arg(long, value_name = "FILE.csv", hide_short_help = true, help_heading = "Timing")]
    histograms: Option<PathBuf>,
    /// Time without a tick after which the guard of a real device zeroes the force, ms
    #[arg(long, value_name = "MS", help_heading = "Timing", default_value_t = DEFAULT_LIMIT_MS,
          value_parser = clap::value_parser!(u32).range(3..=20), hide_short_help = true)]
    guard_ms: u32,
    #[command(flatten)]
    replace: Replace,
}

fn friction(text: &str) -> Result<f32, String> {
    match text.parse() {
        _ if text == "stick" => Ok(f32::INFINITY),
        Ok(mu) if mu >= 0.0 => Ok(mu),
        _ => Err("a number from 0, or stick".into()),
    }
}

/// Prints the largest deadline misses, and the part of their tick that took the time.
fn print_misses(worst: &[Miss]) -> Result<(), Failure> {
    if worst.is_empty() {
        return Ok(());
    }
    let mut table = Table::new(0, ["tick", "late, ms", "woken late, ms", "device, ms", "controller, ms"]);
    for Miss { tick, late_ns, times, .. } in worst {
        let ms = |ns: u64| format!("{:.3}", ns as f64 * 1e-6);
        let [wake, device, compute] = [times.wake_ns, times.device_ns, times.compute_ns].map(ms);
        table.row([tick.to_string(), ms(*late_ns), wake, device, compute]);
    }
    output::line(format!("\nworst misses\n{table}"))
}

fn frame_rate(text: &str) -> Result<f32, String> {
    let rate_hz: f32 = text.parse().map_err(|_| "not a number".to_string())?;
    if (0.0..=1000.0).contains(&rate_hz) { Ok(rate_hz) } else { Err("not within 0 and 1000".into()) }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: Option<f64> = text.parse().ok().filter(|seconds| *seconds >= 0.01);
    seconds.and_then(|s| Duration::try_from_secs_f64(s).ok()).ok_or_else(|| "seconds, at least 0.01".into())
}

/// Initial height of the mouse's tool above its first place, m.
const MOUSE_HEIGHT_M: f32 = 0.03;

/// The mouse device, and the handle of the window.
fn open_mouse(args: &Args, organ: &Organ<'_>) -> Result<(MouseHandle, Mouse), Failure> {
    if args.headless {
        return Err(Failure::input(touch::MOUSE_NEEDS_WINDOW));
    }
    let start_m = organ.spaces.get(first_place(organ)).map_or(vec3::ZERO, |space| {
        vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, MOUSE_HEIGHT_M))
    });
    Ok(mouse(start_m, MouseConfig::default()))
}

impl Args {
    /// How the guard of a device with motors is started.
    fn guard(&self) -> GuardOptions {
        let request = self.timing.request();
        GuardOptions {
            limit_ms: self.guard_ms,
            fifo_priority: hardware::above(request.fifo_priority),
            locks_memory: request.lock_memory,
        }
    }
}

/// The named profile, or that of the device, at the period of this session.
fn profile(args: &Args) -> Result<Option<Profile>, Failure> {
    let profile = hardware::profile(&args.device, args.profile.as_deref())?;
    // The stiffness cap depends on the actual period.
    Ok(profile.map(|profile| match args.timing.period_us {
        Some(period_us) => profile.at_period(period_us),
        None => profile,
    }))
}

/// Opens the simulated hand or the hardware. Mouse and replay are opened elsewhere.
fn open_device(
    args: &Args,
    organ: &Organ<'_>,
    profile: Option<&Profile>,
    stop: &AtomicBool,
) -> Result<hardware::Held, Failure> {
    if let (Some(hardware), Some(profile)) = (args.device.hardware(), profile) {
        return hardware::open(hardware, profile, args.guard(), stop);
    }
    let mut config = profile.map_or_else(SimulatedConfig::default, SimulatedConfig::for_profile);
    if let DeviceSpec::Simulated { seed: Some(seed) } = args.device {
        config.random = Some(RandomConfig::new(seed));
    }
    Ok((Box::new(SimulatedHand::new(organ, config)), None))
}

/// Refuses arguments that have no effect together.
fn check(args: &Args) -> Result<(), Failure> {
    if let Some(seconds) = args.seconds.filter(|seconds| !(*seconds >= 0.0 && seconds.is_finite())) {
        return Err(Failure::input(format!("--seconds {seconds}: give a number that is not negative")));
    }
    if args.change_every.is_some() && args.more.is_empty() {
        return Err(Failure::input(
            "--change-every goes from one blob to the next, and there is only one: name another, or leave it out",
        ));
    }
    Ok(())
}

/// Files of a session other than its numbered pictures.
struct Outputs {
    record: Option<Output>,
    histograms: Option<Output>,
}

impl Outputs {
    fn of(args: &Args) -> Result<Self, Failure> {
        let mut files = Files::new(args.replace);
        files.read(&args.blob);
        args.more.iter().for_each(|blob| files.read(blob));
        args.device.file().iter().for_each(|path| files.read(path));
        args.profile.iter().for_each(|name| files.read(Path::new(name)));
        args.scene.iter().for_each(|scene| files.read(scene));
        Files::not_a_file("--pictures", &args.pictures)?;
        Ok(Self {
            record: args.record.as_ref().map(|path| files.write_new("--record", path)).transpose()?,
            histograms: args
                .histograms
                .as_ref()
                .map(|path| files.write("--histograms", path, FileKind::Table))
                .transpose()?,
        })
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let begun = Instant::now();
    check(args)?;
    let outputs = Outputs::of(args)?;
    let paths: Vec<&PathBuf> = core::iter::once(&args.blob).chain(&args.more).collect();
    let files = paths.iter().map(|path| blob::load(path)).collect::<Result<Vec<_>, _>>()?;
    let each = || paths.iter().zip(&files);
    let organs = each().map(|(path, file)| blob::organ(path, file)).collect::<Result<Vec<_>, _>>()?;
    let organs: Vec<&Organ<'_>> = organs.iter().collect();
    let blob_blake3: Vec<String> = files.iter().map(BlobFile::blake3).collect();
    if let DeviceSpec::Replay { file } = &args.device {
        return run_replay(args, &organs, &blob_blake3, file);
    }
    let method = args.method.or_else(|| blob::preferred(&organs)).ok_or_else(|| {
        Failure::input(format!(
            "{}: no method that all its active nodes{} hold; pack again",
            args.blob.display(),
            if organs.len() > 1 { " and those of the other blobs" } else { "" }
        ))
    })?;
    for (path, organ) in paths.iter().zip(&organs) {
        check_certificate(path, organ, method, args)?;
    }
    let record = outputs.record.as_ref().map(|file| touch::Record { file, blob_blake3: &blob_blake3 });
    let profile = profile(args)?;
    if organs.iter().all(|organ| organ.spaces.iter().all(|space| space.displacement().is_none())) {
        eprintln!(
            "palpate: no displacements in the blob ([needs] visual = false): the forces are correct, the picture shows the body at rest"
        );
    }
    let regions = args.scene.as_ref().map(|scene| regions::of_scene(scene, &organs)).transpose()?;
    let stop = stop_flag()?;
    let control = args.control.as_ref().map(|path| Control::start(path, Arc::clone(&stop))).transpose()?;
    let (handle, mut tool) = match args.device {
        DeviceSpec::Mouse => open_mouse(args, organs[0]).map(|(handle, tool)| (Some(handle), Some(tool)))?,
        _ => (None, None),
    };
    let show = touch::Show {
        profile: profile.as_ref(),
        mouse: handle.as_ref(),
        control: control.as_ref(),
        regions: regions.as_ref(),
        ..show(args, record)
    };
    let mut resident = Resident::start();
    let say = |text: String| if args.json { Ok(()) } else { output::line(text) };
    let mut guard = None;
    let open = || match tool.take() {
        Some(tool) => Ok(Box::new(tool) as Box<dyn Device>),
        None => {
            let (device, status) = open_device(args, organs[0], profile.as_ref(), &stop)?;
            guard = status;
            Ok(if args.motors_off { Box::new(MotorsOff::new(device)) } else { device })
        }
    };
    let (mut ready, mut unsent) = (None, motors_off::Lines::default());
    let touched = touch::run(&organs, method, show, &stop, open, |record| {
        ready.get_or_insert_with(|| begun.elapsed());
        if args.motors_off {
            unsent.take(record);
        }
        resident.take(record);
    })?;
    let resident = resident.end();
    let bytes = files.iter().map(|file| file.bytes().len()).sum::<usize>();
    if args.json {
        let figures = json!({
            "blobs": paths, "blob_bytes": bytes, "method": method.name(), "session": summary::session(&touched.summary, touched.frames),
            "profile": profile.as_ref().map(|profile| summary::profile(profile, &touched.summary.latency)),
            "guard": guard.as_ref().map(ToString::to_string), "start_s": ready.map(|ready| ready.as_secs_f64()), "memory_kb": resident.figures(),
            "recording": args.record.as_ref().zip(touched.recording.as_ref()).map(|(path, report)| json!({
                "file": path, "ticks": report.ticks, "dropped": report.dropped,
                "error": report.error.as_ref().map(ToString::to_string),
            })),
        });
        output::line(format!("{figures:#}"))?;
    }
    say(summary::headline(&touched.summary))?;
    say(format!("\nmethod       {}\n{}", method.name(), touched.text()))?;
    if let Some(guard) = &guard {
        say(format!("guard        {guard}"))?;
    }
    if let Some(profile) = &profile {
        say(format!("profile      {}: {}", profile.name, profile.verdict(&touched.summary.latency)))?;
    }
    if let Some(ready) = ready {
        let (seconds, megabytes) = (ready.as_secs_f64(), bytes as f64 * 1e-6);
        say(format!("start        {seconds:.2} s from {megabytes:.1} MB to the first tick"))?;
    }
    say(resident.to_string())?;
    if args.verbose && !args.json {
        output::line(format!("\n{}", touched.summary.latency.histograms.bars()))?;
        print_misses(&touched.summary.latency.worst)?;
    }
    if let Some(file) = &outputs.histograms {
        output::histograms(file, &touched.summary.latency)?;
        say(format!("histograms   {}", file.path().display()))?;
    }
    if let (Some(path), Some(report)) = (&args.record, &touched.recording) {
        let (path, ticks, dropped) = (path.display(), report.ticks, report.dropped);
        say(format!("recording    {path}: {ticks} ticks, {dropped} more dropped while writing"))?;
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
        friction: args.friction,
        change_every: args.change_every,
        profile: None,
        rate_hz: args.frame_rate,
        timing: args.timing,
        mouse: None,
        has_motors: args.device.hardware().is_some(),
        control: None,
        regions: None,
    }
}

/// Replays a recording on its blob. It needs no certificate, because the forces drive no device.
fn run_replay(
    args: &Args,
    organs: &[&Organ<'_>],
    blob_blake3: &[String],
    path: &Path,
) -> Result<(), Failure> {
    if args.record.is_some() || args.seconds.is_some() || args.profile.is_some() {
        return Err(Failure::input(
            "a replay is as long as its recording, has its limits, and is not recorded again: leave --seconds, --profile and \
             --record out",
        ));
    }
    if args.control.is_some() {
        return Err(Failure::input("a replay moves no motors: leave --control out"));
    }
    if args.histograms.is_some() {
        return Err(Failure::input("a replay has no timing of its own: leave --histograms out"));
    }
    let stop = stop_flag()?;
    let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let source = File::open(path).map_err(|error| Failure::file(path, &error))?;
    let mut recording =
        Recording::open(BufReader::new(source)).map_err(|error| Failure::input(named(&error)))?;
    replay::check_blobs(recording.header(), blob_blake3).map_err(|error| Failure::input(named(&error)))?;
    let regions = args.scene.as_ref().map(|scene| regions::of_scene(scene, organs)).transpose()?;
    let show = touch::Show { regions: regions.as_ref(), ..show(args, None) };
    let recorded = &recording.header().config;
    let method = args.method.map_or(recorded.method_name(), Method::name);
    let had_folder = show.pictures.exists();
    let mut screen = show.screen(organs, method)?;
    let pace = match screen.interval() {
        None => Pace::Unseen,
        Some(_) if screen.is_window() => Pace::RealTime,
        Some(interval) => Pace::Recorded(interval),
    };
    let replayed = replay::replay(organs, blob_blake3, &mut recording, args.method, &stop, &mut screen, pace);
    if let Err(ReplayError::Model(_)) = &replayed {
        show.discard(had_folder);
    }
    let frames = screen.finish();
    let summary = replayed.map_err(|error| Failure::input(named(&error)))?;
    let frames = frames.map_err(|error| show.screen_failure(error))?;
    if args.json {
        let figures =
            json!({ "blob": args.blob, "recording": path, "replay": summary::replay(&summary, frames) });
        output::line(format!("{figures:#}"))?;
    } else {
        let text = touch::with_frames(&summary, frames);
        output::line(format!("method       {}\n{text}", summary.method_name()))?;
    }
    if summary.method == summary.recorded_method && summary.different > 0 {
        return Err(Failure::work(named(&format!("{} of its ticks differ", summary.different))));
    }
    if summary.ticks == 0 && !summary.is_stopped {
        return Err(Failure::work(named(&"contains no tick to replay")));
    }
    if summary.lost > 0 {
        return Err(Failure::work(named(&"records are missing, so only a part was replayed")));
    }
    Ok(())
}

/// Refuses a blob without a certificate of this method, or whose certificate has no position away from branch
/// jumps, unless it may be uncertified. A blob of red or unknown numerical health never drives motors.
fn check_certificate(path: &Path, organ: &Organ<'_>, method: Method, args: &Args) -> Result<(), Failure> {
    let path_name = path.display();
    let drives_motors = args.device.hardware().is_some() && !args.motors_off;
    let Some(certificate) = certificate::of(path, organ)? else {
        if args.uncertified && drives_motors {
            return Err(unknown_health(&path_name));
        }
        if args.uncertified {
            return Ok(());
        }
        return Err(Failure::input(format!(
            "{path_name}: has no certificate, so the error of its forces is unknown; pack it without \
             --no-certificate, or run it with --uncertified"
        )));
    };
    for space in &certificate.spaces {
        let measured = space.methods.iter().find(|m| m.method == method.name());
        if measured.is_none_or(|m| m.uniform.count == 0) && !args.uncertified {
            return Err(Failure::input(format!(
                "{path_name}: its certificate has no position of {} away from branch jumps for {}, so the error of its forces is unknown; pack it \
                 with --uniform 299, on a finer grid or a smaller radius, or run it with --uncertified",
                space.active,
                method.name()
            )));
        }
        if space.health.is_none() && drives_motors {
            return Err(unknown_health(&path_name));
        }
        let health = space.health.as_ref().filter(|health| health.verdict == Verdict::Red);
        if let Some(health) = health {
            let reason = health.reasons.first().map_or("no reason is stated", |reason| reason.what.as_str());
            let what = format!("{path_name}: {} is red: {reason}", space.active);
            if drives_motors {
                return Err(Failure::input(format!(
                    "{what}; a red blob drives no motors: pack a sound one, or look at it with --motors-off or --device sim"
                )));
            }
            eprintln!("palpate: warning: {what}");
        }
    }
    Ok(())
}

/// The health of a blob is measured when it is packed.
fn unknown_health(path: &impl std::fmt::Display) -> Failure {
    Failure::input(format!(
        "{path}: its certificate does not state whether it is numerically sound, so it drives no motors: pack it without \
         --no-certificate, or look at it with --motors-off or --device sim"
    ))
}
