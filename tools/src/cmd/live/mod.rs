//! `palpate live`: touch at once; the forces are solved beside the loop.

mod certificate;
mod check;
mod keep;
mod knobs;
mod second;
mod visits;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::{BlobError, Limits, Organ};
use palpate_host::BlobFile;
use palpate_host::device::profile::Profile;
use palpate_host::live::{self as host_live, LiveField, Ready, StartError};
use palpate_precompute::scene::Scene;
use serde_json::{Map, json};

use super::live_solver::scene;
use crate::control::Control;
use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::files::{Files, Output};
use crate::interrupt::{restart, stop_flag};
use crate::machine::Ticks;
use crate::session::{self, Figures, Opener, Outputs, Replay, SessionArgs, Watcher};
use crate::touch::{self, LiveSource, Source, Touched};
use certificate::Certificate;
use check::Checked;
pub(crate) use check::Compared;
use keep::Kept;
use knobs::{Knobs, Turned};
use second::{Report, SecondArgs, linked};
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
    /// Afterwards solve the visited contacts to the full tolerance into this new file
    ///
    /// Adaptive sampling solves the visited positions first, then those that it needs. Ctrl-C ends it; `palpate
    /// precompute FILE.space` continues. `palpate pack` makes a blob of it.
    #[arg(long, value_name = "FILE.space")]
    keep: Option<PathBuf>,
    /// Begin with the tables of this blob of the same model
    ///
    /// What it holds is not solved again. Contacts that are no vertices of the skin are left out.
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
    second: SecondArgs,
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
    if let DeviceSpec::Replay { file } = &args.session.device {
        return replay(args, file);
    }
    let mut ended = session(args)?;
    let mut of = Map::new();
    of.insert("scene".into(), json!(args.scene));
    of.insert("live".into(), json!(ended.certificate));
    of.insert("kept".into(), json!(ended.kept));
    if let Some(second) = &ended.second {
        of.insert("second".into(), second.json());
    }
    let mut lines = ended.certificate.lines();
    if let (Some(kept), Some(file)) = (&ended.kept, &args.keep) {
        lines.extend(kept.lines(file));
    }
    let figures = Figures {
        of,
        method: "jets",
        bytes: ended.organ_bytes,
        guard: ended.guard.take(),
        profile: ended.profile.as_ref(),
        lines,
    };
    figures.print(&args.session, &ended.outputs, &ended.touched, ended.watcher)?;
    if let Some(second) = ended.second.as_ref().filter(|_| !args.session.json) {
        second.print()?;
    }
    touch::judge(&ended.touched.summary)?;
    ended.second.as_ref().map_or(Ok(()), Report::judge)
}

/// A session that has ended, with what was found out about it.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) touched: Touched,
    pub(crate) certificate: Certificate,
    pub(crate) checked: Checked,
    kept: Option<Kept>,
    organ_bytes: usize,
    guard: Option<String>,
    profile: Option<Profile>,
    outputs: Outputs,
    watcher: Watcher,
    second: Option<Report>,
}

impl Args {
    /// A session of a simulated hand with a check of `check` positions.
    pub(crate) fn checked(scene: &Path, seconds: f64, pictures: &Path, headless: bool, check: usize) -> Self {
        let session = SessionArgs::of_simulated_hand(seconds, pictures, headless);
        let second = SecondArgs::default();
        Self { scene: scene.into(), check, keep: None, blob: None, set: Vec::new(), second, session }
    }

    /// The files that the session writes. The first model has these values.
    fn outputs(&self, start: &[String]) -> Result<(Outputs, Option<Output>), Failure> {
        self.session.check()?;
        let mut files = Files::new(self.session.replace);
        files.read(&self.scene);
        self.blob.iter().for_each(|blob| files.read(blob));
        let keep = self.keep.as_ref().map(|path| {
            let scene = scene(&self.scene, start)?;
            scene.files().iter().for_each(|file| files.read(file));
            keep::output(&mut files, path, &scene)
        });
        Ok((self.session.outputs(files)?, keep.transpose()?))
    }

    /// Starts the solver, and waits until the body is at rest.
    fn start(&self, settings: &[String], stop: &AtomicBool) -> Result<Ready, Failure> {
        let mut command = Command::new(std::env::current_exe().map_err(Failure::work)?);
        command.arg("live-solver").arg(&self.scene);
        for (option, value) in settings
            .iter()
            .map(|setting| ("--set", OsStr::new(setting)))
            .chain(self.blob.iter().map(|blob| ("--blob", blob.as_os_str())))
        {
            command.arg(option).arg(value);
        }
        host_live::start(command, stop, |line| eprintln!("palpate: {line}")).map_err(|error| match error {
            StartError::Refused(line) => Failure::input(line),
            other => Failure::work(other),
        })
    }
}

/// Touches the scene, then solves what is asked for about the touch.
pub(crate) fn session(args: &Args) -> Result<Ended, Failure> {
    let begun = Instant::now();
    let mut knobs = Knobs::of(&args.set)?;
    let start: Vec<String> = knobs.settings().collect();
    let (outputs, keep) = args.outputs(&start)?;
    let profile = session::profile(&args.session)?;
    let stop = stop_flag()?;
    let (link, mut other) = args.other(&start, &stop)?;
    let Ready { blob, for_loop, view, process } = args.start(&start, &stop)?;
    let organ = organ(&blob).map_err(|error| Failure::work(format!("{}: {error}", args.scene.display())))?;
    if args.check > 0 && organ.tool.sphere().is_some() && args.session.friction.is_some_and(|mu| mu > 0.0) {
        let line = "--check solves without the friction of a sphere: leave out --friction or --check";
        return Err(Failure::input(line));
    }
    let control = &args.session.control;
    let control = control.as_ref().map(|path| Control::start(path, Arc::clone(&stop))).transpose()?;
    let jets = LiveField::new(linked(for_loop, link)).map_err(Failure::work)?;
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
    other.wait(&stop)?;
    let mut watcher = Watcher::new(&args.session, begun);
    let mut visits = Visits::new(args.check > 0 || keep.is_some(), organ.tool.half_axis_m());
    let mut guard = None;
    let open = || {
        let (device, status) = device.open(&organ)?;
        guard = status;
        other.opened();
        Ok(device)
    };
    let before = Ticks::now();
    let touched = touch::run(&[&*organ], source, show, &stop, open, |record| {
        watcher.take(record);
        visits.take(record, knobs.changes());
    })?;
    let others_share = before.and_then(Ticks::others_since);
    other.end_loop();
    let counters = meter.counters();
    let model = Model { scene: &args.scene, start, changes: knobs.end() };
    restart(&stop);
    let checked = Checked::of(&model, &visits.kept, args.check, &stop)?;
    let certificate =
        Certificate::new(&visits, &checked, &touched.summary, counters, watcher.ready(), others_share);
    restart(&stop);
    let second = other.end(args, &stop)?;
    restart(&stop);
    let kept = keep.map(|file| Kept::of(&model, &organ, &visits.kept, &file, &stop)).transpose()?.flatten();
    Ok(Ended {
        touched,
        certificate,
        checked,
        kept,
        organ_bytes: blob.bytes().len(),
        guard: guard.as_ref().map(ToString::to_string),
        profile,
        outputs,
        watcher,
        second,
    })
}

/// Replays a live recording on the organ that it holds.
fn replay(args: &Args, path: &Path) -> Result<(), Failure> {
    args.outputs(&args.set)?;
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
