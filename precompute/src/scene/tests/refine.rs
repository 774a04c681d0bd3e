//! `[mesh] refine = "tool"`, and the refinement of a scene near places.

use super::*;
use crate::mesh::mean_edge_m;
use crate::num::vector::distance;

const PAD: &str = "[tool]\nshape = \"fingertip\"\nradius_m = 0.08\n";
const FACE: &str = "point = [0.17, 0.3, 0.12]";
const REFINE: &str = "refine = \"tool\"\n";

/// A scene with keys of [mesh], a place of its first active node, and a pad; its second active node is removed.
fn scene(keys: &str, active: &str) -> String {
    let text = SCENE.replacen("unit = \"cm\"\n", &format!("unit = \"cm\"\n{keys}"), 1);
    let text = text.replacen("[[active]]\nname = \"A2\"\nnearest = [0.31, 0.1, 0.1]\n", "", 1);
    text.replacen("node = 63", active, 1) + PAD
}

/// Largest mean edge of the tets with a vertex within two radii of a place.
fn edge_near_m(scene: &ResolvedScene, place_m: [f64; 3]) -> f64 {
    let vertices = (0..scene.mesh.tets.len()).map(|tet| scene.mesh.vertices_m(tet));
    let near = vertices.filter(|x| x.iter().any(|x| distance(*x, place_m) <= 2.0 * 0.08));
    near.map(|x| mean_edge_m(&x)).fold(0.0, f64::max)
}

/// Area of the fixed part of the surface, m2.
fn fixed_area_m2(scene: &ResolvedScene) -> f64 {
    let mut part = scene.mesh.clone();
    let is_fixed = |node: &u32| scene.fixed.binary_search(node).is_ok();
    // The tets behind the fixed triangles, as flat bodies of which only the area is used.
    part.tets.retain(|tet| tet.iter().filter(|node| is_fixed(node)).count() == 3);
    let areas = part.tets.iter().map(|tet| {
        let face: Vec<u32> = tet.iter().copied().filter(|node| is_fixed(node)).collect();
        let apex = tet.iter().copied().find(|node| !is_fixed(node)).expect("one is free");
        let height = scene.mesh.nodes_m[apex as usize][0];
        let x: [[f64; 3]; 4] =
            std::array::from_fn(|k| scene.mesh.nodes_m[face.get(k).copied().unwrap_or(apex) as usize]);
        crate::mesh::tetrahedral::six_volume(&x).abs() / (2.0 * height)
    });
    areas.sum()
}

#[test]
fn the_mesh_is_fine_near_the_tool() {
    let bench = Bench::new();
    let coarse = bench.resolve(&scene("", FACE)).expect("sound");
    assert_eq!(coarse.unrefined, None);
    let place_m = [0.17, 0.3, 0.12];
    assert!(edge_near_m(&coarse, place_m) > 0.12);
    let mut tets = Vec::new();
    for (keys, key, order, edge_m) in [
        ("", "1", ElementOrder::Linear, 0.4 * 0.08),
        ("", "2", ElementOrder::Quadratic, 0.8 * 0.08),
        ("", "\"tool\"", ElementOrder::NearTool, 0.8 * 0.08),
        ("refine_edge_m = 0.05\n", "2", ElementOrder::Quadratic, 0.05),
    ] {
        let text = scene(&format!("{REFINE}{keys}"), FACE).replace("order = 1", &format!("order = {key}"));
        let fine = bench.resolve(&text).expect("sound");
        assert!(edge_near_m(&fine, place_m) <= edge_m && edge_near_m(&fine, place_m) > 0.5 * edge_m);
        let size = MeshSize { nodes: 64, tets: 162 };
        assert_eq!((fine.unrefined, fine.order), (Some(size), order));
        let words = fine.size_in_words();
        assert!(words.starts_with("64 nodes, 162 tets; refined near the tool: "), "{words}");
        assert_eq!(coarse.size_in_words(), "64 nodes, 162 tets");
        assert!((fine.active[0].place_m(&fine.mesh)[1] - 0.3).abs() < 1e-12);
        assert!((fixed_area_m2(&fine) / 0.09 - 1.0).abs() < 1e-9, "{}", fixed_area_m2(&fine));
        tets.push(fine.mesh.tets.len());
        // A stored mesh is not refined again, though its scene says so.
        let stored = Scene::parse(&bench.path("elsewhere/block.toml"), fine.text.clone()).expect("sound");
        let again = stored.resolve_in(fine.mesh.clone(), fine.fixed.clone()).expect("sound");
        assert_eq!(again.content_hash(), fine.content_hash());
        assert_eq!(again, ResolvedScene { unrefined: None, ..fine });
    }
    assert!(tets[0] > tets[3] && tets[3] > tets[1] && tets[1] > 2 * 162, "{tets:?}");
    assert_eq!(tets[1], tets[2]);
}

#[test]
fn sizes_have_commas_between_thousands() {
    let size = |nodes, tets| MeshSize { nodes, tets }.to_string();
    assert_eq!(size(4, 999), "4 nodes, 999 tets");
    assert_eq!(size(1_000, 23_045), "1,000 nodes, 23,045 tets");
    assert_eq!(size(123_456, 2_000_000), "123,456 nodes, 2,000,000 tets");
}

#[test]
fn every_selection_of_a_scene_means_the_same_part() {
    let bench = Bench::new();
    let refined = |text: &str| bench.resolve(text).expect("sound");
    let keys = format!("{REFINE}refine_edge_m = 0.06\n");
    let by_group = refined(&scene(&keys, "point = [0.02, 0.3, 0.12]"));
    let left = |x: &[f64; 3]| x[0] == 0.0;
    assert!(
        by_group.fixed.len() > 16 && by_group.fixed.iter().all(|&n| left(&by_group.mesh.nodes_m[n as usize]))
    );
    let all: Vec<String> = (0..16).map(|n| n.to_string()).collect();
    let nodes = format!("nodes = [{}]", all.join(", "));
    // A box fixes what it held before: no node on the way to the next layer.
    for fixed in [&nodes, "box = { min = [-1, -1, -1], max = [0.099, 1, 1] }"] {
        let text = scene(&keys, "point = [0.02, 0.3, 0.12]").replacen("group = \"left\"", fixed, 1);
        assert_eq!(refined(&text).fixed, by_group.fixed, "{fixed}");
    }
    // A node keeps its number, and a group its part of the skin, all of which is fine.
    let node = refined(&scene(&keys, "node = 63"));
    assert_eq!((node.active[0].node, node.active[0].place_m(&node.mesh)), (63, [0.3; 3]));
    let group = refined(&scene(&keys, "group = \"right\""));
    let cover = group.cover.clone().expect("a group");
    let right: Vec<u32> = (0..group.mesh.nodes_m.len() as u32)
        .filter(|&node| group.mesh.nodes_m[node as usize][0] == 0.3)
        .collect();
    assert_eq!(cover.nodes, right);
    assert!(right.iter().all(|&node| edge_near_m(&group, group.mesh.nodes_m[node as usize]) <= 0.06));
    // Also between nodes that are farther apart than the pad reaches.
    let text = scene(&format!("{REFINE}refine_edge_m = 0.03\n"), "group = \"right\"");
    let group = refined(&text.replace("radius_m = 0.08", "radius_m = 0.02"));
    let on_right = |tet: &usize| group.mesh.vertices_m(*tet).iter().any(|x| x[0] == 0.3);
    let mut edges =
        (0..group.mesh.tets.len()).filter(on_right).map(|t| mean_edge_m(&group.mesh.vertices_m(t)));
    assert!(edges.all(|edge_m| edge_m <= 0.03));
}

#[test]
fn regions_keep_their_volume() {
    let bench = regions::bench();
    let text = regions::scene("cube.vtk", &format!("{}\n{REFINE}", regions::PARTS), &["1", "2", "10"]);
    let text =
        text.replacen("node = 63", FACE, 1).replacen("nearest = [0.31, 0.1, 0.1]", "node = 48", 1) + PAD;
    let fine = bench.resolve(&text).expect("sound");
    let volumes = |scene: &ResolvedScene| -> Vec<f64> {
        let of = |tets: &Vec<u32>| tets.iter().map(|&tet| scene.mesh.signed_volume_m3(tet as usize)).sum();
        scene.materials.iter().map(|region| of(region.tets.as_ref().expect("a group"))).collect()
    };
    let expected = [144.0, 6.0, 12.0].map(|tets| tets * 1e-3 / 6.0);
    for scene in [&fine, &fine.refined(), &fine.refined_near(&[[0.3; 3]], 0.05, 2).expect("small")] {
        assert!(volumes(scene).iter().zip(expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-9));
        let [place, own] = [scene, &fine].map(|scene| scene.active[0].place_m(&scene.mesh));
        assert!(distance(place, own) < 1e-12);
        let triangle = scene.active[0].contact.expect("a contact point").triangle;
        assert!(Surface::of(&scene.mesh).triangles.contains(&triangle), "a face of the finer skin");
        scene.body().expect("it can be solved");
    }
}

#[test]
fn a_scene_is_refined_near_places() {
    let bench = Bench::new();
    let text = scene("", FACE).replacen(PAD, "", 1).replacen(FACE, "node = 63\npatch_radius_m = 0.11", 1);
    let coarse = bench.resolve(&text).expect("sound");
    assert_eq!(coarse.active[0].patch.len(), 4);
    let fine = coarse.refined_near(&[[0.3; 3]], 0.1, 1).expect("small");
    assert_eq!(fine.fixed, coarse.fixed, "far away");
    // The patch is as large as before: the ends of its three edges and the nodes between them.
    assert!(fine.active[0].patch.len() > 4);
    let largest = |scene: &ResolvedScene| {
        let place_m = |node: u32| scene.mesh.nodes_m[node as usize];
        scene.active[0].patch.iter().map(|&n| distance(place_m(n), place_m(63))).fold(0.0, f64::max)
    };
    assert!((largest(&fine) - largest(&coarse)).abs() < 1e-12);
    assert!((edge_near_m(&fine, [0.3; 3]) / edge_near_m(&coarse, [0.3; 3])) < 1.0);
}

#[test]
fn a_refinement_that_means_nothing_is_refused() {
    let bench = Bench::new();
    let refuses = |keys: &str, active: &str, tool: &str, line: usize, what: &str, fix: &str| {
        let text = scene(keys, active).replacen(PAD, tool, 1);
        let error = bench.resolve(&text).expect_err("refused").to_string();
        assert!(error.contains(&format!("block.toml:{line}: ")), "{error}");
        assert!(error.contains(what) && error.contains(fix) && !error.contains('\n'), "{error}");
    };
    refuses(REFINE, "node = 63", "", 5, "needs a tool with a size", "add [tool] with shape = \"fingertip\"");
    refuses("refine_edge_m = 0.01\n", FACE, PAD, 5, "no effect without `refine`", "add `refine = \"tool\"`");
    let keys = |edge: &str| format!("{REFINE}refine_edge_m = {edge}\n");
    refuses(&keys("0.0"), FACE, PAD, 6, "is not a positive number", "correct the value");
    refuses(&keys("1e-5"), FACE, PAD, 6, "need more than 2,000,000 tets", "a larger `refine_edge_m`");
    refuses("refine = \"all\"\n", FACE, PAD, 5, "unknown word \"all\"", "use \"tool\"");
}
