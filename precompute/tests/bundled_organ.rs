//! The bundled scenes and meshes resolve and agree with their README.

use std::path::PathBuf;

use palpate_precompute::adaptive::Search;
use palpate_precompute::fem::material::{Material, MooneyRivlin};
use palpate_precompute::mesh::{MeshReport, Surface};
use palpate_precompute::num::EnergyJet;
use palpate_precompute::pipeline::{Analysis, Run};
use palpate_precompute::scene::Scene;
use palpate_precompute::space::{Store, state};
use palpate_precompute::spec::{Lattice, Quantity, Requirements, Sampling, SpaceGrid, Tolerance};

fn asset(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name)
}

#[test]
fn both_organs_resolve_without_a_warning() {
    for (name, a1, a2) in [("liver-small", 199, 336), ("liver-large", 337, 559)] {
        let scene = Scene::load(&asset(&format!("{name}.toml"))).and_then(|scene| scene.resolve());
        let scene = scene.unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(scene.name, name);
        assert_eq!(scene.warnings, Vec::<String>::new());
        let law = MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 };
        assert_eq!(scene.materials[0].material, Material::MooneyRivlin(law));
        assert_eq!(scene.fixed, scene.mesh.node_groups["F1"]);
        let active: Vec<_> = scene.active.iter().map(|a| (a.name.as_str(), a.node)).collect();
        assert_eq!(active, [("A1", a1), ("A2", a2)]);
        assert_eq!(
            scene.grid,
            Some(Sampling::Lattice(Lattice {
                grid: SpaceGrid::new(0.01, 0.05).expect("a lattice"),
                complete_cells: true,
                increments: None
            }))
        );
        assert_eq!(scene.mesh.node_groups["surface"], Surface::of(&scene.mesh).nodes);
        assert_eq!(scene.mesh.tet_groups["tissue"].len(), scene.mesh.tets.len());
    }
}

#[test]
fn the_small_organ_measures_what_its_readme_says() {
    let scene = Scene::load(&asset("liver-small.toml")).and_then(|scene| scene.resolve()).expect("sound");
    let report = MeshReport::of(&scene.mesh);
    assert_eq!((report.nodes, report.tets, report.pieces), (498, 1795, 1));
    assert!(report.surface.manifold);
    assert_eq!((report.surface.topology.euler_characteristic, report.surface.nodes), (2, 347));
    assert_eq!(report.tets_without_interior_vertex, 0);
    assert!((report.high_m[0] - report.low_m[0] - 0.2).abs() < 1e-12);
    // The script that generated the mesh computed the README's values in another language: an independent
    // check.
    let near = |value: f64, stated: f64, digit: f64| (value - stated).abs() <= 0.5001 * digit;
    assert!(near(report.volume_m3, 1.230298e-3, 1e-9), "{}", report.volume_m3);
    assert!(near(report.dihedral_deg.min, 35.1, 0.1), "{}", report.dihedral_deg.min);
    assert!(near(report.edge_m.min, 8.4e-3, 1e-4), "{}", report.edge_m.min);
    assert!(near(report.edge_m.max, 31.3e-3, 1e-4), "{}", report.edge_m.max);
    assert!(near(report.edge_m.mean, 18.1e-3, 1e-4), "{}", report.edge_m.mean);
    assert!(near(report.tet_volume_m3.min, 139e-9, 1e-9), "{}", report.tet_volume_m3.min);
    assert!(near(report.tet_volume_m3.mean, 685e-9, 1e-9), "{}", report.tet_volume_m3.mean);
    let normal = Surface::of(&scene.mesh).normal(199).expect("A1 is on the surface");
    for (found, stated) in normal.into_iter().zip([-0.05, 0.13, 0.99]) {
        assert!(near(found, stated, 0.01), "{normal:?}");
    }
}

/// A body that sags under its weight, with a tool that only pushes. The positions are limited by the normal
/// of the body at rest, which the blob contains too, and not by that of the undeformed mesh.
#[test]
fn a_sagged_body_is_pushed_against_its_normal_at_rest() {
    let path = asset("scenes/gravity.toml");
    // Linear elements, which take a tenth of the time: this is about normals.
    let text = std::fs::read_to_string(&path).expect("bundled").replace("order = 2", "order = 1");
    let scene = Scene::parse(&path, text).and_then(|scene| scene.resolve()).expect("sound");
    let (mut mesh, node) = (scene.mesh.clone(), scene.active[0].node);
    let analysis = Analysis::of_scene(&path, scene).expect("it rests");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let space = folder.path().join("sagged.space");
    analysis.solve_all(&space, Run::run_to_end()).expect("solved");
    let store = Store::open(&space).expect("just made");
    let fit = state(&store, 0).expect("readable").fit.expect("adaptive");
    let push = fit.wanted.push.expect("the tool pushes");

    let normal = |mesh: &_| Surface::of(mesh).normal(node).expect("on the surface");
    let apart = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
    let of_the_mesh = normal(&mesh);
    let rest = store.displacements(0, [0; 3], 0).expect("rest is solved");
    for (x, moved) in mesh.nodes_m.iter_mut().zip(rest) {
        *x = std::array::from_fn(|axis| x[axis] + f64::from(moved[axis]));
    }
    let at_rest = normal(&mesh);
    assert!(apart(at_rest, of_the_mesh) > 1e-3, "the body does not sag: {at_rest:?}");
    assert!(apart(push, at_rest) < 1e-6, "{push:?} {at_rest:?} {of_the_mesh:?}");
}

/// Refused before the first solve, because a blob cannot hold the solved spaces.
#[test]
fn more_active_nodes_than_a_blob_holds_are_refused() {
    let path = asset("liver-large.toml");
    let text = std::fs::read_to_string(&path).expect("bundled");
    let text =
        text.replace("node = 337", "group = \"surface\"").replace("group = \"F1\"", "nodes = [0, 1, 2]");
    let error = Scene::parse(&path, text)
        .and_then(|scene| scene.resolve())
        .map(|_| ())
        .expect_err("too many")
        .to_string();
    assert!(error.contains("liver-large.toml:23: the scene has 575"), "{error}");
    assert!(error.contains("active nodes, and a blob holds 512; choose a smaller group"), "{error}");
}

/// All bits of the search positions and of the fit, identical on every platform: they use no function of the
/// platform's C library.
#[test]
fn a_search_looks_at_the_same_positions_on_every_platform() {
    let wanted = Requirements {
        tolerance: Tolerance::IMPERCEPTIBLE,
        radius_m: 0.03,
        max_force_n: 1.0,
        push: None,
        workspace_m: None,
        column: None,
        quantity: Quantity::Energy,
        max_configurations: 100,
    };
    let mut numbers = [0.0; 20];
    [numbers[4], numbers[7], numbers[9], numbers[10], numbers[15]] = [90.0, 110.0, 140.0, 1e3, -2e3];
    let search = Search::new(wanted, &EnergyJet::from_numbers([0.0; 3], &numbers));
    let mut bits = 0u64;
    let places = search.fitted.places(600);
    for number in places.iter().flat_map(|&at| [at, search.fitted.fit.force_n(at)]).flatten() {
        bits = bits.rotate_left(5).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ number.to_bits();
    }
    assert_eq!((places.len(), bits), (768, 11_294_760_458_309_729_229));
}
