//! Measures with known exact values, and a mesh for each warning.

use super::shape::dihedral_angles_deg;
use super::*;
use crate::mesh::testing::{cube, unit_tet};

#[test]
fn dihedral_angles_of_known_tets() {
    let (nodes, _) = unit_tet();
    let corner = dihedral_angles_deg(&[nodes[0], nodes[1], nodes[2], nodes[3]]);
    let slant = 3f64.sqrt().recip().acos().to_degrees();
    for (angle, expected) in corner.iter().zip([90.0, 90.0, 90.0, slant, slant, slant]) {
        assert!((angle - expected).abs() < 1e-12, "{corner:?}");
    }
    let regular = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    for angle in dihedral_angles_deg(&regular) {
        assert!((angle - (1.0f64 / 3.0).acos().to_degrees()).abs() < 1e-12);
    }
}

#[test]
fn a_cube_reports_what_can_be_counted_by_hand() {
    let mut mesh = cube(2, 0.2);
    mesh.node_groups.insert("base".into(), vec![0, 1]);
    let report = MeshReport::of(&mesh);
    assert_eq!((report.nodes, report.tets, report.pieces), (27, 48, 1));
    assert_eq!((report.surface.nodes, report.surface.triangles), (26, 48));
    assert!(report.surface.manifold);
    assert!((report.volume_m3 - 8e-3).abs() < 1e-17);
    assert!((report.tet_volume_m3.min - 1e-3 / 6.0).abs() < 1e-17);
    assert!((report.edge_m.min - 0.1).abs() < 1e-16);
    assert!((report.edge_m.max - 0.1 * 3f64.sqrt()).abs() < 1e-16);
    // Kuhn tets have two dihedral angles of 45 degrees, one of 60 and three of 90.
    assert!((report.dihedral_deg.min - 45.0).abs() < 1e-10);
    assert!((report.dihedral_deg.max - 90.0).abs() < 1e-10);
    assert_eq!(report.dihedral_histogram.iter().sum::<usize>(), 6 * 48);
    // The main diagonal of each cell ends in the only interior node or connects two surface nodes.
    let centre = 13;
    let without = mesh.tets.iter().filter(|tet| !tet.contains(&centre)).count();
    assert_eq!(report.tets_without_interior_vertex, without);
    assert_eq!(report.groups, [GroupReport { name: "base".into(), nodes: 2, tets: 0 }]);
    // Euler: V - E + F - T = 1, with F = (4 T + 48) / 2 faces.
    assert_eq!(report.edges, 27 + (4 * 48 + 48) / 2 - 48 - 1);
    assert_eq!(report.pieces, 1);
    assert_eq!(report.largest_piece_share, 1.0);
    // Each side of the cube has 8 outer faces: 48 triangles.
    let free: usize = report.tets_by_free_faces.iter().enumerate().map(|(n, tets)| n * tets).sum();
    assert_eq!((free, report.tets_by_free_faces.iter().sum::<usize>()), (48, 48));
    assert_eq!(report.min_dihedral_histogram[9], 48, "45 degrees, all of them: {report:?}");
    assert!((report.min_dihedral_deg.median - 45.0).abs() < 1e-10);
    // 54 edges along the axes, 36 across squares, 8 across cells.
    assert!((report.edge_m.median - 0.1).abs() < 1e-16);
    assert!((report.size_jumps.worst_ratio - 1.0).abs() < 1e-12);
    assert_eq!((report.slivers.below_5_deg, report.slivers.below_1_deg), (0, 0));
    let (short, text) = (report.to_string(), format!("{report:#}"));
    assert!(text.starts_with(&short), "{text}");
    assert!(text.contains("nodes           27 (26 on the surface, 96 %)"), "{text}");
    assert!(text.contains("\"base\" (2 nodes)"), "{text}");
    assert!(text.contains(&format!("\n  45 - 50        48 |{}\n", "#".repeat(50))), "{text}");
    let table = text.lines().filter(|line| !line.starts_with("warning"));
    assert!(table.clone().count() > 30 && table.clone().all(|line| line.chars().count() <= 80), "{text}");
}

#[test]
fn aspect_is_one_in_a_regular_tet_and_known_in_the_corner() {
    let regular = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    assert!((aspect(&regular) - 1.0).abs() < 1e-14);
    let (nodes, _) = unit_tet();
    // V = 1/6, A = 3/2 + sqrt(3)/2, longest edge sqrt(2).
    let radius = 0.5 / (1.5 + 0.75f64.sqrt());
    let expected = 2f64.sqrt() / (2.0 * 6f64.sqrt() * radius);
    assert!((aspect(&[nodes[0], nodes[1], nodes[2], nodes[3]]) - expected).abs() < 1e-14);
}

/// Two tets on one triangle; their tips lie at these heights above and below its point (1/4, 1/4).
fn kite(top: f64, bottom: f64) -> TetMesh {
    let (mut nodes, tets) = unit_tet();
    nodes[3] = [0.25, 0.25, top];
    nodes.push([0.25, 0.25, -bottom]);
    TetMesh::new(nodes, vec![tets[0], [0, 2, 1, 4]]).expect("sound")
}

#[track_caller]
fn assert_warns(mesh: &TetMesh, words: &[&str]) {
    let warnings = MeshReport::of(mesh).warnings();
    let found = warnings.iter().any(|warning| words.iter().all(|word| warning.contains(word)));
    assert!(found, "no warning has {words:?}: {warnings:#?}");
    assert!(warnings.iter().all(|warning| !warning.contains('\n')));
}

#[test]
fn slivers_and_jumps_of_size_are_counted_at_their_bounds() {
    // Seen from (1/4, 1/4), the hypotenuse is the farthest edge, at a distance of 1/sqrt(8): its angle is the
    // smallest.
    let at_slant = |deg: f64| deg.to_radians().tan() / 8f64.sqrt();
    let slivers = |deg: f64| {
        let slivers = MeshReport::of(&kite(at_slant(deg), 1.0)).slivers;
        (slivers.below_5_deg, slivers.below_1_deg)
    };
    assert_eq!(slivers(5.01), (0, 0));
    assert_eq!(slivers(4.99), (1, 0));
    assert_eq!(slivers(0.99), (1, 1));
    assert_warns(
        &kite(at_slant(0.99), 1.0),
        &["1 sliver has", "1 of them below 1", "tet 0", "0.99", "optimise"],
    );

    assert_eq!(MeshReport::of(&kite(0.5, 49.9)).size_jumps.pairs, 0);
    let jump = MeshReport::of(&kite(0.5, 50.1)).size_jumps;
    assert_eq!((jump.pairs, jump.worst_pair), (1, [0, 1]));
    assert!((jump.worst_ratio - 100.2).abs() < 1e-9);
    assert_warns(&kite(0.5, 50.1), &["1 pair", "100 times apart", "tets 0 and 1", "grade"]);
}

#[test]
fn pieces_bad_surfaces_and_hanging_tets_are_told() {
    let one = cube(2, 0.1);
    let assert_silent = |mesh: &TetMesh, word: &str| {
        let warnings = MeshReport::of(mesh).warnings();
        assert!(!warnings.iter().any(|warning| warning.contains(word)), "{warnings:?}");
    };
    for word in ["pieces", "manifold", "hang", "sliver", "apart"] {
        assert_silent(&one, word);
    }
    // A separate tet next to the cube, then a tet that shares one node with the cube.
    let beside = |corner: [f64; 3], shared: Option<u32>| {
        let mut mesh = one.clone();
        let n = mesh.nodes_m.len() as u32;
        let steps = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
        let from = usize::from(shared.is_some());
        for step in &steps[from..] {
            mesh.nodes_m.push(std::array::from_fn(|axis| corner[axis] + step[axis]));
        }
        mesh.tets.push(match shared {
            Some(node) => [node, n, n + 1, n + 2],
            None => [n, n + 1, n + 2, n + 3],
        });
        mesh.check().expect("every single tet is valid");
        mesh
    };
    assert_warns(&beside([1.0; 3], None), &["2 separate pieces", "85.7 % of the volume", "merge"]);
    assert_warns(&beside([1.0; 3], None), &["1 tet with three or four faces", "hangs"]);
    let touching = beside([0.1; 3], Some(26));
    assert_silent(&touching, "pieces");
    assert_warns(&touching, &["not a closed manifold", "1 bad node", "rotate about"]);
    assert_warns(&cube(1, 0.1), &["100 % of the nodes are on the surface", "refine"]);
    assert_warns(&cube(1, 0.1), &["6 of 6 tets have no vertex inside the body"]);
}

#[test]
fn the_bundled_organs_have_nothing_to_complain_of() {
    for name in ["liver-small.msh", "liver-large.msh"] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name);
        let mesh = crate::mesh::read(&path, crate::mesh::LengthUnit::Metre).expect("sound");
        let report = MeshReport::of(&mesh);
        assert_eq!(report.warnings(), Vec::<String>::new(), "{name}");
        assert!(report.to_string().starts_with("no warnings\n"));
        // Euler: V - E + F - T = 1 for a ball, with F = (4 T + boundary triangles) / 2.
        let faces = (4 * report.tets + report.surface.triangles) / 2;
        assert_eq!(report.nodes + faces, 1 + report.edges + report.tets, "{name}");
        assert_eq!(doubtful_for_pressure(&mesh, &mesh.node_groups["F1"]).undetermined_pressures, 0);
    }
}

#[test]
fn doubts_about_pressures_follow_surface_shape_and_fixed_nodes() {
    let mesh = cube(2, 0.1);
    let none = doubtful_for_pressure(&mesh, &[]);
    let without = MeshReport::of(&mesh).tets_without_interior_vertex;
    let counted = |d: super::pressure::PressureDoubts| {
        (d.without_interior_vertex, d.all_fixed, d.undetermined_pressures)
    };
    assert_eq!((none.tets, counted(none), none.slivers_below_5_deg), (48, (without, 0, 0), 0));
    // The eight corners of the low cell: its six tets are rigid, and the low corner belongs to no other tet.
    let cell = [0, 1, 3, 4, 9, 10, 12, 13];
    assert_eq!(counted(doubtful_for_pressure(&mesh, &cell)), (without, 6, 1));
    let all: Vec<u32> = (0..27).collect();
    let rigid = doubtful_for_pressure(&mesh, &all);
    assert_eq!(counted(rigid), (without, 48, 27));
    let warning = rigid.warning().expect("a warning");
    assert!(warning.contains("48 have all vertices fixed") && warning.contains("27 nodes"), "{warning}");
    assert!(!warning.contains('\n') && !warning.contains("dihedral"), "{warning}");
    let flat = doubtful_for_pressure(&kite(0.01, 1.0), &[]);
    assert_eq!((flat.slivers_below_5_deg, flat.without_interior_vertex), (1, 2));
    // In a finer cube, the nodes with all three indices from 1 to 3 are inside.
    let fine = cube(4, 0.1);
    let inside = |node: &u32| [node / 25, node / 5 % 5, node % 5].iter().all(|c| (1..4).contains(c));
    let without = fine.tets.iter().filter(|tet| !tet.iter().any(inside)).count();
    assert!(without > 0);
    assert_eq!(doubtful_for_pressure(&fine, &[]).without_interior_vertex, without);
    let sound = super::pressure::PressureDoubts { without_interior_vertex: 0, ..none };
    assert_eq!(sound.warning(), None);
}
