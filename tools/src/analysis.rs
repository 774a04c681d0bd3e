//! Loads scenes for the commands. Warnings go to standard error. Spaces are opened as checked outputs.

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use palpate_precompute::pipeline::{Analysis, PipelineError};
use palpate_precompute::scene::{ResolvedScene, Scene};
use palpate_precompute::space::Store;

use crate::failure::Failure;
use crate::files::{FileKind, Output};
use crate::interrupt::Beginning;
use crate::progress::WorkProgress;

/// Loads a scene, prints its warnings, builds its body and chooses its contact points.
pub(crate) fn load(path: &Path) -> Result<Analysis, Failure> {
    of_scene(path, Scene::load(path)?.resolve()?)
}

/// Whether a file is a `.space` file.
pub(crate) fn is_space(path: &Path) -> bool {
    path.is_file() && FileKind::of(path).is_ok_and(|kind| kind == FileKind::Space)
}

/// The scene and the body of a `.space` file.
pub(crate) fn of_space(path: &Path) -> Result<Analysis, Failure> {
    Ok(Analysis::of_store(&existing_space(path)?)?)
}

/// [`load`] for a scene whose `.space` file may exist and then has the contact points. `path` may be the space
/// itself, which holds its scene.
pub(crate) fn load_for(path: &Path, space: &Path) -> Result<Analysis, Failure> {
    if is_space(path) {
        return of_space(path);
    }
    let scene = Scene::load(path)?.resolve()?;
    built(scene, |scene| Analysis::resuming(path, scene, space))
}

/// Prints the warnings of the scene at `path`, builds its body and chooses its contact points.
pub(crate) fn of_scene(path: &Path, scene: ResolvedScene) -> Result<Analysis, Failure> {
    built(scene, |scene| Analysis::of_scene(path, scene))
}

fn built(
    scene: ResolvedScene,
    build: impl FnOnce(ResolvedScene) -> Result<Analysis, PipelineError>,
) -> Result<Analysis, Failure> {
    for warning in &scene.warnings {
        eprintln!("palpate: warning: {warning}");
    }
    let mut progress = scene.cover.is_some().then(|| WorkProgress::new(&scene.name, ""));
    if let Some(progress) = &mut progress {
        progress.phase("choosing contact points");
    }
    let beginning = scene.cover.is_some().then(Beginning::new);
    let analysis = build(scene);
    drop(beginning);
    if let Some(progress) = progress {
        progress.finish();
    }
    Ok(analysis?)
}

/// Opens a space that must exist.
pub(crate) fn existing_space(path: &Path) -> Result<Store, Failure> {
    let file = File::open(path).map_err(|error| Failure::file(path, &error))?;
    if file.metadata().is_ok_and(|there| there.is_dir()) {
        return Err(Failure::file(path, &ErrorKind::IsADirectory.into()));
    }
    Ok(Store::open(path)?)
}

/// Opens or creates the space of a scene; with `salvage`, from the intact part of a damaged space.
pub(crate) fn open_space(analysis: &Analysis, file: &Output, salvage: bool) -> Result<Store, Failure> {
    if !salvage {
        return Ok(analysis.store(file.path())?);
    }
    let (store, salvaged) = analysis.salvage(file.path())?;
    eprintln!(
        "palpate: {} configurations and {} held-out walks saved, {} damaged configurations are solved again; the damaged \
         file is now {}",
        salvaged.saved,
        salvaged.walks,
        salvaged.damaged,
        salvaged.moved_to.display()
    );
    Ok(store)
}

/// Maximum number of worker threads: each keeps a solver in memory.
pub(crate) const MAX_THREADS: usize = 1024;

/// Worker threads: the given number, or one per core.
pub(crate) fn threads(given: Option<usize>) -> Result<usize, Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    threads_or(given, cores.min(MAX_THREADS))
}

/// Worker threads: the given number, or `default`.
pub(crate) fn threads_or(given: Option<usize>, default: usize) -> Result<usize, Failure> {
    match given {
        None => Ok(default),
        Some(n) if (1..=MAX_THREADS).contains(&n) => Ok(n),
        Some(n) => Err(Failure::input(format!(
            "--threads {n}: give 1 to {MAX_THREADS}, or omit it for one per core"
        ))),
    }
}
