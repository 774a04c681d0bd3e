//! A scene of a file, a dictionary or arrays, and its solves.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use palpate_precompute::mesh::{MeshFault, Surface, TetMesh};
use palpate_precompute::pipeline::{Analysis, PipelineError, Run, complete_charts};
use palpate_precompute::scene::{ActiveNode, ResolvedScene, Scene as SceneFile};
use palpate_precompute::space::{Store, TagCounts, expand, with_threads};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::failure::Failure;
use crate::running::{Reporter, interruptible, threads};
use crate::{arrays, path};

/// Nodes and tets of arrays with their named groups.
type Arrays<'py> =
    (Bound<'py, PyAny>, PyReadonlyArray2<'py, i64>, HashMap<String, Vec<u32>>, HashMap<String, Vec<u32>>);

/// A scene with its mesh; the body is built by the first solve.
#[pyclass(module = "palpate._palpate", frozen)]
pub(crate) struct Scene {
    path: PathBuf,
    pub(crate) file: SceneFile,
    pub(crate) resolved: ResolvedScene,
    /// Whether the mesh is in memory, so that a changed scene needs it.
    is_in_memory: bool,
    analysis: OnceLock<Arc<Analysis>>,
}

#[pymethods]
impl Scene {
    /// Reads a scene file and its mesh.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> Result<Self, Failure> {
        py.detach(|| Self::new(path.clone(), SceneFile::load(&path)?, None))
    }

    /// The scene of a JSON object with the tables of a scene file, and of a mesh in arrays if `mesh` is
    /// given: nodes (n, 3) in metres, tets (m, 4), groups of nodes and of tets. `path` names the scene in
    /// errors.
    #[staticmethod]
    #[pyo3(signature = (path, json, mesh=None))]
    fn of_json(py: Python<'_>, path: PathBuf, json: &str, mesh: Option<Arrays<'_>>) -> Result<Self, Failure> {
        let shown = path.display();
        let table: toml::Table = serde_json::from_str(json).map_err(|error| {
            Failure::input(format!("{shown}: {error}; use numbers, texts, booleans, lists and dictionaries"))
        })?;
        let text = toml::to_string(&table)
            .map_err(|error| Failure::input(format!("{shown}: {error}; use plain values")))?;
        let mesh = mesh.map(tet_mesh).transpose()?;
        py.detach(|| Self::new(path.clone(), SceneFile::parse(&path, text)?, mesh))
    }

    /// The scene with one value changed: `key` is its path with dots, `value` as in TOML.
    fn with_value(&self, py: Python<'_>, key: &str, value: &str) -> Result<Self, Failure> {
        let mesh = self.is_in_memory.then(|| self.resolved.mesh.clone());
        py.detach(|| Self::new(self.path.clone(), self.file.with(key, value)?, mesh))
    }

    /// Name of the scene.
    #[getter]
    pub(crate) fn name(&self) -> &str {
        &self.resolved.name
    }

    /// The scene as TOML with sorted keys.
    #[getter]
    fn toml(&self) -> &str {
        &self.resolved.text
    }

    /// Unusual but solvable properties, one line each.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.resolved.warnings.clone()
    }

    /// Names of the active nodes.
    #[getter]
    fn active(&self) -> Vec<String> {
        self.resolved.active.iter().map(|active| active.name.clone()).collect()
    }

    /// Places of the active nodes on the undeformed body (a, 3), m.
    #[getter]
    fn active_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let place = |active: &ActiveNode| active.place_m(&self.resolved.mesh);
        arrays::vectors(py, self.resolved.active.iter().map(place).collect())
    }

    /// Outward normals of the skin at the active nodes (a, 3).
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let skin = Surface::of(&self.resolved.mesh);
        let normals = self.resolved.active.iter().map(|active| active.normal(&skin).unwrap_or_default());
        arrays::vectors(py, normals.collect())
    }

    /// Nodes of the mesh (n, 3), m.
    #[getter]
    fn nodes_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::vectors(py, self.resolved.mesh.nodes_m.clone())
    }

    /// Tets of the mesh (m, 4).
    #[getter]
    fn tets<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::rows(py, self.resolved.mesh.tets.clone())
    }

    /// Fixed nodes.
    #[getter]
    fn fixed(&self) -> Vec<u32> {
        self.resolved.fixed.clone()
    }

    /// Groups of nodes.
    #[getter]
    fn node_groups(&self) -> BTreeMap<String, Vec<u32>> {
        self.resolved.mesh.node_groups.clone()
    }

    /// Groups of tets.
    #[getter]
    fn tet_groups(&self) -> BTreeMap<String, Vec<u32>> {
        self.resolved.mesh.tet_groups.clone()
    }

    /// The steps of a loading path as columns, see `palpate.Scene.path`.
    #[pyo3(signature = (displacements_m, active=None, layer=false, keep_nodes=false))]
    fn path<'py>(
        &self,
        py: Python<'py>,
        displacements_m: &Bound<'py, PyAny>,
        active: Option<&str>,
        layer: bool,
        keep_nodes: bool,
    ) -> Result<Bound<'py, PyDict>, Failure> {
        let path_m = arrays::doubles("displacements_m", displacements_m)?;
        let analysis = self.analysis(py)?;
        path::solve(py, &analysis, &path_m, active, layer, keep_nodes)
    }

    /// Solves the configuration spaces into a `.space` file, see `palpate.Scene.precompute`.
    #[pyo3(signature = (space, progress=None, threads=None))]
    fn precompute<'py>(
        &self,
        py: Python<'py>,
        space: PathBuf,
        progress: Option<Bound<'py, PyAny>>,
        threads: Option<usize>,
    ) -> Result<Bound<'py, PyDict>, Failure> {
        let threads = self::threads(threads)?;
        let is_new = !space.exists();
        let done = interruptible(py, threads, progress.as_ref(), |run, report| {
            let analysis = Analysis::resuming(&self.path, self.resolved.clone(), &space)?;
            let store = analysis.store(&space)?;
            let solved = solve(&analysis, &store, run, report);
            // While the store is open, no other process uses the file.
            if is_new && matches!(solved, Err(Failure::Input(_))) {
                for suffix in ["", "-wal", "-shm"] {
                    let _ = std::fs::remove_file(format!("{}{suffix}", space.display()));
                }
            }
            Ok((analysis.scene.active.iter().map(|active| active.name.clone()).collect::<Vec<_>>(), solved?))
        });
        let (names, counts) = done?;
        let all = PyDict::new(py);
        for (name, TagCounts { expandable, terminating, failed, unknown, .. }) in
            names.into_iter().zip(counts)
        {
            let one = PyDict::new(py);
            one.set_item("expandable", expandable)?;
            one.set_item("terminating", terminating)?;
            one.set_item("failed", failed)?;
            one.set_item("unknown", unknown)?;
            all.set_item(name, one)?;
        }
        Ok(all)
    }
}

impl Scene {
    fn new(path: PathBuf, file: SceneFile, mesh: Option<TetMesh>) -> Result<Self, Failure> {
        let is_in_memory = mesh.is_some();
        let resolved = match mesh {
            Some(mesh) => file.resolve_on(mesh)?,
            None => file.resolve()?,
        };
        Ok(Self { path, file, resolved, is_in_memory, analysis: OnceLock::new() })
    }

    /// The scene of another text with the same mesh.
    pub(crate) fn with_text(&self, text: &str) -> Result<Self, Failure> {
        let mesh = self.is_in_memory.then(|| self.resolved.mesh.clone());
        Self::new(self.path.clone(), SceneFile::parse(&self.path, text.to_owned())?, mesh)
    }

    /// The scene with its body, which the first call builds.
    fn analysis(&self, py: Python<'_>) -> Result<Arc<Analysis>, Failure> {
        if let Some(analysis) = self.analysis.get() {
            return Ok(analysis.clone());
        }
        let built = py.detach(|| Analysis::of_scene(&self.path, self.resolved.clone()))?;
        Ok(self.analysis.get_or_init(|| Arc::new(built)).clone())
    }
}

/// Solves the spaces of all active nodes.
fn solve(
    analysis: &Analysis,
    store: &Store,
    run: Run<'_>,
    report: Reporter<'_>,
) -> Result<Vec<TagCounts>, Failure> {
    let all: Vec<usize> = (0..analysis.scene.active.len()).collect();
    let points = analysis.sampling()?.points().map(|points| points * all.len());
    let counts = with_threads(&analysis.context()?, run.threads, |executor| {
        expand(&all, store, executor, run.stop, |now| {
            report(("configurations", now.counts.solved() + now.counts.failed, points));
        })
    });
    let counts = counts.map_err(|error| match PipelineError::from(error) {
        error if error.is_bad_input() => Failure::input(format!("{}: {error}", analysis.path.display())),
        error => error.into(),
    })?;
    complete_charts(store, run.threads)?;
    if counts.iter().all(|counts| counts.solved() == 0) && counts.iter().any(|counts| counts.failed > 0) {
        let fix = "check the constants and units of the material, or take a smaller radius_m";
        return Err(Failure::work(format!("{}: all solves failed; {fix}", analysis.path.display())));
    }
    Ok(counts)
}

/// The checked mesh of arrays.
fn tet_mesh((nodes, tets, node_groups, tet_groups): Arrays<'_>) -> Result<TetMesh, Failure> {
    let nodes_m = arrays::doubles("nodes_m", &nodes)?;
    let found = tets.shape();
    if found[1] != 4 {
        let what = format!("tets: shape (m, 4) is expected, not ({}, {})", found[0], found[1]);
        return Err(Failure::input(format!("{what}; give the four vertices of each tet")));
    }
    let mut rows = Vec::with_capacity(found[0]);
    for (tet, row) in tets.as_array().rows().into_iter().enumerate() {
        let vertex = |at: usize| u32::try_from(row[at]).ok().filter(|node| (*node as usize) < nodes_m.len());
        let [Some(a), Some(b), Some(c), Some(d)] = [0, 1, 2, 3].map(vertex) else {
            let what = format!("tets: tet {tet} names a node that is not there: {row}");
            return Err(Failure::input(format!("{what}; use 0 to {}", nodes_m.len().saturating_sub(1))));
        };
        rows.push([a, b, c, d]);
    }
    let mut mesh = TetMesh::new(nodes_m, rows).map_err(explain)?;
    mesh.node_groups = groups("groups", node_groups, mesh.nodes_m.len())?;
    mesh.tet_groups = groups("regions", tet_groups, mesh.tets.len())?;
    Ok(mesh)
}

/// Groups with sorted members that exist.
fn groups(
    argument: &str,
    given: HashMap<String, Vec<u32>>,
    count: usize,
) -> Result<BTreeMap<String, Vec<u32>>, Failure> {
    let mut all = BTreeMap::new();
    for (name, mut members) in given {
        members.sort_unstable();
        members.dedup();
        if let Some(member) = members.last().filter(|last| **last as usize >= count) {
            let what = format!("{argument}: \"{name}\" has the index {member}, and there are {count}");
            return Err(Failure::input(format!("{what}; use 0 to {}", count.saturating_sub(1))));
        }
        all.insert(name, members);
    }
    Ok(all)
}

/// A fault of arrays, with its fix.
fn explain(fault: MeshFault) -> Failure {
    let fix = match fault {
        MeshFault::Empty => "give at least one tet",
        MeshFault::NotFinite { .. } => "repair the coordinate",
        MeshFault::NoSuchNode { .. } => "use the rows of nodes_m, from 0",
        MeshFault::Flat { .. } => "remove it, or mesh the body again",
        MeshFault::Negative { of_all: 1, .. } => "swap any two of its vertices",
        MeshFault::Negative { of_all, .. } => {
            return Failure::input(format!(
                "tets: {fault} (as have {} others); swap two vertices of each",
                of_all - 1
            ));
        }
        MeshFault::Repeated { .. } => "remove one of the two",
        MeshFault::Isolated { .. } => "remove it from nodes_m",
    };
    let argument = if matches!(fault, MeshFault::NotFinite { .. } | MeshFault::Isolated { .. }) {
        "nodes_m"
    } else {
        "tets"
    };
    Failure::input(format!("{argument}: {fault}; {fix}"))
}
