//! A loaded scene with its body: what `path`, `precompute` and `demo` start from.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use palpate_precompute::fem::body::Body;
use palpate_precompute::fem::solve::Problem;
use palpate_precompute::held_out::{Draw, HeldOut};
use palpate_precompute::scene::{ActiveNode, BodyError, GridSpec, ResolvedScene, Scene};
use palpate_precompute::space::{
    Expansion, ExpansionError, Progress, Store, StoreIdentity, TagCounts, Workshop, with_threads,
};
use palpate_precompute::spec::{Lattice, Sampling};

use crate::failure::Failure;
use crate::files::Output;

/// A scene ready to be solved.
#[derive(Debug)]
pub(crate) struct Workbench {
    /// Name of the scene file, for messages.
    pub path: PathBuf,
    /// The scene.
    pub scene: ResolvedScene,
    /// Its body.
    pub body: Arc<Body>,
}

impl Workbench {
    /// Loads a scene and its mesh; warnings go to standard error.
    pub(crate) fn load(path: &Path) -> Result<Self, Failure> {
        Self::of(path, Scene::load(path)?.resolve()?)
    }

    /// Builds the body of a scene that stands at `path`; warnings go to standard error.
    pub(crate) fn of(path: &Path, scene: ResolvedScene) -> Result<Self, Failure> {
        for warning in &scene.warnings {
            eprintln!("palpate: warning: {warning}");
        }
        Self::quietly(path, scene)
    }

    /// The scene that a store was made of, out of the store alone.
    pub(crate) fn of_store(store: &Store) -> Result<Self, Failure> {
        let (mesh, fixed) = store.body()?;
        let identity = store.identity()?;
        let scene = Scene::parse(store.path(), identity.scene)?.resolve_in(mesh, fixed)?;
        if hex(&scene.content_hash()) != identity.content_hash {
            let path = store.path().display();
            return Err(Failure::input(format!(
                "{path}: the scene in it is not the one that it was solved for; run `palpate precompute` again"
            )));
        }
        Self::quietly(store.path(), scene)
    }

    /// Loads a scene and its mesh without warnings, for one that is not the first to load it.
    #[cfg(feature = "mpi")]
    pub(crate) fn load_quietly(path: &Path) -> Result<Self, Failure> {
        Self::quietly(path, Scene::load(path)?.resolve()?)
    }

    /// Builds the body of a scene without warnings.
    pub(crate) fn quietly(path: &Path, scene: ResolvedScene) -> Result<Self, Failure> {
        let body = scene.body().map_err(|error| {
            let line = format!("{}: {error}", path.display());
            match error {
                BodyError::Degenerate(_) | BodyError::Pressure { .. } => Failure::input(line),
                BodyError::NoRest(_) => Failure::work(line),
            }
        })?;
        Ok(Self { path: path.to_path_buf(), scene, body: Arc::new(body) })
    }

    /// The active node called `name`, or the first one.
    pub(crate) fn active(&self, name: Option<&str>) -> Result<(usize, &ActiveNode), Failure> {
        let nodes = &self.scene.active;
        let found = match name {
            None => nodes.iter().enumerate().next(),
            Some(name) => nodes.iter().enumerate().find(|(_, a)| a.name == name),
        };
        found.ok_or_else(|| {
            let names: Vec<&str> = nodes.iter().map(|a| a.name.as_str()).collect();
            Failure::input(format!(
                "{}: no active node `{}`; it has {}",
                self.path.display(),
                name.unwrap_or(""),
                names.join(", ")
            ))
        })
    }

    /// The problem of one active node.
    pub(crate) fn problem(&self, active: &ActiveNode) -> Arc<Problem> {
        let mut problem = Problem::with(self.body.clone(), Some(active.handle()), self.scene.constraints);
        problem.newton.reject_inverted = self.scene.reject_inverted;
        Arc::new(problem)
    }

    fn grid_spec(&self) -> Result<GridSpec, Failure> {
        self.scene.grid.ok_or_else(|| {
            Failure::input(format!("{}: no [grid]; add radius_m and spacing_m", self.path.display()))
        })
    }

    /// The positions that the scene asks for.
    pub(crate) fn sampling(&self) -> Result<Sampling, Failure> {
        let sampling = self.grid_spec()?.sampling();
        sampling.map_err(|error| Failure::input(format!("{}: [grid]: {error}", self.path.display())))
    }

    /// The lattice that the scene asks for.
    pub(crate) fn lattice(&self) -> Result<Lattice, Failure> {
        self.sampling()?.lattice().copied().ok_or_else(|| {
            Failure::input(format!(
                "{}: this command is for a lattice; give [grid] a `spacing_m` instead of a tolerance",
                self.path.display()
            ))
        })
    }

    /// Opens or creates the scene's store; with `salvage`, from what is intact of a damaged one.
    pub(crate) fn store(&self, file: &Output, salvage: bool) -> Result<Store, Failure> {
        let path = file.path();
        let identity = StoreIdentity {
            scene_name: self.scene.name.clone(),
            scene: self.scene.text.clone(),
            content_hash: hex(&self.scene.content_hash()),
            mesh_hash: self.scene.mesh.content_hash(),
            law: self.body.law_names(),
            max_force_n: self.scene.max_force_n,
            sampling: self.sampling()?,
            visual: self.scene.visual,
            displacement_bound: self.scene.displacement_bound,
            form: self.scene.form,
        };
        let active: Vec<(String, u32)> = self.scene.active.iter().map(|a| (a.name.clone(), a.node)).collect();
        let (mesh, fixed) = (&self.scene.mesh, &self.scene.fixed);
        if !salvage {
            return Ok(Store::create_or_resume(path, &identity, mesh, fixed, &active)?);
        }
        let (store, salvaged) = Store::salvage(path, &identity, mesh, fixed, &active)?;
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

    /// Held-out truth of these active nodes.
    pub(crate) fn held_out(&self, actives: &[usize], draw: Draw) -> Result<HeldOut, Failure> {
        let named = actives.iter().map(|&active| (active, self.scene.active[active].name.clone()));
        let (sampling, keep_displacements) = (self.sampling()?, self.scene.visual);
        Ok(HeldOut { actives: named.collect(), sampling, draw, keep_displacements })
    }

    /// What workers need to solve this scene.
    pub(crate) fn workshop(self: &Arc<Self>) -> Result<Arc<Workshop>, Failure> {
        let bench = self.clone();
        let problem = move |active: usize| bench.problem(&bench.scene.active[active]);
        Ok(Arc::new(Workshop::new(problem, self.sampling()?, self.scene.max_force_n)))
    }

    /// Solves the spaces of these active nodes on this machine.
    pub(crate) fn expand(
        self: &Arc<Self>,
        actives: Vec<usize>,
        store: &Store,
        threads: usize,
        stop: &AtomicBool,
        progress: impl FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, Failure> {
        let expansion = Expansion { actives };
        let expanded: Result<Vec<TagCounts>, ExpansionError> =
            with_threads(&self.workshop()?, threads, |crew| expansion.run(store, crew, stop, progress));
        Ok(expanded?)
    }
}

/// Bytes as a store names them.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Worker threads: as asked, or one a core.
pub(crate) fn threads(asked: Option<usize>) -> usize {
    asked.filter(|&n| n > 0).unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
}

/// A second signal ends the process at once, but not before the first had this long to be heeded: some senders
/// signal twice in a row, and the hand must be let go first.
const PATIENCE: Duration = Duration::from_secs(2);

/// The flag is one for the whole process: a handler can be set but once.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// A flag that Ctrl-C and SIGTERM raise; work that goes on regardless is ended by a later second one.
pub(crate) fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    if let Some(stop) = STOP.get() {
        return Ok(stop.clone());
    }
    let stop = STOP.get_or_init(Arc::default).clone();
    let raised = stop.clone();
    let mut first: Option<Instant> = None;
    on_signal(move || {
        raised.store(true, Ordering::SeqCst);
        if first.get_or_insert_with(Instant::now).elapsed() > PATIENCE {
            eprintln!("palpate: ended at once");
            std::process::exit(130);
        }
    })?;
    Ok(stop)
}

/// Ends the process at the first Ctrl-C or SIGTERM, for a command that keeps nothing.
pub(crate) fn end_when_interrupted() -> Result<(), Failure> {
    on_signal(|| {
        eprintln!("palpate: interrupted; nothing is kept");
        std::process::exit(1);
    })
}

fn on_signal(handle: impl FnMut() + Send + 'static) -> Result<(), Failure> {
    ctrlc::set_handler(handle).map_err(|error| Failure::work(format!("cannot catch Ctrl-C: {error}")))
}
