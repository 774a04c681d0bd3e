#[path = "../../host/tests/common/closed_loop.rs"]
mod closed_loop;
use closed_loop::*;
use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_host::device::hand::HandConfig;
use palpate_host::device::profile::Profile;
use palpate_precompute::blob_writer::{PackOptions, pack};
use palpate_precompute::configuration_space::{Expansion, SpaceGrid, Store, StoreIdentity, Workshop, with_threads};
use palpate_precompute::scene::Scene;
use palpate_precompute::solve::Problem;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

fn organ_of(scene: &Path, cells: u32, spacing: f64, method: Method) -> BlobFile {
    let scene = Scene::load(scene).expect("loads").resolve().expect("resolves");
    let body = Arc::new(scene.body().expect("a body"));
    let grid = SpaceGrid::new(spacing, spacing * f64::from(cells)).expect("grid");
    let identity = StoreIdentity {
        scene_name: scene.name.clone(),
        scene: scene.text.clone(),
        content_hash: "coarse".into(),
        mesh_hash: scene.mesh.content_hash(),
        law: "mooney-rivlin".into(),
        max_force_n: scene.max_force_n,
        spacing_m: grid.spacing_m,
        radius_m: grid.radius_m,
        visual: false,
        displacement_bound: scene.displacement_bound,
        complete_cells: true,
        increments: None,
    };
    let folder = tempfile::tempdir().expect("folder");
    let active: Vec<(String, u32)> = scene.active.iter().map(|a| (a.name.clone(), a.node)).collect();
    let store = Store::create_or_resume(&folder.path().join("a.space"), &identity, &scene.mesh, &scene.fixed, &active).expect("store");
    let problems: Vec<Arc<Problem>> = scene.active.iter().map(|a| Arc::new(Problem::with(body.clone(), Some(a.handle()), scene.constraints))).collect();
    let workshop = Arc::new(Workshop::new(move |i| problems[i].clone(), grid, scene.max_force_n, None));
    let expansion = Expansion { actives: (0..active.len()).collect(), grid, complete_cells: true };
    let t = std::time::Instant::now();
    let counts = with_threads(&workshop, 2, |crew| expansion.run(&store, crew, &AtomicBool::new(false), |_| ())).expect("runs");
    println!("{}: {counts:?} in {:?}", scene.name, t.elapsed());
    BlobFile::of(&pack(&store, &PackOptions { methods: &[method], intermediate: false, threads: 2 }).and_then(|p| p.bytes()).expect("packs"))
}

#[test]
fn probe() {
    for name in ["liver-small", "liver-large"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../assets/{name}.toml"));
        let cells = if name == "liver-small" { 2 } else { 1 };
        let file = organ_of(&path, cells, 0.02, Method::Energy);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("reads");
        for profile in ["falcon", "polhem", "omega", "touch", "desktop", "premium-1.5"] {
            let p = Profile::bundled(profile).unwrap();
            for space in 0..organ.spaces.len() {
            for depth in [0.003, 0.008, 0.015, 0.025] {
                let a = hold(&organ, Method::Energy, space, depth, &p, Cap::On);
                let b = hold(&organ, Method::Energy, space, depth, &p, Cap::Off);
                println!("{name} {space} {profile:12} {depth} cap {:6.0} stiff {:6.0} share {:.2} | on {:9.4} mm hold {:+.1e} cycle {:+.1e} peak {:.2} {:?} | off {:9.4} hold {:+.1e} cycle {:+.1e} {:?}", p.cap().n_m, a.stiffest_n_m, a.share, 1e3*a.peak_to_peak_m, a.hold_j, a.cycle_j, a.peak_n, a.phase, 1e3*b.peak_to_peak_m, b.hold_j, b.cycle_j, b.phase);
            }}
            for (h, hn) in [(HandConfig::default(), "usual"), (HandConfig::LIGHT, "light")] {
            for cap in [Cap::On, Cap::Off] {
                let r = palpate(&organ, Method::Energy, &p, h, (3, 60.0), cap);
                println!("{name} {profile:12} random {hn} {cap:?} contacts {} engaged {} peak {:.2} most {:+.2e} {:?}", r.contacts, r.engaged_ticks, r.peak_n, r.most_given_j, r.phase);
            }}
        }
    }
}
