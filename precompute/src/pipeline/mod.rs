//! From a scene to a certified blob: the workflow of an application, step by step.
//!
//! ```text
//! Analysis::load             scene and body
//! Analysis::store            .space file
//! Analysis::solve            configurations
//! solve_held_out_positions   fresh solves
//! certified                  tables and their errors
//! Packed::bytes              blob
//! ```
//!
//! [`certified_blob`] does the steps after the solve in one call. Each step keeps its results in the `.space`
//! file, so an interrupted step continues where it stopped.

mod blob;
mod discretisation;
mod error;
mod ledger;
mod loading;
mod visits;

pub use crate::space::complete_charts;
pub use blob::{add_ledgers, certified, certified_blob, solve_held_out_positions, unfinished};
pub use discretisation::{DISCRETISATION_POSITIONS, discretisation_in, solve_discretisation};
pub use error::PipelineError;
pub use ledger::ledger;
pub use loading::{Equilibrium, Loading};

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palpate_core::Limits;

use crate::error::InputError;
use crate::fem::body::Body;
use crate::fem::material::Material;
use crate::fem::solve::Problem;
use crate::held_out::{Draw, HeldOut, HeldOutProgress, Places};
use crate::mesh::{SkinPoint, Surface};
use crate::scene::{ActiveNode, ResolvedScene, Scene, choose_contact_points};
use crate::space::{
    Progress, Salvaged, Store, StoreIdentity, TagCounts, WorkerContext, expand, with_threads,
};
use crate::spec::{ContactSurface, Lattice, Sampling};

/// Execution options of a long step.
#[derive(Debug, Clone, Copy)]
pub struct Run<'s> {
    /// Number of threads, at least one. The results do not depend on it.
    pub threads: usize,
    /// Stop flag of the caller. A stopped step keeps what is solved by then.
    pub stop: &'s AtomicBool,
}

impl Run<'static> {
    /// Options for a run on all cores without interruption.
    #[must_use]
    pub fn run_to_end() -> Self {
        static NO_STOP: AtomicBool = AtomicBool::new(false);
        Self { threads: std::thread::available_parallelism().map_or(1, usize::from), stop: &NO_STOP }
    }
}

/// The scene with the contact points of a store in place of those that are to be chosen.
fn with_contacts(
    mut scene: ResolvedScene,
    store: &Store,
    contacts: Option<ContactSurface>,
) -> Result<ResolvedScene, PipelineError> {
    if let (Some(_), Some(contacts)) = (scene.cover.take(), contacts) {
        let chosen = store.active()?.into_iter().zip(contacts.points).skip(scene.active.len());
        let point = |((name, _), at)| ActiveNode::at(name, at);
        scene.active.extend(chosen.map(point));
        scene.contact_triangles = contacts.triangles;
    }
    Ok(scene)
}

/// A scene with its body: the input of a solve.
#[derive(Debug)]
pub struct Analysis {
    /// Path of the scene for error messages.
    pub path: PathBuf,
    /// The scene.
    pub scene: ResolvedScene,
    /// Its body.
    pub body: Arc<Body>,
}

impl Analysis {
    /// Loads a scene file and its mesh, and builds the body. [`ResolvedScene::warnings`] lists unusual but
    /// solvable properties of the scene.
    pub fn load(path: &Path) -> Result<Self, PipelineError> {
        Self::of_scene(path, Scene::load(path)?.resolve()?)
    }

    /// Builds the body of a scene and chooses the contact points that cover its skin, if it asks for them; error
    /// messages name `path`.
    pub fn of_scene(path: &Path, mut scene: ResolvedScene) -> Result<Self, PipelineError> {
        let body = scene.body().map_err(|error| PipelineError::Body(path.to_path_buf(), error))?;
        let body = Arc::new(body);
        if let (Some(cover), Some(tip)) = (scene.cover.take(), scene.tool.fingertip().copied()) {
            let threads = std::thread::available_parallelism().map_or(1, usize::from);
            let found = choose_contact_points(&scene, &cover, &tip, &body, threads);
            let (points, triangles) = found.map_err(|failure| {
                let what = format!("the body cannot be solved at rest ({failure})");
                InputError::new(path, what, "check the constants and units of the material, and [fixed]")
            })?;
            scene.add_contacts(points, &triangles);
            let (points, limit) = (scene.active.len(), Limits::PC.spaces);
            if points > limit {
                let what = format!("the skin needs {points} contact points, and a blob holds {limit}");
                let fix = "give a larger pad or tolerance, a smaller group, or a workspace";
                return Err(InputError::new(path, what, fix).into());
            }
        }
        Ok(Self { path: path.to_path_buf(), scene, body })
    }

    /// Like [`Self::of_scene`], with the contact points of the `.space` file at `space` if it was made for the
    /// same scene, so that they are not chosen again.
    pub fn resuming(path: &Path, scene: ResolvedScene, space: &Path) -> Result<Self, PipelineError> {
        if scene.cover.is_some()
            && space.exists()
            && let Ok(store) = Store::open(space)
            && let Ok(identity) = store.identity()
            && (&identity.scene, &identity.mesh_hash) == (&scene.text, &scene.mesh.content_hash())
        {
            let known = Self::of_scene(path, with_contacts(scene.clone(), &store, identity.contacts)?)?;
            if identity.content_hash == known.scene.content_hash().to_string() {
                return Ok(known);
            }
        }
        Self::of_scene(path, scene)
    }

    /// Restores scene and body from the `.space` file alone.
    pub fn of_store(store: &Store) -> Result<Self, PipelineError> {
        let (mesh, fixed) = store.body()?;
        let identity = store.identity()?;
        let scene = Scene::parse(store.path(), identity.scene)?.resolve_in(mesh, fixed)?;
        let analysis = Self::of_scene(store.path(), with_contacts(scene, store, identity.contacts)?)?;
        if identity.content_hash != analysis.scene.content_hash().to_string() {
            let what = "the stored scene differs from the solved one";
            return Err(InputError::new(store.path(), what, "run `palpate precompute` again").into());
        }
        Ok(analysis)
    }

    /// Index and description of the active node `name`, or of the first one.
    pub fn active(&self, name: Option<&str>) -> Result<(usize, &ActiveNode), PipelineError> {
        let mut nodes = self.scene.active.iter().enumerate();
        nodes.find(|(_, active)| name.is_none_or(|name| active.name == name)).ok_or_else(|| {
            let known: Vec<&str> = self.scene.active.iter().map(|active| active.name.as_str()).collect();
            let what = format!("no active node `{}`", name.unwrap_or_default());
            InputError::new(&self.path, what, format!("it has {}", known.join(", "))).into()
        })
    }

    /// The equilibrium problem with this active node, or its patch, prescribed.
    #[must_use]
    pub fn problem(&self, active: &ActiveNode) -> Arc<Problem> {
        self.scene.problem(&self.body, active)
    }

    /// The positions that the scene requests.
    pub fn sampling(&self) -> Result<Sampling, PipelineError> {
        let none = || InputError::new(&self.path, "no [grid]", "add radius_m and spacing_m").into();
        self.scene.grid.ok_or_else(none)
    }

    /// The lattice that the scene requests.
    pub fn lattice(&self) -> Result<Lattice, PipelineError> {
        let what = "this command needs a lattice";
        let fix = "give [grid] a `spacing_m` instead of a tolerance";
        let adaptive = || InputError::new(&self.path, what, fix).into();
        self.sampling()?.lattice().copied().ok_or_else(adaptive)
    }

    /// Opens the `.space` file of this scene for solving, or creates it. Fails if the file belongs to another
    /// scene.
    pub fn store(&self, path: &Path) -> Result<Store, PipelineError> {
        let (identity, active) = (self.identity()?, self.active_nodes());
        Ok(Store::create_or_resume(path, &identity, &self.scene.mesh, &self.scene.fixed, &active)?)
    }

    /// Like [`Self::store`], with the intact records of a damaged file.
    pub fn salvage(&self, path: &Path) -> Result<(Store, Salvaged), PipelineError> {
        let (identity, active) = (self.identity()?, self.active_nodes());
        Ok(Store::salvage(path, &identity, &self.scene.mesh, &self.scene.fixed, &active)?)
    }

    /// A store keeps the scene as text and rebuilds the laws from it. So it cannot hold a law of the user's
    /// own.
    fn identity(&self) -> Result<StoreIdentity, PipelineError> {
        for region in &self.scene.materials {
            if let Material::Own(_) = region.material {
                let what = format!("the law \"{}\" is user-defined", region.material.name());
                let fix = "a .space file cannot hold it: solve it with fem::Solver, or give the scene a built-in law";
                return Err(InputError::new(&self.path, what, fix).into());
            }
        }
        Ok(StoreIdentity {
            scene_name: self.scene.name.clone(),
            scene: self.scene.text.clone(),
            content_hash: self.scene.content_hash().to_string(),
            mesh_hash: self.scene.mesh.content_hash(),
            law: self.body.law_names(),
            max_force_n: self.scene.max_force_n,
            sampling: self.sampling()?,
            normals: self.normals(),
            visited_m: self.scene.active.iter().map(|active| active.visited_m.clone()).collect(),
            contacts: self.scene.contacts(),
            charts: self.scene.charts.clone(),
            visual: self.scene.visual,
            displacement_bound: self.scene.displacement_bound,
        })
    }

    /// Outward normal of each active node, of the body as it rests under its body force.
    fn normals(&self) -> Vec<[f64; 3]> {
        let mut mesh = self.scene.mesh.clone();
        for (x, moved) in mesh.nodes_m.iter_mut().zip(self.body.rest_state.as_chunks::<3>().0) {
            *x = std::array::from_fn(|axis| x[axis] + moved[axis]);
        }
        let surface = Surface::of(&mesh);
        self.scene.active.iter().map(|active| active.normal(&surface).unwrap_or_default()).collect()
    }

    fn active_nodes(&self) -> Vec<(String, u32)> {
        self.scene.active.iter().map(|active| (active.name.clone(), active.node)).collect()
    }

    /// The data that workers need to solve this scene.
    pub fn context(&self) -> Result<Arc<WorkerContext>, PipelineError> {
        let (problems, nodes) = (self.scene.problems(&self.body), self.scene.active.clone());
        let problem = move |active: usize, place: Option<SkinPoint>| {
            place.map_or_else(|| problems.of(&nodes[active]), |place| problems.at(place))
        };
        Ok(Arc::new(WorkerContext::new(problem, self.sampling()?, self.scene.max_force_n)))
    }

    /// Solves the spaces of these active nodes (indices into [`ResolvedScene::active`]) and stores them in
    /// `store`. Returns the number of positions per tag for each node.
    pub fn solve(
        &self,
        actives: &[usize],
        store: &Store,
        run: Run<'_>,
        progress: impl FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, PipelineError> {
        let counts = with_threads(&self.context()?, run.threads, |executor| {
            Ok::<_, PipelineError>(expand(actives, store, executor, run.stop, progress)?)
        })?;
        complete_charts(store, run.threads)?;
        Ok(counts)
    }

    /// Solves the spaces of all active nodes into the `.space` file at `path`. Continues the file of an
    /// earlier run.
    pub fn solve_all(&self, path: &Path, run: Run<'_>) -> Result<Vec<TagCounts>, PipelineError> {
        let all: Vec<usize> = (0..self.scene.active.len()).collect();
        self.solve(&all, &self.store(path)?, run, |_| {})
    }

    /// Held-out positions and paths of these active nodes, which no fit uses.
    pub fn held_out(&self, actives: &[usize], draw: Draw) -> Result<HeldOut, PipelineError> {
        let named = actives.iter().map(|&active| (active, self.scene.active[active].name.clone()));
        let (sampling, keep_displacements) = (self.sampling()?, self.scene.visual);
        let places = Places::of(self.scene.contacts(), &self.scene.mesh);
        Ok(HeldOut { actives: named.collect(), sampling, draw, places, keep_displacements })
    }

    /// Solves these positions and stores them in `store`.
    pub fn solve_held_out(
        &self,
        held_out: &HeldOut,
        store: &Store,
        run: Run<'_>,
        progress: impl FnMut(&HeldOutProgress),
    ) -> Result<(), PipelineError> {
        with_threads(&self.context()?, run.threads, |executor| {
            Ok(held_out.run(store, executor, run.stop, progress)?)
        })
    }
}
