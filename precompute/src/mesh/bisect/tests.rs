use std::path::Path;

use super::*;
use crate::mesh::testing::{box_mesh, nodes_where};
use crate::mesh::{LengthUnit, MeshReport, Surface, read};
use crate::num::vector::{cross, difference, norm};

const MANY: usize = 1_000_000;

fn bundled(name: &str) -> TetMesh {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name);
    read(&path, LengthUnit::Metre).expect("bundled")
}

/// The mesh with tets of at most this mean edge within a distance of the places.
fn near(mesh: &TetMesh, places_m: &[[f64; 3]], within_m: f64, edge_m: f64) -> Refined {
    let near = Near::new(places_m, within_m);
    Refined::locally(mesh, MANY, |x, _| mean_edge_m(x) > edge_m && near.reaches(x)).expect("small")
}

/// Area of the triangles of the surface, and of those among `nodes`.
fn areas_m2(mesh: &TetMesh, nodes: &[u32]) -> [f64; 2] {
    let area = |all: bool| -> f64 {
        let is_in = |node: &u32| all || nodes.binary_search(node).is_ok();
        let triangles = Surface::of(mesh).triangles.into_iter().filter(|t| t.iter().all(is_in));
        let twice = triangles.map(|t| {
            let [a, b, c] = t.map(|node| mesh.nodes_m[node as usize]);
            norm(cross(difference(b, a), difference(c, a)))
        });
        0.5 * twice.sum::<f64>()
    };
    [area(true), area(false)]
}

/// Conforming: without a hanging node, every face inside has two tets and the others close a surface of the same
/// area. Tets may not overlap, as the volume is the same and every tet has a positive one.
#[track_caller]
fn assert_same_body(fine: &TetMesh, coarse: &TetMesh) {
    fine.check().expect("sound");
    let before = Surface::of(coarse);
    let after = Surface::of(fine);
    assert_eq!(fine.nodes_m[..coarse.nodes_m.len()], coarse.nodes_m, "the old nodes keep their places");
    assert!((fine.volume_m3() / coarse.volume_m3() - 1.0).abs() < 1e-12);
    assert!(after.topology.is_manifold(), "{:?}", after.topology);
    assert_eq!(after.topology.euler_characteristic, before.topology.euler_characteristic);
    let [one, other] = [areas_m2(fine, &[])[0], areas_m2(coarse, &[])[0]];
    assert!((one / other - 1.0).abs() < 1e-12, "{one} {other}");
}

#[test]
fn a_part_is_refined_and_the_mesh_stays_conforming() {
    let coarse = box_mesh([5, 4, 3], 0.01);
    let place_m = [0.02, 0.02, 0.03];
    let fine = near(&coarse, &[place_m], 0.008, 0.004);
    assert_same_body(&fine.mesh, &coarse);
    let mean_edge = |tet: usize| mean_edge_m(&fine.mesh.vertices_m(tet));
    let is_near = |tet: &usize| distance_m(&fine.mesh.vertices_m(*tet), place_m) <= 0.008;
    let (inside, outside): (Vec<usize>, Vec<usize>) = (0..fine.mesh.tets.len()).partition(is_near);
    assert!(inside.iter().all(|&tet| mean_edge(tet) <= 0.004));
    // Tets as large as before remain, so the refinement is local.
    assert!(outside.iter().filter(|&&tet| mean_edge(tet) > 0.01).count() > coarse.tets.len() / 3);
    // Children follow each other in the order of their parents, and fill them.
    for tet in 0..coarse.tets.len() as u32 {
        let children = fine.tets(&[tet]);
        let volume: f64 = children.iter().map(|&child| fine.mesh.signed_volume_m3(child as usize)).sum();
        assert!((volume / coarse.signed_volume_m3(tet as usize) - 1.0).abs() < 1e-9);
    }
    // Nothing to do: the same mesh.
    assert_eq!(near(&coarse, &[place_m], 0.008, 0.1).mesh, coarse);
    assert_eq!(near(&coarse, &[[1.0; 3]], 0.008, 0.001).mesh, coarse);
}

#[test]
fn groups_cover_the_same_part() {
    let mut coarse = box_mesh([4, 3, 3], 0.01);
    let bottom = nodes_where(&coarse, |x| x[2] == 0.0);
    coarse.node_groups.insert("bottom".into(), bottom.clone());
    coarse.tet_groups.insert("some".into(), (0..40).collect());
    let fine = near(&coarse, &[[0.02, 0.01, 0.0]], 0.01, 0.003).mesh;
    let group = &fine.node_groups["bottom"];
    assert!(group.len() > 4 * bottom.len() && group.is_sorted_by(|a, b| a < b));
    assert_eq!(*group, nodes_where(&fine, |x| x[2] == 0.0));
    let [before, after] = [areas_m2(&coarse, &bottom)[1], areas_m2(&fine, group)[1]];
    assert!((after / before - 1.0).abs() < 1e-12);
    let volume = |mesh: &TetMesh| -> f64 {
        mesh.tet_groups["some"].iter().map(|&tet| mesh.signed_volume_m3(tet as usize)).sum()
    };
    assert!((volume(&fine) / volume(&coarse) - 1.0).abs() < 1e-12);
    assert!(fine.tet_groups["some"].len() > 40);
}

/// The shape does not get worse with the number of levels: of the bundled organs, the smallest dihedral angle.
#[test]
fn the_shape_of_tets_is_bounded() {
    for (name, place_m, bound_deg) in [
        ("liver-small.msh", [-0.021, 0.0089, 0.0547], 20.0),
        ("liver-large.msh", [0.082, 0.0282, 0.0015], 20.0),
        ("scenes/strip.msh", [0.05, 0.01, 0.01], 20.0),
    ] {
        let coarse = bundled(name);
        let edge_m = MeshReport::of(&coarse).edge_m.mean;
        let mut fine = coarse.clone();
        for level in 0..7 {
            let report = MeshReport::of(&fine);
            println!(
                "{name} level {level}: {} tets, smallest dihedral {:.2}, mean {:.2}, aspect {:.2} {:.2}, jump {:.0}",
                report.tets,
                report.min_dihedral_deg.min,
                report.min_dihedral_deg.mean,
                report.aspect.mean,
                report.aspect.max,
                report.size_jumps.worst_ratio
            );
            assert!(report.min_dihedral_deg.min > bound_deg, "{}", report.min_dihedral_deg.min);
            let size = 0.5f64.powi(level + 1);
            fine = near(&fine, &[place_m], 1.5 * size * edge_m, 0.7 * size * edge_m).mesh;
        }
        assert_same_body(&fine, &coarse);
    }
}

#[test]
fn a_refinement_in_steps_is_one_refinement() {
    let coarse = bundled("liver-small.msh");
    let place_m = [-0.021, 0.0089, 0.0547];
    let at_once = near(&coarse, &[place_m], 0.03, 0.004).mesh;
    assert_eq!(near(&coarse, &[place_m], 0.03, 0.004).mesh, at_once);
    assert_eq!(near(&at_once, &[place_m], 0.03, 0.004).mesh, at_once, "nothing is left to do");
    let in_steps = near(&near(&coarse, &[place_m], 0.03, 0.01).mesh, &[place_m], 0.03, 0.004).mesh;
    assert_same_body(&in_steps, &coarse);
    let same = |tets: usize| (tets as f64 / at_once.tets.len() as f64 - 1.0).abs() < 0.05;
    assert!(same(in_steps.tets.len()), "{} {}", in_steps.tets.len(), at_once.tets.len());
}

#[test]
fn a_level_is_an_eighth_of_the_volume() {
    let coarse = bundled("liver-small.msh");
    let place_m = [-0.021, 0.0089, 0.0547];
    let within = Near::new(&[place_m], 0.02);
    let fine = Refined::locally(&coarse, MANY, |x, n| n < 2 * BISECTIONS_A_LEVEL && within.reaches(x));
    let fine = fine.expect("small");
    for tet in 0..coarse.tets.len() as u32 {
        for child in fine.tets(&[tet]) {
            let near = within.reaches(&fine.mesh.vertices_m(child as usize));
            let share = fine.mesh.signed_volume_m3(child as usize) / coarse.signed_volume_m3(tet as usize);
            assert!(!near || share < 1.001 / 64.0, "{share}");
        }
    }
    let is_coarse = |x: &[[f64; 3]; 4], n: u32| n < 12 && within.reaches(x);
    assert!(Refined::locally(&coarse, 5000, is_coarse).is_none(), "the largest size");
}

/// Near places are found whatever the cells of the grid, also inside a tet and beside its edges.
#[test]
fn near_tets_are_those_within_the_distance() {
    let mesh = box_mesh([3, 3, 3], 0.01);
    let places_m: Vec<[f64; 3]> =
        (0..40_u32).map(|n| [37, 53, 71].map(|k| f64::from(n * k % 101) / 101.0 * 0.06 - 0.015)).collect();
    for within_m in [1e-4, 3e-3, 0.02] {
        let near = Near::new(&places_m, within_m);
        let mut found = 0;
        for tet in 0..mesh.tets.len() {
            let x = mesh.vertices_m(tet);
            // Points of the tet on a net, whose spacing bounds the difference.
            let mut least = f64::INFINITY;
            for (i, j, k) in net(12) {
                let weights = [i, j, k, 12 - i - j - k].map(|n| f64::from(n) / 12.0);
                let at: [f64; 3] = std::array::from_fn(|axis| (0..4).map(|v| weights[v] * x[v][axis]).sum());
                least = places_m.iter().map(|place| distance(at, *place)).fold(least, f64::min);
            }
            let reaches = near.reaches(&x);
            found += usize::from(reaches);
            assert!(reaches || least > within_m, "{least}");
            assert!(!reaches || least < within_m + 1.5e-3, "{least}");
        }
        assert!(found > 0 && found <= mesh.tets.len());
    }
}

fn net(n: u32) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..=n).flat_map(move |i| (0..=n - i).flat_map(move |j| (0..=n - i - j).map(move |k| (i, j, k))))
}
