//! `palpate live`: touch at once; the forces are solved beside the loop.

mod certificate;
mod knobs;

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

use crate::control::Control;
use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::files::Files;
use crate::interrupt::stop_flag;
use crate::session::{self, Figures, Opener, Replay, SessionArgs, Watcher};
use crate::touch::{self, LiveSource, Source};
use certificate::Visits;
use knobs::{Knobs, Turned};

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

impl Args {
    /// The values at the start of the session.
    fn start(&self) -> Result<Vec<String>, Failure> {
        Ok(Knobs::of(&self.set)?.settings().collect())
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let begun = Instant::now();
    args.session.check()?;
    let mut files = Files::new(args.session.replace);
    files.read(&args.scene);
    let outputs = args.session.outputs(files)?;
    if let DeviceSpec::Replay { file } = &args.session.device {
        return replay(args, file);
    }
    let profile = session::profile(&args.session)?;
    let stop = stop_flag()?;
    let mut command = Command::new(std::env::current_exe().map_err(Failure::work)?);
    let mut knobs = Knobs::of(&args.set)?;
    command.arg("live-solver").arg(&args.scene);
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
    let mut visits = Visits::new(begun, args.check > 0);
    let mut guard = None;
    let open = || {
        let (device, status) = device.open(&organ)?;
        guard = status;
        Ok(device)
    };
    let touched = touch::run(&[&*organ], source, show, &stop, open, |record| {
        watcher.take(record);
        visits.take(record, knobs.have_changed());
    })?;
    let counters = meter.counters();
    drop(knobs);
    let certificate = visits.certificate(args, &touched.summary, counters)?;
    let mut of = Map::new();
    of.insert("scene".into(), json!(args.scene));
    of.insert("live".into(), json!(certificate));
    let figures = Figures {
        of,
        method: "jets",
        bytes: blob.bytes().len(),
        guard: guard.as_ref().map(ToString::to_string),
        profile: profile.as_ref(),
        lines: certificate.lines(),
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
