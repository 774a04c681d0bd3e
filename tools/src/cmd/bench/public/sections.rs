//! Makes the sections, each at most once: what is finished is kept in DIR/work.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use palpate_precompute::pipeline::Run;
use palpate_precompute::space::solver_version;

use super::answers::SYSTEM;
use super::figures::Section;
use super::organs::{Amount, Ready, Rooms};
use super::questions::{Questions, VERSION};
use super::run::Context;
use super::scenes::{self, ORGANS};
use super::{cost, first_touch, forces, interrupted, nodule, table_kind, ticks, zwidth};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Folder, Output};
use crate::steps::{kept, stored};

/// All sections in the order of the page.
pub(super) const KEYS: [&str; 8] = [
    forces::FORCE,
    forces::HANDS,
    forces::ENERGY,
    cost::KEY,
    zwidth::KEY,
    nodule::KEY,
    first_touch::KEY,
    ticks::KEY,
];
/// Seconds of each on two cores, in full and quick, with the preparation of the organs in the first.
const SECONDS: [[f64; 2]; 8] = [
    [120.0, 20.0],
    [10.0, 6.0],
    [30.0, 6.0],
    [8.0, 5.0],
    [40.0, 15.0],
    [5.0, 5.0],
    [65.0, 12.0],
    [15.0, 2.0],
];

/// Folders, organs and the state of a run.
pub(super) struct Workshop<'s> {
    rooms: Rooms,
    folders: Vec<Folder>,
    assets: PathBuf,
    context: Context<'s>,
    answers: PathBuf,
    ready: Option<Vec<Ready>>,
    began: Instant,
}

impl<'s> Workshop<'s> {
    /// Checks and creates the folders.
    pub(super) fn open(
        files: &mut Files,
        out: &Folder,
        assets: &Path,
        context: Context<'s>,
    ) -> Result<Self, Failure> {
        let questions = files.folder("--out", &out.path().join("questions"), table_kind)?;
        let work =
            files.folder("--out", &out.path().join("work"), |name| match name.rsplit_once('.')?.1 {
                "blob" => Some(FileKind::Blob),
                "space" => Some(FileKind::Space),
                "json" => Some(FileKind::Json),
                _ => None,
            })?;
        let folder = |name| files.folder("--out", &questions.path().join(name), table_kind);
        let folders = ORGANS.iter().map(|organ| organ.name).map(folder).collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            folders,
            rooms: Rooms { questions, work },
            assets: assets.to_path_buf(),
            context,
            answers: out.path().join("answers"),
            ready: None,
            began: Instant::now(),
        })
    }

    /// The organs; solved on the first call.
    fn organs(&mut self) -> Result<&[Ready], Failure> {
        if self.ready.is_none() {
            self.rooms.questions.file("README.txt").put(scenes::readme().as_bytes())?;
            let run = Run { threads: self.context.threads, stop: self.context.stop };
            let mut ready = Vec::new();
            for (scene, folder) in ORGANS.iter().zip(&self.folders) {
                self.context.go_on()?;
                scene.write(&self.assets, folder, self.context.quick)?;
                let amount = Amount::of(self.context.quick);
                let one = Ready::prepare(scene, &self.rooms, folder, amount, run)?;
                scenes::write_body(&one.analysis.scene, folder)?;
                ready.push(one);
            }
            self.ready = Some(ready);
        }
        Ok(self.ready.as_deref().unwrap_or_default())
    }

    /// The questions about all organs.
    pub(super) fn questions(&mut self) -> Result<Vec<&Questions>, Failure> {
        Ok(self.organs()?.iter().map(|ready| &ready.questions).collect())
    }

    /// Copies the questions to another folder; returns the number of organs.
    pub(super) fn copy_questions(&mut self, files: &mut Files, to: &Path) -> Result<usize, Failure> {
        let count = self.organs()?.len();
        let mut copied = vec![(self.rooms.questions.path().to_path_buf(), to.to_path_buf())];
        copied.extend(
            self.folders
                .iter()
                .zip(&ORGANS)
                .map(|(from, organ)| (from.path().to_path_buf(), to.join(organ.name))),
        );
        for (from, to) in copied {
            let folder = files.folder("--questions", &to, table_kind)?;
            let entries = std::fs::read_dir(&from).map_err(|error| Failure::file(&from, &error))?;
            for path in entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_file()) {
                let bytes = std::fs::read(&path).map_err(|error| Failure::file(&path, &error))?;
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                folder.file(&name).put(&bytes)?;
            }
        }
        Ok(count)
    }

    /// A section, measured or from the run before. `left` has it and those that follow.
    pub(super) fn section(&mut self, key: &str, again: bool, left: &[&str]) -> Result<Section, Failure> {
        self.context.go_on()?;
        let quick = usize::from(self.context.quick);
        let seconds_of = |keys: &[&str]| -> f64 {
            KEYS.iter().zip(SECONDS).filter(|(one, _)| keys.contains(one)).map(|(_, s)| s[quick]).sum()
        };
        let (file, made_for) = self.kept_in(key);
        if again {
            // A file that is not there is as good as a removed one.
            let _ = std::fs::remove_file(file.path());
        }
        if let Some(section) = stored(&file, &made_for) {
            eprintln!("palpate: section {key} is finished; --again measures it again");
            return Ok(section);
        }
        eprintln!(
            "palpate: section {key} ({} left with it), about {:.0} s left on two cores, {:.0} s elapsed",
            left.len(),
            seconds_of(left),
            self.began.elapsed().as_secs_f64()
        );
        let stop = self.context.stop;
        // A solve that Ctrl-C ends reports it in words of its own.
        let is_stopped = |failure| if stop.load(Ordering::Relaxed) { interrupted() } else { failure };
        kept(&file, made_for, || self.measure(key)).map_err(is_stopped)
    }

    /// File of a section, and what it must have been made for.
    fn kept_in(&self, key: &str) -> (Output, String) {
        let quick = u8::from(self.context.quick);
        let made_for = format!("{VERSION} {quick} {} {}", env!("CARGO_PKG_VERSION"), solver_version());
        (self.rooms.work.file(&format!("section-{key}.json")), made_for)
    }

    /// A finished section of an earlier run.
    pub(super) fn stored(&self, key: &str) -> Option<Section> {
        let (file, made_for) = self.kept_in(key);
        stored(&file, &made_for)
    }

    fn measure(&mut self, key: &str) -> Result<Section, Failure> {
        let (context, assets, answers) = (self.context, self.assets.clone(), self.answers.clone());
        match key {
            cost::KEY => cost::section(self.organs()?, &context),
            zwidth::KEY => zwidth::section(&self.organs()?[0].organ()?, &context),
            nodule::KEY => nodule::section(&assets, &context),
            first_touch::KEY => first_touch::section(&assets, self.organs()?, &context),
            ticks::KEY => ticks::section(&self.organs()?[0], &context),
            _ => forces::section(key, self.organs()?, &context, |ready, ours| keep(&answers, ready, ours)),
        }
    }
}

/// Stores the own answers as those of another system are.
fn keep(answers: &Path, ready: &Ready, ours: &forces::Ours) -> Result<(), Failure> {
    let mut files = Files::new(crate::files::Replace::default());
    for (name, forces) in &ours.systems {
        let own = files.folder("--out", &answers.join(name), table_kind)?;
        let folder = files.folder("--out", &own.path().join(ready.scene.name), table_kind)?;
        forces.write(&ready.questions, &folder)?;
        let about = format!("about = \"Palpate {}, {name}\"\n", env!("CARGO_PKG_VERSION"));
        own.file(SYSTEM).put(about.as_bytes())?;
    }
    Ok(())
}
