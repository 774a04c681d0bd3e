//! A small configuration space for the tests: two cells around the soft beam's active node.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palpate_precompute::fem::Problem;
use palpate_precompute::mesh::Surface;
use palpate_precompute::space::{
    ExpansionError, Progress, Store, StoreError, StoreIdentity, TagCounts, WorkerContext, expand, state,
    with_threads,
};
use palpate_precompute::spec::{DisplacementBound, Lattice, Sampling, SpaceGrid};

use crate::{mooney_rivlin, soft_beam};

/// A space of two cells around the soft beam's active node.
pub struct SpaceBench {
    /// The mesh of the beam.
    pub mesh: palpate_precompute::mesh::TetMesh,
    /// Its fixed nodes.
    pub fixed: Vec<u32>,
    /// Its active node.
    pub active: u32,
    /// Its finite-element problem.
    pub problem: Arc<Problem>,
    /// The grid.
    pub grid: SpaceGrid,
    /// The identity of the store.
    pub identity: StoreIdentity,
}

impl SpaceBench {
    /// The test space with a force limit, N.
    pub fn new(max_force_n: f64) -> Self {
        let (mesh, fixed, active, body) = soft_beam(mooney_rivlin());
        let grid = SpaceGrid::new(0.005, 0.01).expect("the grid is valid");
        let identity = StoreIdentity {
            scene_name: "beam".into(),
            scene: String::new(),
            content_hash: format!("{max_force_n}"),
            mesh_hash: mesh.content_hash(),
            law: "mooney-rivlin".into(),
            max_force_n,
            sampling: Sampling::Lattice(Lattice { grid, complete_cells: true, increments: None }),
            normals: vec![Surface::of(&mesh).normal(active).expect("the active node is on the surface")],
            visited_m: Vec::new(),
            contacts: None,
            charts: None,
            visual: true,
            displacement_bound: DisplacementBound::default(),
        };
        Self { problem: Arc::new(Problem::new(body, active)), mesh, fixed, active, grid, identity }
    }

    /// Splits every transition into `parts` equal increments, and leaves cells incomplete.
    pub fn in_parts(&mut self, parts: u32) {
        let lattice = Lattice { grid: self.grid, complete_cells: false, increments: Some(parts) };
        self.identity.sampling = Sampling::Lattice(lattice);
    }

    /// Its store at `path`.
    pub fn store(&self, path: &Path) -> Result<Store, StoreError> {
        let active = [("A".to_string(), self.active)];
        Store::create_or_resume(path, &self.identity, &self.mesh, &self.fixed, &active)
    }

    /// The context of the workers.
    pub fn context(&self) -> Arc<WorkerContext> {
        let problem = self.problem.clone();
        Arc::new(WorkerContext::new(
            move |_, _| problem.clone(),
            self.identity.sampling,
            self.identity.max_force_n,
        ))
    }

    /// Expands the space until done or stopped.
    pub fn expand(
        &self,
        store: &Store,
        threads: usize,
        stop: &AtomicBool,
        progress: impl FnMut(&Progress),
    ) -> Result<TagCounts, ExpansionError> {
        let context = self.context();
        with_threads(&context, threads, |executor| expand(&[0], store, executor, stop, progress))
            .map(|all| all[0])
    }

    /// Its store at `path`, complete.
    pub fn solve(&self, path: &Path, threads: usize) -> (Store, TagCounts) {
        let store = self.store(path).expect("the store opens");
        let counts =
            self.expand(&store, threads, &AtomicBool::new(false), |_| ()).expect("the run completes");
        (store, counts)
    }

    /// Number of configurations that are not yet solved.
    pub fn still_to_solve(&self, store: &Store) -> usize {
        state(store, 0).expect("records").open
    }
}
