//! From a scene to a certified blob: what an engineer does with this library, step by step.
//!
//! ```text
//! Analysis::load -> Analysis::store -> Analysis::solve -> solve_truth -> certified -> Packed::bytes
//! scene, body       .space file        configurations     fresh solves   tables and their errors
//! ```
//!
//! [`certified_blob`] does the steps after the solve in one call. Each step keeps what it did in the `.space`
//! file, so an interrupted one goes on where it stopped.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use palpate_core::{AlignedBytes, BlobError, LatticeError, Method, Organ};

use crate::certificate::{Certificate, Effort, certify, clear_positions, ledger};
use crate::error::InputError;
use crate::fem::body::Body;
use crate::fem::solve::Problem;
use crate::held_out::{Draw, HeldOut, HeldOutError, HeldOutProgress, Summary};
use crate::pack::{PackError, PackOptions, Packed, pack};
use crate::scene::{ActiveNode, BodyError, ResolvedScene, Scene};
use crate::space::{
    Expansion, ExpansionError, Kind, Progress, Salvaged, Store, StoreError, StoreIdentity, TagCounts,
    Workshop, still_to_solve, with_threads,
};
use crate::spec::{Lattice, Sampling};

/// Why a step of the pipeline failed: one line that names the file, what is wrong and the fix.
#[derive(Debug)]
pub enum PipelineError {
    /// The scene or its mesh.
    Input(InputError),
    /// The body cannot be built.
    Body {
        /// The scene.
        path: PathBuf,
        /// Why.
        error: BodyError,
    },
    /// The scene does not say where to solve.
    NoGrid {
        /// The scene.
        path: PathBuf,
    },
    /// The grid of the scene is not possible.
    Grid {
        /// The scene.
        path: PathBuf,
        /// Why.
        error: LatticeError,
    },
    /// A lattice is needed, and the scene asks for scattered positions.
    NotALattice {
        /// The scene.
        path: PathBuf,
    },
    /// No active node has this name.
    UnknownNode {
        /// The scene.
        path: PathBuf,
        /// The name.
        name: String,
        /// Names of the active nodes.
        known: Vec<String>,
    },
    /// The scene kept in a space is not the one that was solved.
    OtherScene {
        /// The space.
        path: PathBuf,
    },
    /// An active node has positions that are still to be solved.
    Unfinished(Unfinished),
    /// The space.
    Store(StoreError),
    /// The solve of the configurations.
    Expansion(ExpansionError),
    /// The solve of held-out positions.
    HeldOut(HeldOutError),
    /// The tables.
    Pack(PackError),
    /// The packed blob is not one that the core reads.
    Blob(BlobError),
    /// The certificate cannot be written as JSON.
    Certificate(serde_json::Error),
    /// The caller raised the stop flag.
    Interrupted,
}

/// An active node that is not finished.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unfinished {
    /// The space.
    pub path: PathBuf,
    /// Name of the active node.
    pub active: String,
    /// Positions that are still to be solved, at least.
    pub open: usize,
}

impl std::fmt::Display for Unfinished {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { path, active, open } = self;
        write!(
            f,
            "{}: active node {active} is not finished: {open} points or more are still to be solved",
            path.display()
        )
    }
}

impl PipelineError {
    /// Whether the caller's input is at fault, rather than the work or the machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Body { error, .. } => !matches!(error, BodyError::NoRest(_)),
            Self::Store(error)
            | Self::Expansion(ExpansionError::Store(error))
            | Self::HeldOut(HeldOutError::Store(error))
            | Self::Pack(PackError::Store(error)) => !error.is_of_the_machine(),
            Self::Expansion(error) => matches!(error, ExpansionError::Rest(_)),
            Self::HeldOut(error) => matches!(error, HeldOutError::NoSpace(_) | HeldOutError::NoReach(_)),
            Self::Blob(_) | Self::Certificate(_) | Self::Interrupted => false,
            _ => true,
        }
    }
}

impl std::fmt::Display for PipelineError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Input(error) => write!(f, "{error}"),
            Self::Body { path, error } => write!(f, "{}: {error}", path.display()),
            Self::NoGrid { path } => write!(f, "{}: no [grid]; add radius_m and spacing_m", path.display()),
            Self::Grid { path, error } => write!(f, "{}: [grid]: {error}", path.display()),
            Self::NotALattice { path } => write!(
                f,
                "{}: this command is for a lattice; give [grid] a `spacing_m` instead of a tolerance",
                path.display()
            ),
            Self::UnknownNode { path, name, known } => {
                write!(f, "{}: no active node `{name}`; it has {}", path.display(), known.join(", "))
            }
            Self::OtherScene { path } => write!(
                f,
                "{}: the scene in it is not the one that it was solved for; run `palpate precompute` again",
                path.display()
            ),
            Self::Unfinished(unfinished) => {
                write!(f, "{unfinished}; run `palpate precompute` again, or pack with --partial")
            }
            Self::Store(error) => write!(f, "{error}"),
            Self::Expansion(error) => write!(f, "{error}"),
            Self::HeldOut(error) => write!(f, "{error}"),
            Self::Pack(error) => write!(f, "{error}"),
            Self::Blob(error) => write!(f, "the packed blob cannot be read back: {error}; please report it"),
            Self::Certificate(error) => write!(f, "the certificate cannot be written: {error}"),
            Self::Interrupted => write!(
                f,
                "interrupted; what was solved for the certificate is kept, run the same command to go on"
            ),
        }
    }
}

impl std::error::Error for PipelineError {}

macro_rules! from_errors {
    ($($variant:ident($error:ty)),* $(,)?) => { $(
        impl From<$error> for PipelineError {
            fn from(error: $error) -> Self {
                Self::$variant(error)
            }
        }
    )* };
}

from_errors!(
    Input(InputError),
    Store(StoreError),
    Expansion(ExpansionError),
    HeldOut(HeldOutError),
    Pack(PackError),
    Blob(BlobError),
    Certificate(serde_json::Error),
);

/// How a long step runs.
#[derive(Debug, Clone, Copy)]
pub struct Run<'s> {
    /// Threads, one at least. The results do not depend on it.
    pub threads: usize,
    /// Raised to end the step in good order; what is solved by then is kept.
    pub stop: &'s AtomicBool,
}

impl Run<'static> {
    /// On all cores, to the end.
    #[must_use]
    pub fn to_the_end() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self { threads: std::thread::available_parallelism().map_or(1, usize::from), stop: &NEVER }
    }
}

/// A scene with its body: everything that a solve needs.
#[derive(Debug)]
pub struct Analysis {
    /// The file that messages name.
    pub path: PathBuf,
    /// The scene.
    pub scene: ResolvedScene,
    /// Its body.
    pub body: Arc<Body>,
}

impl Analysis {
    /// Loads a scene file and its mesh, and builds the body. What is odd about the scene but can be solved is in
    /// [`ResolvedScene::warnings`].
    pub fn load(path: &Path) -> Result<Self, PipelineError> {
        Self::of_scene(path, Scene::load(path)?.resolve()?)
    }

    /// Builds the body of a scene; `path` is the file that messages name.
    pub fn of_scene(path: &Path, scene: ResolvedScene) -> Result<Self, PipelineError> {
        let body = scene.body().map_err(|error| PipelineError::Body { path: path.to_path_buf(), error })?;
        Ok(Self { path: path.to_path_buf(), scene, body: Arc::new(body) })
    }

    /// The scene that a space was solved for, from the space alone.
    pub fn of_store(store: &Store) -> Result<Self, PipelineError> {
        let (mesh, fixed) = store.body()?;
        let identity = store.identity()?;
        let scene = Scene::parse(store.path(), identity.scene)?.resolve_in(mesh, fixed)?;
        let analysis = Self::of_scene(store.path(), scene)?;
        if !analysis.is_of(store)? {
            return Err(PipelineError::OtherScene { path: store.path().to_path_buf() });
        }
        Ok(analysis)
    }

    /// Index and description of the active node `name`, or of the first one.
    pub fn active(&self, name: Option<&str>) -> Result<(usize, &ActiveNode), PipelineError> {
        let mut nodes = self.scene.active.iter().enumerate();
        nodes.find(|(_, active)| name.is_none_or(|name| active.name == name)).ok_or_else(|| {
            PipelineError::UnknownNode {
                path: self.path.clone(),
                name: name.unwrap_or_default().into(),
                known: self.scene.active.iter().map(|active| active.name.clone()).collect(),
            }
        })
    }

    /// The equilibrium problem with this active node prescribed.
    #[must_use]
    pub fn problem(&self, active: &ActiveNode) -> Arc<Problem> {
        self.problem_of()(active)
    }

    fn problem_of(&self) -> impl Fn(&ActiveNode) -> Arc<Problem> + Send + Sync + 'static {
        let (body, constraints) = (self.body.clone(), self.scene.constraints);
        let reject_inverted = self.scene.reject_inverted;
        move |active| {
            let mut problem = Problem::with(body.clone(), Some(active.handle()), constraints);
            problem.newton.reject_inverted = reject_inverted;
            Arc::new(problem)
        }
    }

    /// The positions that the scene asks for.
    pub fn sampling(&self) -> Result<Sampling, PipelineError> {
        let path = || self.path.clone();
        let grid = self.scene.grid.ok_or_else(|| PipelineError::NoGrid { path: path() })?;
        grid.sampling().map_err(|error| PipelineError::Grid { path: path(), error })
    }

    /// The lattice that the scene asks for.
    pub fn lattice(&self) -> Result<Lattice, PipelineError> {
        let not = || PipelineError::NotALattice { path: self.path.clone() };
        self.sampling()?.lattice().copied().ok_or_else(not)
    }

    /// Opens the `.space` file of this scene for solving, or creates it. A file that was solved for another
    /// scene is refused.
    pub fn store(&self, path: &Path) -> Result<Store, PipelineError> {
        let (identity, active) = (self.identity()?, self.active_nodes());
        Ok(Store::create_or_resume(path, &identity, &self.scene.mesh, &self.scene.fixed, &active)?)
    }

    /// [`Self::store`] of what is intact in a damaged file.
    pub fn salvage(&self, path: &Path) -> Result<(Store, Salvaged), PipelineError> {
        let (identity, active) = (self.identity()?, self.active_nodes());
        Ok(Store::salvage(path, &identity, &self.scene.mesh, &self.scene.fixed, &active)?)
    }

    fn identity(&self) -> Result<StoreIdentity, PipelineError> {
        Ok(StoreIdentity {
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
        })
    }

    fn active_nodes(&self) -> Vec<(String, u32)> {
        self.scene.active.iter().map(|active| (active.name.clone(), active.node)).collect()
    }

    /// What workers need to solve this scene.
    pub fn workshop(&self) -> Result<Arc<Workshop>, PipelineError> {
        let (problem_of, nodes) = (self.problem_of(), self.scene.active.clone());
        let problem = move |active: usize| problem_of(&nodes[active]);
        Ok(Arc::new(Workshop::new(problem, self.sampling()?, self.scene.max_force_n)))
    }

    /// Solves the spaces of these active nodes (indices into [`ResolvedScene::active`]) and keeps them in `store`.
    /// Returns how the positions of each ended.
    pub fn solve(
        &self,
        actives: Vec<usize>,
        store: &Store,
        run: Run<'_>,
        progress: impl FnMut(&Progress),
    ) -> Result<Vec<TagCounts>, PipelineError> {
        let (expansion, workshop) = (Expansion { actives }, self.workshop()?);
        let solved: Result<Vec<TagCounts>, ExpansionError> =
            with_threads(&workshop, run.threads, |crew| expansion.run(store, crew, run.stop, progress));
        Ok(solved?)
    }

    /// Solves the spaces of all active nodes into the `.space` file at `path`, which an earlier run may have begun.
    pub fn solve_all(&self, path: &Path, run: Run<'_>) -> Result<Vec<TagCounts>, PipelineError> {
        self.solve((0..self.scene.active.len()).collect(), &self.store(path)?, run, |_| {})
    }

    /// Whether a space was solved for this scene.
    pub fn is_of(&self, store: &Store) -> Result<bool, PipelineError> {
        Ok(store.identity()?.content_hash == hex(&self.scene.content_hash()))
    }

    /// Positions and paths of these active nodes that no fit uses.
    pub fn held_out(&self, actives: &[usize], draw: Draw) -> Result<HeldOut, PipelineError> {
        let named = actives.iter().map(|&active| (active, self.scene.active[active].name.clone()));
        let (sampling, keep_displacements) = (self.sampling()?, self.scene.visual);
        Ok(HeldOut { actives: named.collect(), sampling, draw, keep_displacements })
    }

    /// Solves those, and keeps them in `store`.
    pub fn solve_held_out(
        &self,
        held_out: &HeldOut,
        store: &Store,
        run: Run<'_>,
        progress: impl FnMut(&HeldOutProgress),
    ) -> Result<(), PipelineError> {
        let solved: Result<(), HeldOutError> = with_threads(&self.workshop()?, run.threads, |crew| {
            held_out.run(store, crew, run.stop, progress)
        });
        Ok(solved?)
    }
}

/// The active nodes of a space that are not finished.
pub fn unfinished(store: &Store) -> Result<Vec<Unfinished>, PipelineError> {
    let mut unfinished = Vec::new();
    for (active, (name, _)) in store.active()?.into_iter().enumerate() {
        let open = still_to_solve(store, active)?;
        if open > 0 {
            unfinished.push(Unfinished { path: store.path().to_path_buf(), active: name, open });
        }
    }
    Ok(unfinished)
}

/// Uniform positions of a blob of many nodes, all together: without a failure they certify 99.5 % with 95 % confidence.
const TOGETHER: u32 = 600;
/// Fewer than this say nothing about a node.
const MIN_UNIFORM: u32 = 3;
/// More nodes than this are certified together.
pub const FEW: usize = 8;

/// Uniform positions of a node, where the caller does not choose.
fn default_uniform(nodes: usize) -> u32 {
    if nodes <= FEW {
        return Draw::PAPER.uniform;
    }
    TOGETHER.div_ceil(u32::try_from(nodes).unwrap_or(u32::MAX)).max(MIN_UNIFORM)
}

/// Uniform positions are solved in at most this many rounds: how many of them lie at branch jumps is known only
/// afterwards.
const MAX_ROUNDS: u32 = 4;

/// Solves uniform positions of every active node, until as many as `uniform` are away from branch jumps or more would
/// not help, and keeps them in the `.space` file. With `None`: 299 of each of up to eight nodes, 600 of all nodes together
/// beyond that. Returns how many were solved now.
///
/// Only nodes with branch jumps are asked for more. Of many nodes that are certified together none is: the others make up
/// for it.
pub fn solve_truth(
    space: &Path,
    uniform: Option<u32>,
    run: Run<'_>,
    mut progress: impl FnMut(&HeldOutProgress),
) -> Result<usize, PipelineError> {
    let nodes = Store::open(space)?.active()?.len();
    let asked = uniform.unwrap_or_else(|| default_uniform(nodes));
    let rounds = if nodes > FEW && uniform.is_none() { 1 } else { MAX_ROUNDS };
    let (mut lacking, mut wanted, mut solved): (Vec<usize>, _, _) = ((0..nodes).collect(), asked, 0);
    for round in 1..=rounds {
        let (solved_now, is_whole) = solve_uniform(space, &lacking, wanted, run, &mut progress)?;
        solved += solved_now;
        if !is_whole || round == rounds {
            break;
        }
        let store = Store::open(space)?;
        let flags_only = PackOptions { methods: &[], intermediate: false, threads: run.threads };
        let bytes = AlignedBytes::from(&pack(&store, &flags_only)?.bytes()?[..]);
        let organ: Organ<'_> = Organ::read(&bytes)?;
        let mut clear = clear_positions(&store, &organ)?;
        clear.retain(|&(_, count)| count > 0 && count < asked as usize);
        let Some(least) = clear.iter().map(|&(_, count)| count as u32).min() else { break };
        lacking = clear.into_iter().map(|(active, _)| active).collect();
        wanted += ((asked - least) * wanted).div_ceil(least);
    }
    Ok(solved)
}

/// Solves what is missing of `wanted` uniform positions of these active nodes. Returns how many were solved now, and
/// whether all of them are there.
fn solve_uniform(
    space: &Path,
    actives: &[usize],
    wanted: u32,
    run: Run<'_>,
    progress: &mut dyn FnMut(&HeldOutProgress),
) -> Result<(usize, bool), PipelineError> {
    let store = Store::open(space)?;
    let actives = lacking_uniform(&store, actives, wanted)?;
    if actives.is_empty() {
        return Ok((0, true));
    }
    let analysis = Analysis::of_store(&store)?;
    drop(store);
    let store = analysis.store(space)?;
    let uniform_only = Draw { regular_m: None, random: 0, ..Draw::PAPER };
    let draw = Draw { uniform: wanted, ..Draw::of(&store)?.unwrap_or(uniform_only) };
    let held_out = analysis.held_out(&actives, draw)?;
    let mut solved = 0;
    analysis.solve_held_out(&held_out, &store, run, |p| {
        solved = p.positions_now;
        progress(p);
    })?;
    Ok((solved, lacking_uniform(&store, &actives, wanted)?.is_empty()))
}

/// Active nodes that have a space but fewer uniform positions.
fn lacking_uniform(store: &Store, actives: &[usize], wanted: u32) -> Result<Vec<usize>, PipelineError> {
    let mut lacking = Vec::new();
    for &active in actives {
        let there = Summary::of(store, active)?.get(&Kind::Uniform).map_or(0, |sum| sum.whole);
        let solved = store.records(active)?.iter().filter(|r| r.tag.is_solved()).count();
        if there < wanted && solved > 1 {
            lacking.push(active);
        }
    }
    Ok(lacking)
}

/// Fits the tables of a space and measures them at its held-out positions, with the very bytes that the loop reads.
pub fn certified(store: &Store, options: &PackOptions<'_>) -> Result<(Packed, Certificate), PipelineError> {
    let mut packed = pack(store, options)?;
    let bytes = AlignedBytes::from(&packed.bytes()?[..]);
    let organ: Organ<'_> = Organ::read(&bytes)?;
    let certificate = certify(store, &organ)?;
    packed.certify(&serde_json::to_string(&certificate)?)?;
    Ok((packed, certificate))
}

/// Adds ledgers to a certificate: what the blob leaves out, and with `positions` above zero what element order and mesh do.
/// `began` is told the name of each node before its positions are solved.
pub fn add_ledgers(
    store: &Store,
    (packed, certificate): (&mut Packed, &mut Certificate),
    positions: usize,
    run: Run<'_>,
    began: impl Fn(&str),
) -> Result<(), PipelineError> {
    let bytes = AlignedBytes::from(&packed.bytes()?[..]);
    let organ: Organ<'_> = Organ::read(&bytes)?;
    let analysis = Analysis::of_store(store)?;
    let effort = Effort { positions, threads: run.threads, stop: run.stop };
    let wanted = if certificate.spaces.len() > FEW { 1 } else { certificate.spaces.len() };
    let names: Vec<String> = store.active()?.into_iter().map(|(name, _)| name).collect();
    for space in &mut certificate.spaces[..wanted] {
        let Some(active) = names.iter().position(|name| *name == space.active) else { continue };
        if positions > 0 {
            began(&space.active);
        }
        space.ledger = ledger(store, active, (&organ, space), &analysis.scene, effort)?;
        if run.stop.load(Ordering::Relaxed) {
            return Err(PipelineError::Interrupted);
        }
    }
    packed.certify(&serde_json::to_string(&*certificate)?)?;
    Ok(())
}

/// The certified blob of a finished space, in memory. `uniform` as in [`solve_truth`].
pub fn certified_blob(
    space: &Path,
    methods: &[Method],
    uniform: Option<u32>,
    run: Run<'_>,
) -> Result<Vec<u8>, PipelineError> {
    if let Some(unfinished) = unfinished(&Store::open(space)?)?.into_iter().next() {
        return Err(PipelineError::Unfinished(unfinished));
    }
    solve_truth(space, uniform, run, |_| {})?;
    let options = PackOptions { methods, intermediate: true, threads: run.threads };
    Ok(certified(&Store::open(space)?, &options)?.0.bytes()?)
}

/// Bytes as hexadecimal digits.
fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
