//! Blobs of real scenes on coarse grids.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::available_parallelism;

use palpate_core::Method;
use palpate_host::BlobFile;
use palpate_precompute::fem::Problem;
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::scene::ResolvedScene;
use palpate_precompute::space::{Store, StoreIdentity, WorkerContext, expand, with_threads};
use palpate_precompute::spec::{Lattice, Sampling, SpaceGrid};

/// Solves every active node of a scene on this grid and packs it for these methods, without displacements.
///
/// # Panics
///
/// If any step fails.
pub fn coarse_blob(scene: &ResolvedScene, grid: SpaceGrid, methods: &[Method]) -> BlobFile {
    let sampling = Sampling::Lattice(Lattice { grid, complete_cells: true, increments: None });
    let identity = StoreIdentity {
        scene_name: scene.name.clone(),
        scene: scene.text.clone(),
        content_hash: "coarse".into(),
        mesh_hash: scene.mesh.content_hash(),
        law: "as in the scene".into(),
        max_force_n: scene.max_force_n,
        sampling,
        normals: Vec::new(),
        visited_m: Vec::new(),
        contacts: scene.contacts(),
        charts: scene.charts.clone(),
        visual: false,
        displacement_bound: scene.displacement_bound,
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let active: Vec<(String, u32)> =
        scene.active.iter().map(|active| (active.name.clone(), active.node)).collect();
    let file = folder.path().join("coarse.space");
    let store = Store::create_or_resume(&file, &identity, &scene.mesh, &scene.fixed, &active);
    let store = store.expect("the store opens");
    let body = Arc::new(scene.body().expect("the body is valid"));
    let problems: Vec<Arc<Problem>> =
        scene.active.iter().map(|active| scene.problem(&body, active)).collect();
    let context = WorkerContext::new(move |active, _| problems[active].clone(), sampling, scene.max_force_n);
    let actives: Vec<usize> = (0..active.len()).collect();
    let threads = available_parallelism().map_or(1, std::num::NonZero::get);
    let counts = with_threads(&Arc::new(context), threads, |executor| {
        expand(&actives, &store, executor, &AtomicBool::new(false), |_| ())
    });
    for count in counts.expect("the run completes") {
        assert!(count.solved() >= 20, "{}: {count:?}", scene.name);
    }
    let options = PackOptions { methods, use_intermediate_states: false, threads };
    let bytes = pack(&store, &options).and_then(|packed| packed.bytes()).expect("the space packs");
    BlobFile::of(&bytes)
}
