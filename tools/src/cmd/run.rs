//! `palpate run`: the 1 kHz loop on blobs and a device, or the replay of a recording of one.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::{MAX_SEPARATE_NODES, SpaceCertificate, Verdict};
use serde_json::{Map, json};

use super::inspect::certificate;
use super::pack::method;
use crate::control::Control;
use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::files::Files;
use crate::interrupt::stop_flag;
use crate::session::{Figures, Opener, Outputs, Replay, SessionArgs, Watcher};
use crate::touch::Source;
use crate::{blob, regions, session, touch};

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
    /// Interpolation method; the blob's most accurate if not given
    ///
    /// The first that the blob holds of energy, kernel, hermite, tricubic, rbf-cubic, rbf-linear, hybrid,
    /// trilinear.
    #[arg(long, value_name = "M", value_parser = method)]
    method: Option<Method>,
    /// Run a blob that has no certificate
    ///
    /// The error of its forces against finite elements is unknown. A red blob drives no motors in any case.
    #[arg(long)]
    uncertified: bool,
    /// The scene of the blob: the side view shows its inclusions, where the skin round them moves them
    #[arg(long, value_name = "SCENE.toml", hide_short_help = true, help_heading = "Pictures")]
    scene: Option<PathBuf>,
    /// Change to the next of several blobs every S seconds
    #[arg(long, value_name = "S", value_parser = seconds, hide_short_help = true, help_heading = "Contact")]
    change_every: Option<Duration>,
    #[command(flatten)]
    session: SessionArgs,
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: Option<f64> = text.parse().ok().filter(|seconds| *seconds >= 0.01);
    seconds.and_then(|s| Duration::try_from_secs_f64(s).ok()).ok_or_else(|| "seconds, at least 0.01".into())
}

/// Refuses arguments that have no effect together.
fn check(args: &Args) -> Result<(), Failure> {
    args.session.check()?;
    if args.change_every.is_some() && args.more.is_empty() {
        return Err(Failure::input(
            "--change-every goes from one blob to the next, and there is only one: name another, or leave it out",
        ));
    }
    Ok(())
}

fn outputs(args: &Args) -> Result<Outputs, Failure> {
    let mut files = Files::new(args.session.replace);
    files.read(&args.blob);
    args.more.iter().for_each(|blob| files.read(blob));
    args.scene.iter().for_each(|scene| files.read(scene));
    args.session.outputs(files)
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let begun = Instant::now();
    check(args)?;
    let outputs = outputs(args)?;
    let paths: Vec<&PathBuf> = core::iter::once(&args.blob).chain(&args.more).collect();
    let files = paths.iter().map(|path| blob::load(path)).collect::<Result<Vec<_>, _>>()?;
    let each = || paths.iter().zip(&files);
    let organs = each().map(|(path, file)| blob::organ(path, file)).collect::<Result<Vec<_>, _>>()?;
    let organs: Vec<&Organ<'_>> = organs.iter().collect();
    let blob_blake3: Vec<String> = files.iter().map(BlobFile::blake3).collect();
    if let DeviceSpec::Replay { file } = &args.session.device {
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
    let record =
        outputs.record.as_ref().map(|file| touch::Record { file, blob_blake3: &blob_blake3, live: None });
    let profile = session::profile(&args.session)?;
    if organs.iter().all(|organ| organ.spaces.iter().all(|space| space.displacement().is_none())) {
        eprintln!(
            "palpate: no displacements in the blob ([needs] visual = false): the forces are correct, the picture shows the body at rest"
        );
    }
    let regions = args.scene.as_ref().map(|scene| regions::of_scene(scene, &organs)).transpose()?;
    let stop = stop_flag()?;
    let control = &args.session.control;
    let control = control.as_ref().map(|path| Control::start(path, Arc::clone(&stop))).transpose()?;
    let device = Opener::new(&args.session, organs[0], profile.as_ref(), &stop)?;
    let mouse = device.mouse.clone();
    let show = touch::Show {
        profile: profile.as_ref(),
        mouse: mouse.as_ref(),
        control: control.as_ref(),
        regions: regions.as_ref(),
        change_every: args.change_every,
        ..args.session.show(record)
    };
    let mut watcher = Watcher::new(&args.session, begun);
    let mut guard = None;
    let open = || {
        let (device, status) = device.open(organs[0])?;
        guard = status;
        Ok(device)
    };
    let touched =
        touch::run(&organs, Source::Tables(method), show, &stop, open, |record| watcher.take(record))?;
    let bytes = files.iter().map(|file| file.bytes().len()).sum::<usize>();
    let mut of = Map::new();
    of.insert("blobs".into(), json!(paths));
    of.insert("blob_bytes".into(), json!(bytes));
    let guard = guard.as_ref().map(ToString::to_string);
    let figures =
        Figures { of, method: method.name(), bytes, guard, profile: profile.as_ref(), lines: Vec::new() };
    figures.print(&args.session, &outputs, &touched, watcher)?;
    touch::judge(&touched.summary)
}

/// Replays a recording on its blobs.
fn run_replay(
    args: &Args,
    organs: &[&Organ<'_>],
    blob_blake3: &[String],
    path: &Path,
) -> Result<(), Failure> {
    let regions = args.scene.as_ref().map(|scene| regions::of_scene(scene, organs)).transpose()?;
    let recording = Replay::open(&args.session, path)?;
    let of = json!({ "blob": args.blob });
    recording.run(organs, blob_blake3, args.method, regions.as_ref(), of)
}

/// Refuses a blob without a certificate of this method, or whose certificate has no position away from branch
/// jumps, unless it may be uncertified. A blob of red or unknown numerical health never drives motors.
fn check_certificate(path: &Path, organ: &Organ<'_>, method: Method, args: &Args) -> Result<(), Failure> {
    let path_name = path.display();
    let drives_motors = args.session.device.hardware().is_some() && !args.session.motors_off;
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
    // Many nodes share their positions.
    let share = certificate.spaces.len() > MAX_SEPARATE_NODES;
    let is_measured = |space: &SpaceCertificate| {
        space.methods.iter().any(|m| m.method == method.name() && m.uniform.count > 0)
    };
    let is_shared = share && certificate.spaces.iter().any(is_measured);
    for space in &certificate.spaces {
        if !args.uncertified && !is_shared && !is_measured(space) {
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
    }
    let is_red = |space: &&SpaceCertificate| {
        space.health.as_ref().is_some_and(|health| health.verdict == Verdict::Red)
    };
    let mut red = certificate.spaces.iter().filter(is_red);
    if let Some(space) = red.next() {
        let reason = space.health.as_ref().and_then(|health| health.reasons.first());
        let reason = reason.map_or("no reason is stated", |reason| reason.what.as_str());
        let more = match red.count() {
            0 => " is".into(),
            more => format!(" and {more} more are"),
        };
        let what = format!("{path_name}: {}{more} red: {reason}", space.active);
        if drives_motors {
            return Err(Failure::input(format!(
                "{what}; a red blob drives no motors: pack a sound one, or look at it with --motors-off or --device sim"
            )));
        }
        eprintln!("palpate: warning: {what}");
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
