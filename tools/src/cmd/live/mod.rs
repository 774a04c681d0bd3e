//! `palpate live`: touch at once; the forces are solved beside the loop.

mod certificate;
mod check;
mod keep;
mod knobs;
mod visits;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::{BlobError, Limits, Organ};
use palpate_host::BlobFile;
use palpate_host::live::{self as host_live, LiveField, StartError};
use palpate_precompute::scene::Scene;
use serde_json::{Map, json};

use super::live_solver::scene;
use crate::control::Control;
use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::files::Files;
use crate::interrupt::{restart, stop_flag};
use crate::session::{self, Figures, Opener, Replay, SessionArgs, Watcher};
use crate::touch::{self, LiveSource, Source};
use certificate::Certificate;
use check::Checked;
use keep::Kept;
use knobs::{Knobs, Turned};
use visits::Visits;

/// Number of contacts of a live session.
const CONTACTS: usize = Limits::LIVE.spaces;

/// Touch a scene at once: a solver beside the loop follows the hand
///
/// Nothing is precomputed. Every free vertex of the skin can be touched. A second process solves the finite-element model where the hand
/// is and where it goes; the loop interpolates between what is solved. Where the solver lags, the force levels off
/// and then fades, and the window says so.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The scene, a .toml file
    scene: PathBuf,
    /// Solve N visited positions afterwards and report the error of the felt force; 0 for none
    #[arg(long, value_name = "N", default_value_t = 0)]
    check: usize,
    /// Afterwards solve the visited contacts to the full tolerance into this file, which must not exist
    ///
    /// Adaptive sampling solves the visited positions first, then those that it needs. Ctrl-C ends it; `palpate
    /// precompute FILE.space` continues. `palpate pack` makes a blob of it.
    #[arg(long, value_name = "FILE.space")]
    keep: Option<PathBuf>,
    /// Begin with the tables of this blob of the same model: what it holds is not solved again
    #[arg(long, value_name = "FILE.blob")]
    blob: Option<PathBuf>,
    /// Change a value of the scene, for example material.c10_pa=2600 or fixed.group=F2
    ///
    /// With several values for a key, the keys 1 to 9 of the window go from one to the next. The scene file is not
    /// changed. `palpate control SOCKET set KEY=VALUE` changes one while the session runs. The
    /// touch goes on: the solver continues from the states at hand, and the force changes over within a fraction of
    /// a second. Of several materials one is meant by its group: material.GROUP.c10_pa.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    session: SessionArgs,
}

/// The models of a session: the scene, its values at the start, and its changes in their order.
#[derive(Debug)]
struct Model<'a> {
    scene: &'a Path,
    start: Vec<String>,
    changes: Vec<String>,
}

impl Model<'_> {
    /// The settings after a number of changes.
    fn settings(&self, changes: usize) -> Vec<String> {
        self.start.iter().chain(&self.changes[..changes]).cloned().collect()
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let begun = Instant::now();
    args.session.check()?;
    let mut files = Files::new(args.session.replace);
    files.read(&args.scene);
    args.blob.iter().for_each(|blob| files.read(blob));
    let mut knobs = Knobs::of(&args.set)?;
    let start: Vec<String> = knobs.settings().collect();
    let keep = args.keep.as_ref().map(|path| {
        let scene = scene(&args.scene, &start)?;
        scene.files().iter().for_each(|file| files.read(file));
        keep::output(&mut files, path, &scene)
    });
    let keep = keep.transpose()?;
    let outputs = args.session.outputs(files)?;
    if let DeviceSpec::Replay { file } = &args.session.device {
        return replay(args, file);
    }
    let profile = session::profile(&args.session)?;
    let stop = stop_flag()?;
    let mut command = Command::new(std::env::current_exe().map_err(Failure::work)?);
    command.arg("live-solver").arg(&args.scene);
    args.blob.iter().for_each(|blob| {
        command.arg("--blob").arg(blob);
    });
    knobs.settings().for_each(|setting| {
        command.arg("--set").arg(setting);
    });
    let started = host_live::start(command, &stop, |line| eprintln!("palpate: {line}"));
    let host_live::Ready { blob, for_loop, view, process } = started.map_err(|error| match error {
        StartError::Refused(line) => Failure::input(line),
        other => Failure::work(other),
    })?;
    let organ = organ(&blob).map_err(|error| Failure::work(format!("{}: {error}", args.scene.display())))?;
    let control = &args.session.control;
    let control = control.as_ref().map(|path| Control::start(path, Arc::clone(&stop))).transpose()?;
    let jets = LiveField::new(for_loop).map_err(Failure::work)?;
    let meter = view.meter();
    let source = Source::Jets(Box::new(LiveSource { jets, view }));
    let device = Opener::new(&args.session, &organ, profile.as_ref(), &stop)?;
    let mouse = device.mouse.clone();
    let blob_blake3 = [blob.blake3()];
    let record = outputs.record.as_ref();
    let record =
        record.map(|file| touch::Record { file, blob_blake3: &blob_blake3, live: Some(blob.bytes()) });
    knobs.drive(process);
    let knobs = Turned::new(knobs, control.as_ref());
    let show = touch::Show {
        profile: profile.as_ref(),
        mouse: mouse.as_ref(),
        control: control.as_ref(),
        between: Some(&knobs),
        ..args.session.show(record)
    };
    let mut watcher = Watcher::new(&args.session, begun);
    let mut visits = Visits::new(args.check > 0 || keep.is_some());
    let mut guard = None;
    let open = || {
        let (device, status) = device.open(&organ)?;
        guard = status;
        Ok(device)
    };
    let touched = touch::run(&[&*organ], source, show, &stop, open, |record| {
        watcher.take(record);
        visits.take(record, knobs.changes());
    })?;
    let counters = meter.counters();
    let model = Model { scene: &args.scene, start, changes: knobs.end() };
    restart(&stop);
    let visited = &visits.kept;
    let checked = match args.check {
        0 => Checked::default(),
        wanted => Checked::of(&model, visited, wanted, &stop)?,
    };
    let certificate = Certificate::new(&visits, &checked, &touched.summary, counters, watcher.ready());
    restart(&stop);
    let kept =
        keep.as_ref().map(|file| Kept::of(&model, &organ, visited, file, &stop)).transpose()?.flatten();
    let mut lines = certificate.lines();
    if let (Some(kept), Some(file)) = (&kept, &args.keep) {
        lines.extend(kept.lines(file));
    }
    let mut of = Map::new();
    of.insert("scene".into(), json!(args.scene));
    of.insert("live".into(), json!(certificate));
    of.insert("kept".into(), json!(kept));
    let figures = Figures {
        of,
        method: "jets",
        bytes: blob.bytes().len(),
        guard: guard.as_ref().map(ToString::to_string),
        profile: profile.as_ref(),
        lines,
    };
    figures.print(&args.session, &outputs, &touched, watcher)?;
    touch::judge(&touched.summary)
}

/// Replays a live recording on the organ that it holds.
fn replay(args: &Args, path: &Path) -> Result<(), Failure> {
    let replay = Replay::open(&args.session, path)?;
    let named = |what: &str| Failure::input(format!("{}: {what}", path.display()));
    let blob = replay.organ().ok_or_else(|| {
        named("is not of a live session; replay it with `palpate run BLOB --device replay:FILE`")
    })?;
    // The recording gives its jets one by one, so the organ is read from a copy.
    let blob = BlobFile::of(blob.bytes());
    let organ = organ(&blob).map_err(|error| named(&error.to_string()))?;
    let scene = Scene::load(&args.scene)?.name();
    if organ.scene.as_str() != scene {
        return Err(named(&format!("is of the scene {}, not of {scene}", organ.scene)));
    }
    replay.run(&[&*organ], &[blob.blake3()], None, None, json!({ "scene": args.scene }))
}

/// The organ of a live session.
fn organ(blob: &BlobFile) -> Result<Box<Organ<'_, CONTACTS>>, BlobError> {
    Organ::read_boxed(blob.bytes())
}
