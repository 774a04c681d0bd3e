//! Makes the sections, each at most once: what is finished is kept in DIR/work.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use palpate_precompute::pipeline::Run;
use palpate_precompute::scene::{PULP, Scene};
use palpate_precompute::space::solver_version;

use super::figures::Section;
use super::organs::{Amount, Ready, Rooms};
use super::questions::{Questions, VERSION};
use super::run::{Context, WORK};
use super::scenes::{self, ORGANS};
use super::stated::SYSTEM;
use super::{cost, first_touch, forces, interrupted, nodule, table_kind, ticks, zwidth};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Folder, Output};
use crate::machine::{self, Ticks};
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
const SECONDS: [[f64; 2]; 8] =
    [[50.0, 8.0], [3.0, 2.0], [8.0, 3.0], [4.0, 3.0], [45.0, 25.0], [20.0, 20.0], [60.0, 12.0], [20.0, 2.0]];

/// Scenes of the assets that a section uses.
fn scenes_of(key: &str) -> Vec<&'static str> {
    let organs = ORGANS.iter().map(|organ| organ.from);
    match key {
        nodule::KEY => vec![nodule::SCENE],
        first_touch::KEY => organs.chain(first_touch::SCENES).collect(),
        _ => organs.collect(),
    }
}

/// Folders, organs and the state of a run.
pub(super) struct Workshop<'s> {
    rooms: Rooms,
    /// Of the organs.
    folders: Vec<Folder>,
    nodules: [Folder; 2],
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
        let work = files.folder("--out", &out.path().join(WORK), |name| match name.rsplit_once('.')?.1 {
            "blob" => Some(FileKind::Blob),
            "space" => Some(FileKind::Space),
            "json" => Some(FileKind::Json),
            _ => None,
        })?;
        let mut folder = |name| files.folder("--out", &questions.path().join(name), table_kind);
        let folders =
            ORGANS.iter().map(|organ| organ.name).map(&mut folder).collect::<Result<Vec<_>, _>>()?;
        let [with, without] = nodule::FOLDERS.map(folder);
        let nodules = [with?, without?];
        Ok(Self {
            nodules,
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
            nodule::write_scenes(&self.assets, &self.nodules)?;
            let tip = ready.iter().find_map(|one| one.analysis.scene.tool.fingertip());
            let readme = scenes::readme(tip.copied().unwrap_or(PULP));
            self.rooms.questions.file("README.txt").put(readme.as_bytes())?;
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
        let names = ORGANS.iter().map(|organ| organ.name).chain(nodule::FOLDERS);
        let all = self.folders.iter().chain(&self.nodules).zip(names);
        copied.extend(all.map(|(from, name)| (from.path().to_path_buf(), to.join(name))));
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
        let (file, made_for) = self.kept_in(key)?;
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
        let measure = || {
            let before = Ticks::now();
            let section = self.measure(key)?;
            let others_share = before.and_then(Ticks::others_since);
            Ok(Section { others_share, ..section })
        };
        kept(&file, made_for, measure).map_err(is_stopped)
    }

    /// File of a section, and what it must have been made for: amount, program, processor, and the content of its scenes.
    fn kept_in(&self, key: &str) -> Result<(Output, String), Failure> {
        let quick = u8::from(self.context.quick);
        let mut made_for =
            format!("{VERSION} {quick} {} {} {}", env!("PALPATE_COMMIT"), solver_version(), machine::cpu());
        for scene in scenes_of(key) {
            let path = self.assets.join(scene);
            if !path.is_file() {
                return Err(Failure::input(format!(
                    "{}: no such file; give the folder of the bundled scenes with --assets",
                    path.display()
                )));
            }
            let hash = Scene::load(&path)?.resolve()?.content_hash().to_string();
            made_for += &format!(" {}", hash.get(..16).unwrap_or(&hash));
        }
        Ok((self.rooms.work.file(&format!("section-{key}.json")), made_for))
    }

    /// A finished section of an earlier run.
    pub(super) fn stored(&self, key: &str) -> Option<Section> {
        let (file, made_for) = self.kept_in(key).ok()?;
        stored(&file, &made_for)
    }

    fn measure(&mut self, key: &str) -> Result<Section, Failure> {
        let (context, assets, answers) = (self.context, self.assets.clone(), self.answers.clone());
        match key {
            cost::KEY => cost::section(self.organs()?, &context),
            zwidth::KEY => zwidth::section(&self.organs()?[0], &context),
            nodule::KEY => {
                nodule::write_scenes(&assets, &self.nodules)?;
                nodule::section(&self.nodules, &self.rooms.work, &context)
            }
            first_touch::KEY => first_touch::section(&assets, self.organs()?, &context),
            ticks::KEY => ticks::section(self.organs()?, &context),
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::files::Replace;

    #[test]
    fn a_section_that_other_assets_gave_is_measured_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let (bundled, assets) =
            (Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets"), folder.path().join("a"));
        std::fs::create_dir_all(assets.join("scenes")).expect("a folder");
        for name in ["liver-small.toml", "liver-small.msh", "scenes/palpation.toml"] {
            std::fs::copy(bundled.join(name), assets.join(name)).expect("copied");
        }
        let stop = AtomicBool::new(false);
        let mut files = Files::new(Replace::default());
        let out = files.folder("--out", &folder.path().join("out"), |_| None).expect("a folder");
        let context = Context { quick: true, threads: 1, stop: &stop };
        let workshop = Workshop::open(&mut files, &out, &assets, context).expect("open");
        let section = super::super::run::finished(&context, forces::FORCE, "", &[], &[], 0.0, vec![]);
        let (file, made_for) = workshop.kept_in(forces::FORCE).expect("the scenes are there");
        kept(&file, made_for, || Ok(section)).expect("kept");
        let edit = |name: &str, from: &str, to: &str| {
            let text = std::fs::read_to_string(assets.join(name)).expect("text");
            assert!(text.contains(from), "{name}: {from}");
            std::fs::write(assets.join(name), text.replacen(from, to, 1)).expect("written");
        };
        edit("liver-small.toml", "name = ", "# A comment changes nothing.\nname = ");
        assert!(workshop.stored(forces::FORCE).is_some());
        edit("scenes/palpation.toml", "c10_pa = 1300.0", "c10_pa = 1301.0");
        assert!(workshop.stored(forces::FORCE).is_none(), "another material");
        edit("scenes/palpation.toml", "c10_pa = 1301.0", "c10_pa = 1300.0");
        assert!(workshop.stored(forces::FORCE).is_some());
        std::fs::remove_file(assets.join("scenes/palpation.toml")).expect("removed");
        let line = workshop.kept_in(forces::FORCE).map(drop).expect_err("no scene").line();
        assert!(line.contains("palpation.toml") && line.contains("--assets"), "{line}");
    }
}
