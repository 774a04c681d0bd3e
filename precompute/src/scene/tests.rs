//! Scenes on a cube of 3^3 small cubes with edges of 0.1 m: node (i, j, k) is 16 i + 4 j + k, and the low x
//! side is fixed.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::*;
use crate::fem::material::{Lame, MooneyRivlin, StVenantKirchhoff};
use crate::mesh::testing::cube;
use crate::spec::SpaceGrid;
use crate::spec::Tolerance;

mod device;
mod grid;
mod material;
mod nodes;
mod plausible;
mod refine;
mod regions;
mod tool;

/// The errors below contain line numbers, so tests replace lines and never insert one in the middle.
const SCENE: &str = "\
name = \"block\"
[mesh]
file = \"cube.msh\"
unit = \"cm\"
order = 1
[material]
law = \"mooney-rivlin\"
c10_pa = 1300.0
c01_pa = 1280.0

[fixed]
group = \"left\"
[[active]]
name = \"A1\"
node = 63
[[active]]
name = \"A2\"
nearest = [0.31, 0.1, 0.1]
[grid]
radius_m = 0.05
spacing_m = 0.01
[device]
max_force_n = 8
[needs]
visual = false
";

/// A folder with a mesh in centimetres and the scene; deleted when dropped.
struct Bench {
    dir: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { dir: tempfile::tempdir().expect("a temporary folder") };
        bench.write("cube.msh", &gmsh(&cube(3, 30.0)));
        bench.write(
            "sets.json",
            "{\n \"F1\": [0, 1, 2, 3, 5],\n \"bad\": [0, 64],\n \"none\": [],\n \"note\": \"x\"\n}",
        );
        bench
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("written");
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn resolve(&self, text: &str) -> Result<ResolvedScene, InputError> {
        Scene::parse(&self.path("block.toml"), text.to_owned())?.resolve()
    }

    /// The scene with `from` replaced by `to`; `from` must occur.
    fn with(&self, from: &str, to: &str) -> Result<ResolvedScene, InputError> {
        assert!(SCENE.contains(from), "nothing to replace: {from:?}");
        self.resolve(&SCENE.replacen(from, to, 1))
    }

    /// Asserts that the changed scene is refused at `place`, with a message that contains `what` and `fix`.
    #[track_caller]
    fn refuses(&self, from: &str, to: &str, place: &str, what: &str, fix: &str) {
        let error = self.with(from, to).expect_err("planted fault").to_string();
        let error = error.replace(&format!("{}/", self.dir.path().display()), "");
        assert!(error.starts_with(&format!("{place}: ")), "{error}");
        let (problem, remedy) = error.split_once("; ").expect("a problem and a fix");
        assert!(problem.contains(what), "{error}");
        assert!(remedy.contains(fix), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

/// Gmsh 2.2 text of a mesh. Groups: the triangles at x = 0 "left", those at x = 30 "right", all tets "all",
/// the tets of the first small cube also "corner".
fn gmsh(mesh: &TetMesh) -> String {
    let mut text = String::from("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n4\n");
    text.push_str("0 1 \"left\"\n0 2 \"right\"\n3 3 \"all\"\n3 4 \"corner\"\n$EndPhysicalNames\n$Nodes\n");
    writeln!(text, "{}", mesh.nodes_m.len()).expect("to memory");
    for (index, [x, y, z]) in mesh.nodes_m.iter().enumerate() {
        writeln!(text, "{} {x} {y} {z}", index + 1).expect("to memory");
    }
    let mut elements = Vec::new();
    for (index, x) in mesh.nodes_m.iter().enumerate() {
        let group = if x[0] == 0.0 { 1 } else { 2 };
        if x[0] == 0.0 || x[0] == 30.0 {
            elements.push(format!("15 2 {group} 0 {}", index + 1));
        }
    }
    for (index, tet) in mesh.tets.iter().enumerate() {
        let [a, b, c, d] = tet.map(|node| node + 1);
        elements.push(format!("4 2 3 0 {a} {b} {c} {d}"));
        if index < 6 {
            elements.push(format!("4 2 4 0 {a} {b} {c} {d}"));
        }
    }
    writeln!(text, "$EndNodes\n$Elements\n{}", elements.len()).expect("to memory");
    for (index, element) in elements.iter().enumerate() {
        writeln!(text, "{} {element}", index + 1).expect("to memory");
    }
    text + "$EndElements\n"
}

#[test]
fn a_scene_resolves_to_indices_and_metres() {
    let bench = Bench::new();
    let scene = bench.resolve(SCENE).expect("sound");
    assert_eq!(scene.name, "block");
    assert_eq!((scene.mesh.nodes_m.len(), scene.mesh.tets.len()), (64, 162));
    assert_eq!(scene.mesh.nodes_m[63], [0.3; 3], "centimetres became metres");
    assert_eq!(scene.order, ElementOrder::Linear);
    let material = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 });
    assert_eq!(scene.materials, [MaterialRegion { material, bulk_modulus_pa: None, tets: None }]);
    assert_eq!(scene.fixed, (0..16).collect::<Vec<u32>>());
    let active = |name: &str, node| ActiveNode::node(name.into(), node);
    assert_eq!(scene.active, [active("A1", 63), active("A2", 48 + 4 + 1)]);
    assert_eq!(
        scene.grid,
        Some(Sampling::Lattice(Lattice {
            grid: SpaceGrid::new(0.01, 0.05).expect("a lattice"),
            complete_cells: true,
            increments: None
        }))
    );
    assert_eq!(scene.max_force_n, 8.0);
    assert_eq!(scene.body_force, None);
    assert!(!scene.visual);
    assert_eq!(scene.displacement_bound, DisplacementBound { rms_m: 1e-4, max_m: 1e-3 });
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let again =
        Scene::parse(&bench.path("block.toml"), scene.text.clone()).expect("canonical text is a scene");
    assert_eq!(again.resolve().expect("sound"), scene);
}

#[test]
fn what_is_left_out_has_defaults() {
    let bench = Bench::new();
    let text = SCENE.replace("name = \"block\"", "").replace("unit = \"cm\"\norder = 1", "");
    let text = text[..text.find("[grid]").expect("there")].replace("[0.31, 0.1, 0.1]", "[30.0, 10.0, 10.0]");
    let scene = bench.resolve(&text).expect("sound");
    assert_eq!(scene.name, "block", "the file's stem");
    assert_eq!(scene.order, ElementOrder::Linear);
    assert_eq!(scene.mesh.nodes_m[63], [30.0; 3], "metres");
    assert_eq!((scene.grid, scene.max_force_n, scene.visual), (None, f64::INFINITY, true));
}

#[test]
fn a_group_lends_its_name_to_its_nodes() {
    let bench = Bench::new();
    let of =
        |table: &str| bench.with("name = \"A2\"\nnearest = [0.31, 0.1, 0.1]", table).expect("sound").active;
    let (surface, named) = (of("group = \"surface\""), of("name = \"S\"\ngroup = \"surface\""));
    assert!(surface.len() == named.len() && surface.len() > 30, "{}", surface.len());
    for (own, given) in surface.iter().zip(&named).skip(1) {
        assert_eq!([&own.name, &given.name], [&format!("surface-{}", own.node), &format!("S-{}", own.node)]);
    }
    bench.refuses("name = \"A2\"", "", "block.toml:16", "an active node has no name", "add `name = \"A1\"`");
}

#[test]
fn the_bound_of_the_displacements_is_the_scene_s() {
    let bench = Bench::new();
    let with = |keys: &str| bench.with("visual = false", &format!("visual = true\n{keys}"));
    let of = |keys: &str| {
        let DisplacementBound { rms_m, max_m } = with(keys).expect("sound").displacement_bound;
        (rms_m, max_m)
    };
    assert_eq!(of("displacement_rms_mm = 0.25"), (2.5e-4, 1e-3));
    assert_eq!(of("displacement_max_mm = 2\ndisplacement_rms_mm = 0.01"), (1e-5, 2e-3));
    let refuses = |keys: &str, place: &str, what: &str, fix: &str| {
        bench.refuses("visual = false", &format!("visual = true\n{keys}"), place, what, fix);
    };
    refuses(
        "displacement_rms_mm = 0.001",
        "block.toml:26",
        "displacement_rms_mm = 0.001 is below",
        "give 0.01 or more",
    );
    refuses("displacement_max_mm = -1.0", "block.toml:26", "displacement_max_mm", "correct the value");
    refuses("displacement_max_mm = nan", "block.toml:26", "displacement_max_mm", "correct the value");
    refuses("displacement_mm = 1.0", "block.toml:26", "unknown key `displacement_mm`", "displacement_");
}

#[test]
fn the_scene_file_itself_is_read_and_refused_by_line() {
    let bench = Bench::new();
    bench.write("block.toml", SCENE);
    let scene = Scene::load(&bench.path("block.toml")).expect("sound");
    assert_eq!(scene.mesh_path(), bench.path("cube.msh"));
    let missing = Scene::load(&bench.path("none.toml")).unwrap_err().to_string();
    assert!(missing.contains("none.toml: cannot read the file"), "{missing}");
    assert!(missing.contains("; check the path of the scene file"), "{missing}");
    std::fs::write(bench.path("latin.toml"), b"name = \"a\"\nfile = \"\xe9\"").expect("written");
    let latin = Scene::load(&bench.path("latin.toml")).unwrap_err().to_string();
    assert!(latin.contains("latin.toml:2: the scene is not UTF-8 text; save it"), "{latin}");
}

#[test]
fn wrong_keys_and_syntax_name_the_key_and_what_is_allowed() {
    let bench = Bench::new();
    let refuses = |from, to, place, what, fix| bench.refuses(from, to, place, what, fix);
    refuses(
        "radius_m = 0.05",
        "radius = 0.05",
        "block.toml:20",
        "unknown key `radius`",
        "did you mean `radius_m`?",
    );
    refuses("radius_m = 0.05", "radius = 0.05", "block.toml:20", "unknown", "radius_m, spacing_m, points");
    refuses("c01_pa", "co1_pa", "block.toml:9", "unknown key `co1_pa`", "did you mean `c01_pa`?");
    refuses(
        "unit",
        "colour",
        "block.toml:4",
        "unknown key `colour`",
        "remove it (allowed here: file, unit, order, regions, refine, refine_edge_m)",
    );
    refuses("node = 63", "nodes = [63]", "block.toml:15", "unknown key `nodes`", "did you mean `node`?");
    refuses("[needs]", "[need]", "block.toml:24", "unknown key `need`", "did you mean `needs`?");
    let wrong = |from: &str, to: &str, line: usize, what: &str| {
        bench.refuses(from, to, &format!("block.toml:{line}"), what, "correct the value");
    };
    wrong("visual = false", "visual = 0", 25, "true or false is expected here, not the number 0");
    wrong("node = 63", "node = 63.0", 15, "a whole number is expected here, not the number 63.0");
    wrong("c10_pa = 1300.0", "c10_pa = \"1300\"", 8, "a number is expected here, not the string \"1300\"");
    wrong("c10_pa = 1300.0", "c10_pa = true", 8, "a number is expected here, not true");
    wrong("c10_pa = 1300.0", "c10_pa = [1.0]", 8, "a number is expected here, not a list");
    wrong("law = \"mooney-rivlin\"", "law = 3", 7, "a text in quotes is expected here, not the number 3");
    wrong("group = \"left\"", "nodes = 3", 12, "a list is expected here, not the number 3");
    wrong("group = \"left\"", "box = 3", 12, "a table is expected here, not the number 3");
    refuses("law = \"mooney-rivlin\"", "", "block.toml:6", "`law` is missing", "add `law`");
    refuses("[fixed]\ngroup = \"left\"", "", "block.toml:1", "[fixed] is missing", "add [fixed]");
    refuses("file = \"cube.msh\"", "file = ", "block.toml:3", "not valid TOML", "correct the syntax");
    refuses(
        "c10_pa = 1300.0",
        "c01_pa = 1.0",
        "block.toml:9",
        "not valid TOML (duplicate key",
        "correct the syntax",
    );
    refuses("name = \"block\"", "name = \"\"", "block.toml:1", "the name \"\" is empty", "1 to 64 bytes");
    let long = format!("name = \"{}\"", "x".repeat(33));
    refuses("name = \"A2\"", &long, "block.toml:17", "is 33 bytes long", "1 to 32 bytes");
    refuses("name = \"A2\"", "name = \"A,2\"", "block.toml:17", "holds a comma", "without commas");
}

#[test]
fn wrong_meshes_name_the_scene_or_the_mesh_file() {
    let bench = Bench::new();
    let refuses = |from, to, place, what, fix| bench.refuses(from, to, place, what, fix);
    refuses("cube.msh", "cub.msh", "block.toml:3", "cannot open the mesh", "relative to the scene file");
    refuses("\"cm\"", "\"inch\"", "block.toml:4", "unknown unit \"inch\"", "\"m\", \"cm\" or \"mm\"");
    refuses("order = 1", "order = \"tool\"", "block.toml:5", "needs a tool with a size", "`order = 2`");
    refuses(
        "order = 1",
        "order = 3",
        "block.toml:5",
        "`order` = 3 is neither 1, 2 nor \"tool\"",
        "`order = 1`",
    );
    let mesh = std::fs::read_to_string(bench.path("cube.msh")).expect("written above");
    bench.write("cut.msh", &mesh[..mesh.len() / 2]);
    let line = mesh[..mesh.len() / 2].lines().count();
    let place = format!("cut.msh:{line}");
    refuses("cube.msh", "cut.msh", &place, "", "export");
    bench.write("cube.off", "OFF");
    refuses("cube.msh", "cube.off", "cube.off", "format is not known", "save it as Gmsh");
}

#[test]
fn order_regions_body_force_patch_and_solver_are_read() {
    let bench = Bench::new();
    assert_eq!(bench.with("order = 1", "order = 2").expect("sound").order, ElementOrder::Quadratic);
    let table = |text: &str| bench.with("[device]", &format!("{text}\n[device]"));
    let force = |text: &str| table(&format!("[body_force]\n{text}")).map(|scene| scene.body_force);
    assert_eq!(force("force_n_per_m3 = [0, 0, -1e4]").expect("sound"), Some([0.0, 0.0, -1e4]));
    let weight = "density_kg_m3 = 1000.0\ngravity_m_s2 = [0, 0, -9.81]";
    assert_eq!(force(weight).expect("sound"), Some([0.0, 0.0, -9810.0]));
    let error = force("density_kg_m3 = 1000.0").unwrap_err();
    assert!(error.what.contains("does not define one force"), "{error}");
    let solver =
        table("[solver]\npressure = \"stabilised\"\nconstraints = \"multipliers\"\nreject_inverted = true");
    let expected = SolverOptions {
        pressure: PressurePair::Stabilised,
        constraints: Constraints::Multipliers,
        reject_inverted: true,
    };
    assert_eq!(solver.expect("sound").solver, expected);
    for (key, fix) in [
        ("pressure", "use \"plain\" or \"stabilised\""),
        ("constraints", "use \"elimination\" or \"multipliers\""),
    ] {
        let error = table(&format!("[solver]\n{key} = \"x\"")).unwrap_err();
        assert_eq!((&error.what[..], &error.fix[..], error.line), ("unknown word \"x\"", fix, Some(23)));
        let error = table(&format!("[solver]\n{key} = 3")).unwrap_err();
        let found = (&error.what[..], &error.fix[..], error.line);
        assert_eq!(found, ("a text in quotes is expected here", "correct the value", Some(23)), "{error}");
    }
    let text = SCENE.replace("order = 1", "order = 2");
    let text =
        text.replace("[device]", "[solver]\nreject_inverted = true\npressure = \"stabilised\"\n[device]");
    let error = Scene::parse(&bench.path("block.toml"), text).expect("well-formed").resolve().unwrap_err();
    assert_eq!((&error.fix[..], error.line), ("leave `pressure` out", Some(24)), "{error}");
}

/// A space contains the scene's text; the profile can later change or be deleted.
#[test]
fn the_kept_text_of_a_scene_needs_no_profile() {
    let bench = Bench::new();
    bench.write("bench.toml", "[limits]\nmax_force_n = 2.5\n");
    let scene = bench.with("max_force_n = 8", "profile = \"bench.toml\"").expect("sound");
    std::fs::remove_file(bench.path("bench.toml")).expect("it was there");
    assert!(!scene.text.contains("profile") && scene.text.contains("max_force_n = 2.5"), "{}", scene.text);
    let kept = Scene::parse(&bench.path("a.space"), scene.text.clone()).expect("sound");
    let again = kept.resolve_in(scene.mesh.clone(), scene.fixed.clone()).expect("sound");
    assert_eq!((again.max_force_n, again.content_hash()), (2.5, scene.content_hash()));
    assert_eq!(again.text, scene.text);
}

/// As read from the file, in metres; the file is not opened.
#[test]
fn a_mesh_in_memory_replaces_the_file() {
    let bench = Bench::new();
    let read = bench.resolve(SCENE).expect("sound");
    std::fs::remove_file(bench.path("cube.msh")).expect("it was there");
    let scene = Scene::parse(&bench.path("block.toml"), SCENE.into()).expect("sound");
    let given = scene.resolve_on(read.mesh.clone()).expect("sound");
    assert_eq!(given, read);
    let bare = TetMesh { node_groups: Default::default(), ..read.mesh };
    let error = scene.resolve_on(bare).expect_err("no group").to_string();
    assert!(error.contains("block.toml:12: the mesh has no group of nodes named \"left\""), "{error}");
}

#[test]
fn every_tet_has_exactly_one_region() {
    let bench = Bench::new();
    let resolve = |rest: &str| {
        let text = SCENE.replacen("[material]", "[[material]]\ngroup = \"corner\"", 1);
        let scene =
            Scene::parse(&bench.path("block.toml"), text.replacen("[fixed]", rest, 1)).expect("well-formed");
        scene.resolve()
    };
    let error = resolve("[fixed]").unwrap_err().to_string();
    assert!(error.contains("block.toml:6: 156 tets of the mesh without a material; add a"), "{error}");
    let second = "[[material]]\ngroup = \"all\"\nlaw = \"linear\"\nlambda_pa = 1.0\nmu_pa = 1.0\n[fixed]";
    let error = resolve(second).unwrap_err().to_string();
    assert!(error.contains("block.toml:12: tet 0 (0-based) already has a material"), "{error}");
    let error = resolve(&second.replacen("group = \"all\"", "", 1)).unwrap_err().to_string();
    assert!(error.contains("has no `group`; name the group of each region"), "{error}");
    let error = resolve(&second.replacen("\"all\"", "\"left\"", 1)).unwrap_err().to_string();
    assert!(error.contains("no group of volumes named \"left\"; use one of: all, corner"), "{error}");
    let text = SCENE.replacen("c01_pa = 1280.0", "c01_pa = 1280.0\ngroup = \"all\"", 1);
    let whole = Scene::parse(&bench.path("block.toml"), text).expect("well-formed");
    let regions = whole.resolve().expect("sound").materials;
    assert_eq!(regions[0].tets, Some((0..162).collect()));
    let force = SCENE.replacen("[device]", "[body_force]\nforce_n_per_m3 = [0, 0, -1e4]\n[device]", 1);
    let heavy = Scene::parse(&bench.path("block.toml"), force).expect("well-formed");
    assert_eq!(heavy.resolve().expect("sound").body_force, Some([0.0, 0.0, -1e4]));
}

#[test]
fn the_hash_sees_what_changes_numbers_and_nothing_else() {
    let bench = Bench::new();
    let scene = bench.resolve(SCENE).expect("sound");
    let same = [
        ("name = \"block\"", "name = \"other\""),
        ("visual = false", "visual = true"),
        ("visual = false", "displacement_rms_mm = 0.5\ndisplacement_max_mm = 5"),
        ("c10_pa = 1300.0", "c10_pa = 1.3e3 # a remark"),
        ("group = \"left\"", "nodes = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]"),
        ("spacing_m = 0.01", "points = 514"),
    ];
    for (from, to) in same {
        let other = bench.with(from, to).expect("sound");
        assert_eq!(other.content_hash(), scene.content_hash(), "{to}");
    }
    let changes = [
        ("c10_pa = 1300.0", "c10_pa = 1301.0", true),
        ("group = \"left\"", "nodes = [0, 1, 2, 4, 5]", true),
        ("unit = \"cm\"", "unit = \"mm\"", true),
        ("node = 63", "node = 62", false),
        ("name = \"A1\"", "name = \"B1\"", false),
        ("spacing_m = 0.01", "spacing_m = 0.02", false),
        ("radius_m = 0.05", "radius_m = 0.04", false),
        ("max_force_n = 8", "max_force_n = 9", false),
        ("[device]\nmax_force_n = 8", "", false),
        ("[grid]\nradius_m = 0.05\nspacing_m = 0.01", "", false),
    ];
    for (from, to, of_the_model) in changes {
        // In millimetres the body is ten times smaller, so the nearest point is too.
        let to_nearest = if to.contains("mm") { "[0.031, 0.01, 0.01]" } else { "[0.31, 0.1, 0.1]" };
        let text = SCENE.replacen(from, to, 1).replacen("[0.31, 0.1, 0.1]", to_nearest, 1);
        let other = bench.resolve(&text).expect("sound");
        assert_ne!(other.content_hash(), scene.content_hash(), "{to}");
        assert_eq!(other.model_hash() != scene.model_hash(), of_the_model, "{to}");
    }
}
