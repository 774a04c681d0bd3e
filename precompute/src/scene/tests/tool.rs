//! The tool of a scene: a point, or a fingertip and its contact points.

use super::*;
use crate::fem::{Layer, PadProfile, Sphere};
use crate::num::vector::distance;

/// The scene with a `[tool]` table, and its first active node replaced.
fn scene(tool: &str, active: &str) -> String {
    SCENE.replacen("node = 63", active, 1) + "[tool]\nshape = \"fingertip\"\n" + tool
}

#[test]
fn a_fingertip_has_the_size_of_a_human_one() {
    let bench = Bench::new();
    assert_eq!(bench.resolve(SCENE).expect("sound").tool, Tool::Point);
    // The cells have edges of 100 mm, so the pad of the tests is larger.
    let found = bench.resolve(&scene("radius_m = 0.12", "node = 63")).expect("sound");
    let tip = *found.tool.fingertip().expect("a fingertip");
    assert_eq!((tip.radius_m, tip.stiffness_pa_m, tip.profile), (0.12, 5e6, PadProfile::Quartic));
    let hard = "radius_m = 0.12\nstiffness_pa_m = 1e7\nprofile = \"hertz\"";
    let found = bench.resolve(&scene(hard, "node = 63")).expect("sound");
    let hard = *found.tool.fingertip().expect("a fingertip");
    assert_eq!((hard.stiffness_pa_m, hard.profile), (1e7, PadProfile::Hertz));
    assert!(hard.stiffness_on_a_plane_n_m() / tip.stiffness_on_a_plane_n_m() == 4.0);
}

#[test]
fn a_point_is_projected_onto_the_skin_and_a_node_works_too() {
    let bench = Bench::new();
    let places = |active: &str| {
        let scene = bench.resolve(&scene("radius_m = 0.12", active)).expect("sound");
        (scene.active[0].place_m(&scene.mesh), scene.active[0].contact.is_some())
    };
    // 20 mm beside the face y = 0.3.
    let (place_m, has_contact) = places("point = [0.17, 0.32, 0.12]");
    assert!(has_contact);
    assert!(place_m.iter().zip([0.17, 0.3, 0.12]).all(|(a, b)| (a - b).abs() < 1e-12), "{place_m:?}");
    assert_eq!(places("node = 63"), ([0.3, 0.3, 0.3], true));
    // Another place is another model; the same place of a point tool is, too.
    let hash = |text: &str| bench.resolve(text).expect("sound").content_hash();
    let at = |tool: &str, active: &str| hash(&scene(tool, active));
    let first = at("radius_m = 0.12", "point = [0.17, 0.3, 0.12]");
    assert_ne!(first, at("radius_m = 0.12", "point = [0.18, 0.3, 0.12]"));
    assert_ne!(first, at("radius_m = 0.13", "point = [0.17, 0.3, 0.12]"));
    assert_ne!(at("radius_m = 0.12", "node = 63"), hash(SCENE));
}

#[test]
fn elements_may_be_quadratic_near_the_tool_only() {
    let bench = Bench::new();
    let text = |order: &str, more: &str| {
        let text = scene("radius_m = 0.08", "point = [0.17, 0.3, 0.12]");
        text.replace("order = 1", &format!("order = {order}")).replace("[device]", &format!("{more}[device]"))
    };
    let [quadratic, near] = ["2", "\"tool\""].map(|order| bench.resolve(&text(order, "")).expect("sound"));
    assert_eq!((near.order, quadratic.order), (ElementOrder::NearTool, ElementOrder::Quadratic));
    assert_ne!(near.model_hash(), quadratic.model_hash());
    // The corner of the cube that is farthest from the tool is linear.
    let unknowns = [&near, &quadratic].map(|scene| {
        let body = Arc::new(scene.body().expect("sound"));
        scene.problem(&body, &scene.active[0]).unknowns()
    });
    assert!(unknowns[0] < unknowns[1] && 3 * unknowns[0] > unknowns[1], "{unknowns:?}");
    let load = "[body_force]\nforce_n_per_m3 = [0, 0, -1e4]\n";
    let error = bench.resolve(&text("\"tool\"", load)).expect_err("refused").to_string();
    assert!(
        error.contains("cannot be combined with [body_force]") && error.contains("`order = 2`"),
        "{error}"
    );
}

#[test]
fn a_small_pad_is_a_warning() {
    let bench = Bench::new();
    let warned = |tool: &str| {
        let scene = bench.resolve(&scene(tool, "point = [0.17, 0.3, 0.12]")).expect("sound");
        scene.warnings.iter().any(|warning| warning.contains("the tool is smaller than its elements"))
    };
    assert!(warned("radius_m = 0.1") && !warned("radius_m = 0.14"));
}

#[test]
fn a_tool_that_does_not_fit_is_refused() {
    let bench = Bench::new();
    let refuses = |tool: &str, active: &str, what: &str, fix: &str| {
        let error = bench.resolve(&scene(tool, active)).expect_err("refused").to_string();
        assert!(error.contains(what) && error.contains(fix) && !error.contains('\n'), "{error}");
    };
    let (good, face) = ("radius_m = 0.12", "point = [0.17, 0.3, 0.12]");
    refuses("radius_m = 0.04", face, "is smaller than the elements under it", "refine the mesh there");
    refuses("radius_m = 0.3", face, "is larger than the body", "`radius_m` in metres");
    refuses("radius_m = 0.12\nstiffness_pa_m = 0.0", face, "is not a positive number", "correct the value");
    refuses("radius_m = 0.12\nprofile = \"flat\"", face, "unknown word \"flat\"", "\"quartic\"");
    refuses(good, "point = [0.0, 0.15, 0.15]", "is in the fixed set", "choose a point on the free skin");
    refuses(good, "point = [9.0, 0.15, 0.15]", "from the body", "in metres");
    refuses(
        good,
        "point = [0.15, 0.15, 0.5]",
        "lies 0.200 m from the body's skin",
        "give a place on the skin",
    );
    let hertz = "radius_m = 0.12\nprofile = \"hertz\"";
    refuses(hertz, "group = \"right\"", "cannot slide over a group", "`profile = \"quartic\"`");
    refuses(good, "node = 63\npatch_radius_m = 0.1", "no rigid patch", "remove the patch");
    // A body in the wrong unit does not fit its tool either.
    let text = scene("radius_m = 0.12", face).replacen("unit = \"cm\"", "unit = \"m\"", 1);
    let error = bench.resolve(&text).expect_err("refused").to_string();
    assert!(error.contains("is the mesh in cm? correct `unit`"), "{error}");
    let error = bench.with("node = 63", face).expect_err("refused").to_string();
    assert!(error.contains("is for a tool with a size") && error.contains("[tool]"), "{error}");
    let error =
        bench.resolve(&scene(good, face).replace("fingertip", "probe")).expect_err("refused").to_string();
    assert!(error.contains("unknown shape \"probe\"") && error.contains("\"fingertip\""), "{error}");
}

/// The scene with a sphere, without active nodes and a grid.
fn sphere(tool: &str) -> String {
    let start = SCENE.find("[[active]]").expect("a table");
    let end = SCENE.find("[device]").expect("a table");
    format!("{}{}[tool]\nshape = \"sphere\"\n{tool}", &SCENE[..start], &SCENE[end..])
}

#[test]
fn a_sphere_has_a_radius_and_a_layer() {
    let bench = Bench::new();
    let found = |tool: &str| *bench.resolve(&sphere(tool)).expect("sound").tool.sphere().expect("a sphere");
    assert_eq!(found("radius_m = 0.01"), Sphere { radius_m: 0.01, layer: Layer::of(0.01) });
    let layer = found("radius_m = 0.01\nlayer_m = 0.002\nlayer_pa = 3e5").layer;
    assert_eq!((layer.thickness_m, layer.pressure_pa), (0.002, 3e5));
    let hash = |tool: &str| bench.resolve(&sphere(tool)).expect("sound").content_hash();
    let first = hash("radius_m = 0.01");
    assert!(first != hash("radius_m = 0.011") && first != hash("radius_m = 0.01\nlayer_m = 0.0015"));
    let refuses = |text: String, what: &str, fix: &str| {
        let error = bench.resolve(&text).expect_err("refused").to_string();
        assert!(error.contains(what) && error.contains(fix) && !error.contains('\n'), "{error}");
    };
    refuses(sphere(""), "a sphere needs a `radius_m`", "add radius_m");
    refuses(sphere("radius_m = 0.0009"), "does not fit a body", "give a radius from 0.001");
    refuses(sphere("radius_m = 0.27"), "does not fit a body", "correct the unit");
    refuses(sphere("radius_m = 0.01\nprofile = \"hertz\""), "keys of a fingertip", "remove them");
    refuses(sphere("radius_m = 0.01\nlayer_m = 0.006"), "thicker than half the radius", "a thinner");
    refuses(sphere("radius_m = 0.01\nlayer_pa = 0.0"), "is not a positive number", "correct the value");
    refuses(scene("layer_m = 0.001", "node = 63"), "a fingertip has no layer", "shape = \"sphere\"");
    let tool = "[tool]\nshape = \"sphere\"\nradius_m = 0.01\n";
    refuses(format!("{SCENE}{tool}"), "has no active node", "remove [[active]]");
    let gridded =
        sphere("radius_m = 0.05").replace("[device]", "[grid]\nradius_m = 0.05\nspacing_m = 0.01\n[device]");
    refuses(gridded.clone(), "the field of a sphere has no lattice", "cannot_be_felt");
    let table = "[grid]\nradius_m = 0.05\ncannot_be_felt = true\n[device]";
    let fine = sphere("radius_m = 0.01").replace("[device]", table);
    refuses(fine, "charts, and a blob holds 512", "give a larger `radius_m`");
    // With a tolerance it has charts all over the free skin.
    let found = bench.resolve(&gridded.replace("spacing_m = 0.01", "cannot_be_felt = true")).expect("sound");
    let charts = found.charts.expect("charts");
    assert!(charts.charts.len() == found.active.len() && charts.charts.len() > 20);
    assert!(found.active.iter().zip(&charts.charts).all(|(active, chart)| active.chart == Some(*chart)));
}

#[test]
fn a_capsule_has_a_length_and_an_axis() {
    let bench = Bench::new();
    let capsule = |keys: &str| sphere(keys).replace("shape = \"sphere\"", "shape = \"capsule\"");
    let found = |keys: &str| bench.resolve(&capsule(keys)).expect("sound").tool;
    let tool = found("radius_m = 0.01\nlength_m = 0.02");
    assert_eq!(
        (tool.half_axis_m(), tool.sphere().map(|of| of.radius_m)),
        (Some([0.0, 0.0, 0.01]), Some(0.01))
    );
    let turned = found("radius_m = 0.01\nlength_m = 0.02\naxis = [3.0, -4.0, 0.0]").half_axis_m();
    assert!(distance(turned.expect("a capsule"), [0.006, -0.008, 0.0]) < 1e-15);
    let hash = |keys: &str| bench.resolve(&capsule(keys)).expect("sound").content_hash();
    let first = hash("radius_m = 0.01\nlength_m = 0.02");
    let sphere_hash = bench.resolve(&sphere("radius_m = 0.01")).expect("sound").content_hash();
    assert!(first != hash("radius_m = 0.01\nlength_m = 0.03") && first != sphere_hash);
    let refuses = |text: String, what: &str, fix: &str| {
        let error = bench.resolve(&text).expect_err("refused").to_string();
        assert!(error.contains(what) && error.contains(fix) && !error.contains('\n'), "{error}");
    };
    refuses(capsule("length_m = 0.02"), "a capsule needs a `radius_m`", "add radius_m");
    refuses(capsule("radius_m = 0.01"), "a capsule needs a `length_m`", "add length_m");
    refuses(capsule("radius_m = 0.01\nlength_m = 0.0"), "is not a positive number", "correct the value");
    refuses(capsule("radius_m = 0.01\nlength_m = 2.0"), "does not fit a body", "shorter `length_m`");
    refuses(capsule("radius_m = 0.01\nlength_m = 0.02\naxis = [0.0, 0.0, 0.0]"), "no direction", "give one");
    refuses(sphere("radius_m = 0.01\nlength_m = 0.02"), "keys of a capsule", "remove them");
    let table = "[grid]\nradius_m = 0.05\ncannot_be_felt = true\n[device]";
    let gridded = capsule("radius_m = 0.05\nlength_m = 0.02").replace("[device]", table);
    refuses(gridded, "a capsule has no precomputed field", "palpate live");
}

#[test]
fn a_group_is_covered_by_contact_points() {
    let bench = Bench::new();
    let found = bench.resolve(&scene("radius_m = 0.12", "group = \"right\"")).expect("sound");
    let cover = found.cover.expect("a group");
    // The second active node stays a contact point of its own.
    assert_eq!((cover.name.as_str(), cover.nodes.len(), found.active.len()), ("A1", 16, 1));
    assert!(found.active[0].contact.is_some());
}

/// Two cubes 60 mm apart, and a cube with a hole in the middle.
#[test]
fn a_second_body_and_a_cavity_are_refused() {
    let bench = Bench::new();
    let single = cube(3, 30.0);
    let (mut nodes_m, mut tets) = (single.nodes_m.clone(), single.tets.clone());
    nodes_m.extend(single.nodes_m.iter().map(|[x, y, z]| [*x, y + 36.0, *z]));
    tets.extend(single.tets.iter().map(|tet| tet.map(|node| node + 64)));
    bench.write("cube.msh", &gmsh(&TetMesh::new(nodes_m, tets).expect("sound")));
    let text = scene("radius_m = 0.12", "point = [0.17, 0.3, 0.12]").replacen(
        "group = \"left\"",
        "box = { min = [-1, -1, -1], max = [0.01, 9, 9] }",
        1,
    );
    let error = bench.resolve(&text).expect_err("refused").to_string();
    assert!(error.contains("lies over two bodies") && error.contains("smaller `radius_m`"), "{error}");

    let whole = cube(5, 50.0);
    let middle = |tet: &&[u32; 4]| {
        let at: [f64; 3] = std::array::from_fn(|axis| {
            tet.iter().map(|&n| whole.nodes_m[n as usize][axis]).sum::<f64>() / 4.0
        });
        !at.iter().all(|x| (20.0..30.0).contains(x))
    };
    let tets: Vec<[u32; 4]> = whole.tets.iter().filter(middle).copied().collect();
    bench.write("cube.msh", &gmsh(&TetMesh::new(whole.nodes_m.clone(), tets).expect("sound")));
    let text = text.replacen("point = [0.17, 0.3, 0.12]", "point = [0.25, 0.25, 0.205]", 1);
    let error = bench.resolve(&text).expect_err("refused").to_string();
    assert!(error.contains("on the wall of a cavity") && error.contains("on the outside"), "{error}");
}
