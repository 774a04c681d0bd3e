//! Regions from the cell data of a mesh file.

use std::fmt::Write as _;

use super::*;

/// The cube as a legacy file in centimetres. `part` is 2 in the first six tets, 10 in the next twelve, else 1;
/// two triangles come before the tets.
fn vtk(part: &str) -> String {
    let mesh = cube(3, 30.0);
    let mut text = String::from("# vtk DataFile Version 4.2\ncube\nASCII\nDATASET UNSTRUCTURED_GRID\n");
    writeln!(text, "POINTS {} double", mesh.nodes_m.len()).expect("to memory");
    for [x, y, z] in &mesh.nodes_m {
        writeln!(text, "{x} {y} {z}").expect("to memory");
    }
    let n = mesh.tets.len();
    writeln!(text, "CELLS {} {}\n3 0 1 4\n3 1 4 5", n + 2, 5 * n + 8).expect("to memory");
    for [a, b, c, d] in &mesh.tets {
        writeln!(text, "4 {a} {b} {c} {d}").expect("to memory");
    }
    writeln!(text, "CELL_TYPES {}\n5 5{}\nCELL_DATA {}", n + 2, " 10".repeat(n), n + 2).expect("to memory");
    writeln!(text, "FIELD FieldData 2\n{part} 1 {} int\n77 77", n + 2).expect("to memory");
    text.push_str(&format!("{}{}{}", "2 ".repeat(6), "10 ".repeat(12), "1 ".repeat(n - 18)));
    writeln!(text, "\ndensity 1 {} double\n0.5 0.5{}", n + 2, " 1.5".repeat(n)).expect("to memory");
    text
}

const MATERIAL: &str = "[material]\nlaw = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0\n";

/// The scene with the file, with `regions`, and with a material for each of `groups`.
pub(super) fn scene(mesh: &str, regions: &str, groups: &[&str]) -> String {
    let one = |group: &&str| MATERIAL.replace("[material]", &format!("[[material]]\ngroup = \"{group}\""));
    let materials = groups.iter().map(one).collect::<String>();
    let text = SCENE.replacen("cube.msh\"\n", &format!("{mesh}\"\n{regions}\n"), 1);
    let text = text.replacen("group = \"left\"", "box = { min = [0, 0, 0], max = [0, 1, 1] }", 1);
    if groups.is_empty() { text } else { text.replacen(MATERIAL, &materials, 1) }
}

pub(super) const PARTS: &str = "regions = \"part\"";

pub(super) fn bench() -> Bench {
    let bench = Bench::new();
    bench.write("cube.vtk", &vtk("part"));
    bench
}

#[track_caller]
fn refuses(bench: &Bench, text: &str, place: &str, what: &str, fix: &str) {
    let error = bench.resolve(text).expect_err("planted fault").to_string();
    let error = error.replace(&format!("{}/", bench.dir.path().display()), "");
    assert!(error.starts_with(&format!("block.toml:{place}: ")), "{error}");
    let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
    assert!(problem.contains(what) && remedy.contains(fix) && !error.contains('\n'), "{error}");
}

#[test]
fn values_of_a_cell_array_are_groups() {
    let bench = bench();
    let resolved = bench.resolve(&scene("cube.vtk", PARTS, &["1", "2", "10"])).expect("sound");
    let tets: Vec<usize> =
        resolved.materials.iter().map(|r| r.tets.as_ref().expect("a group").len()).collect();
    assert_eq!(tets, [144, 6, 12]);
    assert_eq!(resolved.materials[1].tets, Some((0..6).collect()));
    assert_eq!(resolved.mesh.tet_groups.len(), 3, "77 is of triangles only");
    // The store keeps the groups, so that it needs no file.
    let stored = Scene::parse(&bench.path("elsewhere/block.toml"), resolved.text.clone()).expect("sound");
    let again = stored.resolve_in(resolved.mesh.clone(), resolved.fixed.clone()).expect("sound");
    assert_eq!(again, resolved);
    // Nodes of a region can be named like those of a physical group.
    let text = scene("cube.vtk", PARTS, &[]).replacen("node = 63", "group = \"2\"", 1);
    assert_eq!(bench.resolve(&text).expect("sound").active.len(), 3 + 1, "the free ones of the first cube");
}

#[test]
fn a_value_without_a_material_is_named_with_its_tets() {
    let bench = bench();
    let text = scene("cube.vtk", PARTS, &["1", "2"]);
    let fix = "add a [[material]] with group = \"10\"";
    refuses(&bench, &text, "12", "value 10 (12 tets) of \"part\" has no [[material]]", fix);
    let text = scene("cube.vtk", PARTS, &["1"]);
    refuses(
        &bench,
        &text,
        "7",
        "values 2 (6 tets), 10 (12 tets) of \"part\" have no",
        "first with group = \"2\"",
    );
    let text = scene("cube.vtk", PARTS, &["1", "2", "77"]);
    refuses(&bench, &text, "18", "no group of volumes named \"77\"", "use one of: 1, 10, 2");
    let gmsh = scene("cube.msh", "", &["corner"]);
    refuses(&bench, &gmsh, "7", "156 tets of the mesh without a material", "for the rest");
}

#[test]
fn arrays_that_number_no_regions_are_refused_in_the_scene() {
    let bench = bench();
    let faulty = |mesh: &str, array: &str, what: &str, fix: &str| {
        refuses(&bench, &scene(mesh, &format!("regions = \"{array}\""), &["1"]), "4", what, fix);
    };
    faulty("cube.vtk", "parts", "no cell array of numbers named \"parts\"", "did you mean \"part\"?");
    faulty("cube.vtk", "organ", "no cell array of numbers named \"organ\"", "use one of: part, density");
    faulty("cube.vtk", "density", "cell 2 has 1.5 in the array \"density\"", "one whole number per cell");
    faulty("cube.msh", "part", "cube.msh has none", "remove it");
    let vtk = vtk("part");
    bench.write("bare.vtk", &vtk[..vtk.find("CELL_DATA").expect("there")]);
    faulty("bare.vtk", "part", "no cell array", "the file has none");
}

#[test]
fn a_group_that_a_cell_array_numbers_is_told() {
    let bench = bench();
    let text = scene("cube.vtk", "", &["1", "2"]);
    refuses(&bench, &text, "8", "no group of volumes named \"1\"", "add `regions = \"part\"` to [mesh]");
    refuses(
        &bench,
        &scene("cube.vtk", "", &["3"]),
        "8",
        "no group of volumes named \"3\"",
        "the mesh has none",
    );
    refuses(
        &bench,
        &scene("cube.msh", "", &["1"]),
        "8",
        "no group of volumes named \"1\"",
        "use one of: all",
    );
}
