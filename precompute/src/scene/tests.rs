//! Scenes written here on a cube of 3^3 little cubes of 0.1 m: node (i, j, k) is 16 i + 4 j + k, the low x side is fixed.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::*;
use crate::material::{Lame, MooneyRivlin, StVenantKirchhoff};
use crate::mesh::testing::cube;
use crate::scattered::Tolerance;

mod device;

/// Each line has a place in the errors below, so lines are replaced and never added in the middle.
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

/// A folder with a mesh in centimetres and the scene; gone when dropped.
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

    /// The scene with one piece replaced, which must be there.
    fn with(&self, from: &str, to: &str) -> Result<ResolvedScene, InputError> {
        assert!(SCENE.contains(from), "nothing to replace: {from:?}");
        self.resolve(&SCENE.replacen(from, to, 1))
    }

    /// The replaced scene is refused at `place`, with words of what is wrong and of the mend.
    #[track_caller]
    fn refuses(&self, from: &str, to: &str, place: &str, what: &str, mend: &str) {
        let error = self.with(from, to).expect_err("planted fault").to_string();
        let error = error.replace(&format!("{}/", self.dir.path().display()), "");
        assert!(error.starts_with(&format!("{place}: ")), "{error}");
        let (said, mended) = error.split_once("; ").expect("a what and a mend");
        assert!(said.contains(what), "{error}");
        assert!(mended.contains(mend), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

/// Gmsh 2.2 text of a mesh, with the triangles' nodes of x = 0 as the group "left", of x = 30 as "right" and all tets
/// as "all", those of the first little cube as "corner" besides.
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
    assert_eq!(scene.order, 1);
    let material = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 });
    assert_eq!(scene.materials, [MaterialRegion { material, bulk_modulus_pa: None, tets: None }]);
    assert_eq!(scene.fixed, (0..16).collect::<Vec<u32>>());
    let active = |name: &str, node| ActiveNode { name: name.into(), node, patch: vec![] };
    assert_eq!(scene.active, [active("A1", 63), active("A2", 48 + 4 + 1)]);
    assert_eq!(
        scene.grid,
        Some(GridSpec::Lattice { radius_m: 0.05, spacing_m: 0.01, complete_cells: true, increments: None })
    );
    assert_eq!(scene.max_force_n, 8.0);
    assert_eq!(scene.body_force, None);
    assert!(!scene.visual);
    assert_eq!(scene.displacement_bound, DisplacementBound { rms_m: 1e-4, max_m: 1e-3 });
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let again =
        Scene::parse(&bench.path("block.toml"), scene.text.clone()).expect("canonical text is a scene");
    assert_eq!(again.resolve().expect("sound"), scene);
    let bytes = postcard::to_stdvec(&scene).expect("serialises");
    assert_eq!(postcard::from_bytes::<ResolvedScene>(&bytes).expect("reads back"), scene);
}

#[test]
fn what_is_left_out_has_defaults() {
    let bench = Bench::new();
    let text = SCENE.replace("name = \"block\"", "").replace("unit = \"cm\"\norder = 1", "");
    let text = text[..text.find("[grid]").expect("there")].replace("[0.31, 0.1, 0.1]", "[30.0, 10.0, 10.0]");
    let scene = bench.resolve(&text).expect("sound");
    assert_eq!(scene.name, "block", "the file's stem");
    assert_eq!(scene.order, 1);
    assert_eq!(scene.mesh.nodes_m[63], [30.0; 3], "metres");
    assert_eq!((scene.grid, scene.max_force_n, scene.visual), (None, f64::INFINITY, true));
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
    let refuses = |keys: &str, place: &str, what: &str, mend: &str| {
        bench.refuses("visual = false", &format!("visual = true\n{keys}"), place, what, mend);
    };
    refuses(
        "displacement_rms_mm = 0.001",
        "block.toml:26",
        "displacement_rms_mm = 0.001 is finer",
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
    let refuses = |from, to, place, what, mend| bench.refuses(from, to, place, what, mend);
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
        "remove it (allowed here: file, unit, order)",
    );
    refuses("node = 63", "nodes = [63]", "block.toml:15", "unknown key `nodes`", "did you mean `node`?");
    refuses("[needs]", "[need]", "block.toml:24", "unknown key `need`", "did you mean `needs`?");
    refuses("visual = false", "visual = 0", "block.toml:25", "invalid type", "expected type");
    refuses("node = 63", "node = 63.0", "block.toml:15", "invalid type", "expected type");
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
    let refuses = |from, to, place, what, mend| bench.refuses(from, to, place, what, mend);
    refuses("cube.msh", "cub.msh", "block.toml:3", "cannot open the mesh", "relative to the scene file");
    refuses("\"cm\"", "\"inch\"", "block.toml:4", "unknown unit \"inch\"", "\"m\", \"cm\" or \"mm\"");
    refuses("order = 1", "order = 3", "block.toml:5", "`order` = 3 is neither 1 nor 2", "`order = 1`");
    let mesh = std::fs::read_to_string(bench.path("cube.msh")).expect("written above");
    bench.write("cut.msh", &mesh[..mesh.len() / 2]);
    let line = mesh[..mesh.len() / 2].lines().count();
    let place = format!("cut.msh:{line}");
    refuses("cube.msh", "cut.msh", &place, "", "export");
    bench.write("cube.off", "OFF");
    refuses("cube.msh", "cube.off", "cube.off", "format is not known", "save it as Gmsh");
}

#[test]
fn sampling_driven_by_the_error_is_read() {
    let bench = Bench::new();
    let sampled = |keys: &str| match bench.with("spacing_m = 0.01", keys).expect("sound").grid {
        Some(GridSpec::Scattered(Scattered { radius_m, tolerance, only_push, .. })) => {
            assert_eq!((radius_m, only_push), (0.05, false));
            tolerance
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(sampled("cannot_be_felt = true"), Tolerance::CANNOT_BE_FELT);
    assert_eq!(sampled("tolerance_n = 0.1"), Tolerance { relative: 0.0, absolute_n: 0.1 });
    let both = sampled("tolerance_relative = 0.05\ntolerance_n = 0.1");
    assert_eq!(both, Tolerance { relative: 0.05, absolute_n: 0.1 });
    let push = SCENE.replacen("spacing_m = 0.01", "cannot_be_felt = true", 1);
    let push = bench.resolve(&push.replacen("[needs]", "[needs]\ncontact = \"push\"", 1)).expect("sound");
    assert!(
        matches!(push.grid, Some(GridSpec::Scattered(Scattered { only_push: true, .. }))),
        "{:?}",
        push.grid
    );

    let refuses = |keys: &str, line: usize, what: &str, mend: &str| {
        bench.refuses("spacing_m = 0.01", keys, &format!("block.toml:{line}"), what, mend);
    };
    refuses("spacing_m = 0.01\ntolerance_n = 0.1", 21, "both `spacing_m` and `tolerance_n`", "for a lattice");
    refuses("cannot_be_felt = true\ntolerance_n = 0.1", 21, "a tolerance of its own", "keep it, or");
    refuses("cannot_be_felt = false", 21, "says nothing", "say true");
    refuses("tolerance_n = 0.0", 21, "`tolerance_n` = 0", "");
    bench.refuses("[needs]", "[needs]\ncontact = \"stroke\"", "block.toml:25", "unknown contact", "\"push\"");
}

#[test]
fn a_workspace_leaves_nodes_out_and_is_refused_where_it_means_nothing() {
    let bench = Bench::new();
    let felt = SCENE.replacen("spacing_m = 0.01", "cannot_be_felt = true", 1);
    let of = |min: &str, max: &str| format!("workspace_min_m = {min}\nworkspace_max_m = {max}\n[device]");
    let group = felt.replacen("name = \"A1\"\nnode = 63", "name = \"A1\"\ngroup = \"right\"", 1);
    let whole = bench.resolve(&group).expect("sound");
    assert!(!whole.unreachable.any());
    // The right side is x = 0.3 with 16 nodes; below z = 0.15 there are eight. A2 is one of them: named, so it may be twice.
    let half = group.replacen("[device]", &of("[0.0, -0.1, -0.1]", "[0.35, 0.4, 0.15]"), 1);
    let half = bench.resolve(&half).expect("sound");
    assert_eq!(half.unreachable, Unreachable { outside: 8, hidden: 0 });
    assert_eq!(half.active.len() + 8, whole.active.len());
    assert!(half.active.iter().all(|active| half.mesh.nodes_m[active.node as usize][2] < 0.15));
    assert_ne!(half.content_hash(), whole.content_hash());
    assert!(
        matches!(half.grid, Some(GridSpec::Scattered(s)) if s.workspace_m == Some([[0.0, -0.1, -0.1], [0.35, 0.4, 0.15]]))
    );

    let refuses = |text: String, what: &str, mend: &str| {
        let error = bench.resolve(&text).expect_err("planted fault").to_string();
        assert!(error.contains(what) && error.contains(mend), "{error}");
    };
    let with = |min, max| felt.replacen("[device]", &of(min, max), 1);
    refuses(with("[0.0, 0.0, 0.0]", "[0.1, 0.1, 0.1]"), "is outside the workspace", "enlarge it");
    refuses(with("[0.0, 0.0, 0.2]", "[0.1, 0.1, 0.1]"), "workspace is empty", "swap the corners");
    refuses(with("[0.0, 0.0, nan]", "[0.1, 0.1, 0.1]"), "not finite", "");
    refuses(
        felt.replacen("[device]", "workspace_min_m = [0.0, 0.0, 0.0]\n[device]", 1),
        "belong together",
        "",
    );
    let everywhere = of("[-1.0, -1.0, -1.0]", "[1.0, 1.0, 1.0]");
    refuses(SCENE.replacen("[device]", &everywhere, 1), "a lattice is solved whole", "cannot_be_felt");
    let heavy =
        felt.replacen("[device]", &everywhere, 1) + "[body_force]\nforce_n_per_m3 = [0.0, 0.0, -9.81]\n";
    refuses(heavy, "rests elsewhere", "leave one");
    let nowhere = group.replacen("[device]", &of("[0.0, 0.0, 1.0]", "[1.0, 1.0, 2.0]"), 1);
    refuses(nowhere, "no tool gets to any node", "enlarge the workspace");
}

#[test]
fn every_law_is_read_with_its_parameters() {
    let bench = Bench::new();
    let from = "law = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
    let material = |to: &str| bench.with(from, to).expect("sound").materials[0].clone();
    for law in ["linear", "st-venant-kirchhoff", "modified-st-venant-kirchhoff", "neo-hookean"] {
        let region = material(&format!("law = \"{law}\"\nlambda_pa = 2e4\nmu_pa = 1e4"));
        assert_eq!((region.material.name(), region.material.parameters()), (law, vec![2e4, 1e4]));
    }
    for law in ["mooney-rivlin", "mooney-rivlin-reduced"] {
        let region = material(&format!("law = \"{law}\"\nc10_pa = 1e3\nc01_pa = 2e3\nbulk_pa = 5e6"));
        assert_eq!((region.material.name(), region.material.parameters()), (law, vec![1e3, 2e3]));
        assert_eq!(region.bulk_modulus_pa, Some(5e6));
    }
    let law = "holzapfel-gasser-ogden";
    let fibres = "c10_pa = 1e3\nk1_pa = 2e3\nk2 = 1.5\nfibre = [0.0, 3.0, 4.0]";
    let region = material(&format!("law = \"{law}\"\n{fibres}\ndispersion = 0.1"));
    assert_eq!(region.material.parameters(), [1e3, 2e3, 1.5, 0.1, 0.0, 0.6, 0.8]);

    let refuses = |to: &str, line: usize, what, mend| {
        bench.refuses(from, to, &format!("block.toml:{line}"), what, mend);
    };
    refuses(&format!("law = \"{law}\"\nc10_pa = 1\nk1_pa = 1\nk2 = 1"), 7, "lacks `fibre`", "direction");
    let zero = fibres.replace("[0.0, 3.0, 4.0]", "[0.0, 0.0, 0.0]");
    refuses(&format!("law = \"{law}\"\n{zero}"), 11, "is no direction", "not zero");
    let wide = format!("law = \"{law}\"\n{fibres}\ndispersion = 0.5");
    refuses(&wide, 12, "must be from 0 to 1/3", "isotropic");
    let bulk = "law = \"neo-hookean\"\nlambda_pa = 2e4\nmu_pa = 1e4\nbulk_pa = 1e6";
    refuses(bulk, 10, "which has no pressure", "remove it");
}

#[test]
fn order_regions_body_force_patch_and_solver_are_read() {
    let bench = Bench::new();
    assert_eq!(bench.with("order = 1", "order = 2").expect("sound").order, 2);
    let table = |text: &str| bench.with("[device]", &format!("{text}\n[device]"));
    let force = |text: &str| table(&format!("[body_force]\n{text}")).map(|scene| scene.body_force);
    assert_eq!(force("force_n_per_m3 = [0, 0, -1e4]").expect("sound"), Some([0.0, 0.0, -1e4]));
    let weight = "density_kg_m3 = 1000.0\ngravity_m_s2 = [0, 0, -9.81]";
    assert_eq!(force(weight).expect("sound"), Some([0.0, 0.0, -9810.0]));
    let error = force("density_kg_m3 = 1000.0").unwrap_err();
    assert!(error.what.contains("does not say one force"), "{error}");
    let solver =
        table("[solver]\npressure = \"stabilised\"\nconstraints = \"multipliers\"\nreject_inverted = true");
    let solver = solver.expect("sound");
    assert_eq!(solver.pressure_pair, PressurePair::Stabilised);
    assert_eq!(solver.constraints, Constraints::Multipliers);
    assert!(solver.reject_inverted);
    for (key, what) in [("pressure", "unknown pressure field"), ("constraints", "unknown kind")] {
        let error = table(&format!("[solver]\n{key} = \"x\"")).unwrap_err();
        assert!(error.what.contains(what), "{error}");
    }
}

#[test]
fn material_parameters_must_make_sense() {
    let bench = Bench::new();
    let refuses = |from, to, place, what, mend| bench.refuses(from, to, place, what, mend);
    refuses(
        "\"mooney-rivlin\"",
        "\"mooney rivlin\"",
        "block.toml:7",
        "unknown law",
        "did you mean \"mooney-rivlin\"",
    );
    refuses(
        "\"mooney-rivlin\"",
        "\"ogden\"",
        "block.toml:7",
        "unknown law \"ogden\"",
        "choose one of linear",
    );
    refuses("c01_pa = 1280.0", "", "block.toml:7", "lacks `c01_pa`", "`c10_pa` and `c01_pa`");
    refuses("c01_pa = 1280.0", "c01_pa = nan", "block.toml:9", "`c01_pa` = NaN must be a finite", "correct");
    refuses(
        "c01_pa = 1280.0",
        "c01_pa = -1300",
        "block.toml:8",
        "must have a positive sum",
        "positive constants",
    );
    let both = "c01_pa = 1280.0\nyoung_pa = 1.0";
    refuses(
        "c01_pa = 1280.0",
        both,
        "block.toml:10",
        "`young_pa` does not belong to the law",
        "`c10_pa` and",
    );

    let elastic = |lines: &str, line: usize, what: &str, mend: &str| {
        let from = "\"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
        let to = format!("\"st-venant-kirchhoff\"\n{lines}");
        bench.refuses(from, &to, &format!("block.toml:{line}"), what, mend);
    };
    elastic(
        "young_pa = 0\npoisson = 0.3",
        8,
        "`young_pa` = 0 must be positive",
        "Young's modulus in pascals",
    );
    elastic("young_pa = inf\npoisson = 0.3", 8, "must be a finite number", "correct the value");
    elastic("young_pa = 1e4\npoisson = 0.5", 9, "`poisson` = 0.5 must be above -1 and below 0.5", "0.49");
    elastic("young_pa = 1e4\npoisson = -1", 9, "must be above -1", "ratio below 0.5");
    elastic("young_pa = 1e4", 7, "lacks `poisson`", "either `young_pa` and `poisson`, or");
    elastic("young_pa = 1e4\nmu_pa = 3e3", 9, "`mu_pa` does not belong", "either `young_pa`");
    elastic("young_pa = 1e4\npoisson = 0.3\nmu_pa = 3e3", 10, "`mu_pa` does not belong", "either `young_pa`");
    elastic("lambda_pa = 1e4\nmu_pa = 0.0", 9, "`mu_pa` = 0 must be positive", "shear modulus");
    elastic("lambda_pa = -1e4\nmu_pa = 1e4", 8, "bulk modulus", "larger `lambda_pa`");
    elastic("c10_pa = 1.0", 8, "`c10_pa` does not belong", "either `young_pa`");
    elastic("", 7, "lacks `lambda_pa`", "either `young_pa` and `poisson`, or `lambda_pa` and `mu_pa`");
}

#[test]
fn young_and_poisson_become_lame_constants() {
    let bench = Bench::new();
    let from = "\"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
    let to = "\"st-venant-kirchhoff\"\nyoung_pa = 15480\npoisson = 0.49";
    let scene = bench.with(from, to).expect("sound");
    let Material::StVenantKirchhoff(StVenantKirchhoff { lame: Lame { lambda_pa, mu_pa } }) =
        scene.materials[0].material
    else {
        panic!("{:?}", scene.materials);
    };
    // The paper's liver: mu = E / 2.98, lambda = 0.49 E / (1.49 * 0.02).
    assert!((lambda_pa / 254_536.912_751_677_9 - 1.0).abs() < 1e-14, "{lambda_pa}");
    assert!((mu_pa / 5_194.630_872_483_221 - 1.0).abs() < 1e-14, "{mu_pa}");
    let direct = bench.with(from, "\"st-venant-kirchhoff\"\nlambda_pa = 2.0\nmu_pa = 3.0").expect("sound");
    let lame = Lame { lambda_pa: 2.0, mu_pa: 3.0 };
    assert_eq!(direct.materials[0].material, Material::StVenantKirchhoff(StVenantKirchhoff { lame }));
}

#[test]
fn fixed_nodes_in_every_way() {
    let bench = Bench::new();
    let fixed = |line: &str| bench.with("group = \"left\"", line).expect("sound").fixed;
    assert_eq!(fixed("nodes = [9, 3, 3, 0]"), [0, 3, 9]);
    assert_eq!(fixed("box = { min = [-1, -1, 0.29], max = [0.01, 1, 1] }"), [3, 7, 11, 15]);
    assert_eq!(fixed("file = \"sets.json\"\nkey = \"F1\""), [0, 1, 2, 3, 5]);

    let refuses = |to, place, what, mend| bench.refuses("group = \"left\"", to, place, what, mend);
    refuses("", "block.toml:11", "does not say which nodes", "`nodes`, `group`, `box`, or `file`");
    refuses("nodes = [1]\ngroup = \"left\"", "block.toml:11", "in several ways", "keep one of");
    refuses("nodes = []", "block.toml:12", "the fixed set is empty", "at least three");
    refuses(
        "nodes = [\n1,\n64]",
        "block.toml:14",
        "node 64 is out of range: the mesh has 64 nodes",
        "0 to 63 (0-based",
    );
    refuses("nodes = [-1]", "block.toml:12", "node -1 is out of range", "0 to 63");
    refuses("group = \"lft\"", "block.toml:12", "no group of nodes named \"lft\"", "did you mean \"left\"?");
    refuses(
        "group = \"ceiling\"",
        "block.toml:12",
        "no group of nodes named",
        "use one of: all, corner, left, right",
    );
    refuses(
        "box = { min = [1, 0, 0], max = [0, 1, 1] }",
        "block.toml:12",
        "the box is empty",
        "swap the corners",
    );
    refuses(
        "box = { min = [1, 1, 1], max = [2, 2, 2] }",
        "block.toml:12",
        "set is empty",
        "to [0.3, 0.3, 0.3] in metres",
    );
    refuses("box = { min = [0, 0], max = [1, 1, 1] }", "block.toml:12", "invalid length 2", "expected type");
    refuses("file = \"sets.json\"", "block.toml:11", "both `file` and `key`", "add the other");
    refuses(
        "file = \"no.json\"\nkey = \"F1\"",
        "block.toml:12",
        "cannot read the sets",
        "relative to the scene",
    );
    refuses(
        "file = \"sets.json\"\nkey = \"F2\"",
        "block.toml:13",
        "no list named \"F2\"",
        "use one of: F1, bad, none",
    );
    refuses(
        "file = \"sets.json\"\nkey = \"none\"",
        "block.toml:13",
        "the fixed set is empty",
        "at least three",
    );
    refuses(
        "file = \"sets.json\"\nkey = \"bad\"",
        "sets.json",
        "entry 1 of \"bad\" (64) is not a node",
        "0 to 63",
    );
    bench.write("broken.json", "{\n\"F1\": [1,]\n}");
    refuses("file = \"broken.json\"\nkey = \"F1\"", "broken.json:2", "not valid JSON", "correct the syntax");
    bench.write("list.json", "[1, 2]");
    refuses("file = \"list.json\"\nkey = \"F1\"", "list.json:1", "not a JSON object", "write {\"F1\"");
}

#[test]
fn active_nodes_in_every_way() {
    let bench = Bench::new();
    let scene = bench.with("node = 63", "group = \"right\"").expect("sound");
    assert_eq!(scene.active.len(), 16 + 1);
    assert_eq!(scene.active[0], ActiveNode { name: "A1-48".into(), node: 48, patch: vec![] });
    let scene = bench.with("node = 63", "group = \"all\"").expect("sound");
    // 64 nodes less 16 fixed ones less the 8 inside.
    assert_eq!(scene.active.len(), 40 + 1);
    let single = SCENE.replacen("[[active]]", "[active]", 1).replacen("[[active]]\nname = \"A2\"", "", 1);
    let single = single.replacen("nearest = [0.31, 0.1, 0.1]", "", 1);
    assert_eq!(bench.resolve(&single).expect("one table will do").active.len(), 1);

    let refuses = |to, place, what, mend| bench.refuses("node = 63", to, place, what, mend);
    refuses("node = 64", "block.toml:15", "node 64 is out of range", "0 to 63");
    refuses("node = 5", "block.toml:15", "\"A1\" (node 5) is in the fixed set", "choose a free node");
    refuses("node = 21", "block.toml:15", "(node 21) is inside the body", "`nearest` = [0.1");
    refuses("nearest = [0, 0.1, 0.1]", "block.toml:15", "(node 5) is in the fixed set", "choose a free node");
    refuses(
        "nearest = [30, 10, 10]",
        "block.toml:15",
        "m from the body, which is 0.520 m across",
        "in metres",
    );
    refuses("nearest = [nan, 1, 1]", "block.toml:15", "is not finite", "correct the value");
    refuses("group = \"left\"", "block.toml:15", "no free surface node", "not fixed");
    refuses("group = \"top\"", "block.toml:15", "no group of nodes named \"top\"", "use one of: all, corner");
    refuses("", "block.toml:13", "\"A1\" does not say where it is", "give `node`, `nearest` or `group`");
    refuses("node = 63\ngroup = \"right\"", "block.toml:13", "says in several ways", "keep one of");
    bench.refuses("\"A2\"", "\"A1\"", "block.toml:17", "two active nodes are named \"A1\"", "its own name");
    let none = SCENE.replacen("name = \"block\"", "active = []", 1);
    let none = none.replacen("[[active]]\nname = \"A1\"\nnode = 63\n[[active]]\nname = \"A2\"\n", "", 1);
    let error = bench.resolve(&none.replacen("nearest = [0.31, 0.1, 0.1]\n", "", 1)).unwrap_err().to_string();
    assert!(error.contains("block.toml:1: the scene has no active node; add an [[active]]"), "{error}");
}

#[test]
fn grids_in_every_way() {
    let bench = Bench::new();
    for (points, cells) in GRID_POINTS {
        let grid = bench.with("spacing_m = 0.01", &format!("points = {points}")).expect("sound").grid;
        assert_eq!(
            grid,
            Some(GridSpec::Lattice {
                radius_m: 0.05,
                spacing_m: 0.05 / f64::from(cells),
                complete_cells: true,
                increments: None
            })
        );
    }
    let refuses = |from, to, place, what, mend| bench.refuses(from, to, place, what, mend);
    refuses(
        "spacing_m = 0.01",
        "points = 515",
        "block.toml:21",
        "`points` = 515",
        "514, 1418, 4168 or 14146",
    );
    refuses("spacing_m = 0.01", "", "block.toml:19", "does not say how fine", "`spacing_m` or `points`");
    refuses("spacing_m = 0.01", "spacing_m = 0.01\npoints = 514", "block.toml:22", "both", "keep one");
    refuses("spacing_m = 0.01", "spacing_m = 0.06", "block.toml:21", "larger than `radius_m`", "a fifth");
    refuses(
        "spacing_m = 0.01",
        "spacing_m = 0.0",
        "block.toml:21",
        "`spacing_m` = 0 is not a positive",
        "correct",
    );
    refuses("spacing_m = 0.01", "spacing_m = 0.0001", "block.toml:21", "over 126 cells", "coarser");
    refuses(
        "radius_m = 0.05",
        "radius_m = -1",
        "block.toml:20",
        "`radius_m` = -1 is not a positive",
        "correct",
    );
    refuses(
        "radius_m = 0.05",
        "radius_m = inf",
        "block.toml:20",
        "`radius_m` = inf is not a positive",
        "correct",
    );
    refuses(
        "max_force_n = 8",
        "max_force_n = nan",
        "block.toml:23",
        "`max_force_n` = NaN",
        "correct the value",
    );
    refuses("max_force_n = 8", "", "block.toml:22", "`max_force_n` is missing", "add `max_force_n`");
}

/// A store keeps the scene's text; years later the profile may say something else, or be gone.
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

#[test]
fn a_body_that_nothing_holds_is_refused_and_oddities_are_told() {
    let bench = Bench::new();
    let warning_of = |from: &str, to: &str| bench.with(from, to).expect("can be solved").warnings.join("\n");
    let line = warning_of("group = \"left\"", "nodes = [0, 1, 2]");
    assert!(line.contains("a piece of the body is held by 3 fixed nodes on one line"), "{line}");
    let rigid = warning_of("group = \"left\"", "box = { min = [0, 0, 0], max = [0.1, 0.1, 0.1] }");
    assert_eq!(rigid, "6 tets have all four vertices fixed and cannot deform");
    let negative = warning_of("c01_pa = 1280.0", "c01_pa = -100.0");
    assert!(negative.contains("`c01_pa` = -100 is negative"), "{negative}");
    let twice = warning_of("node = 63", "node = 53");
    assert!(twice.contains("\"A1\" and \"A2\" are both node 53"), "{twice}");
    let wide = warning_of("radius_m = 0.05", "radius_m = 0.6");
    assert!(wide.contains("radius 0.6 m is larger than the body, 0.520 m across"), "{wide}");

    // A second cube 1 m beside the first.
    let (first, mut tets) = (cube(3, 30.0), cube(3, 30.0).tets);
    let mut nodes = first.nodes_m.clone();
    nodes.extend(first.nodes_m.iter().map(|x| [x[0] + 100.0, x[1], x[2]]));
    tets.extend(first.tets.iter().map(|tet| tet.map(|node| node + 64)));
    bench.write("cube.msh", &gmsh(&TetMesh::new(nodes, tets).expect("sound")));
    let what = "the mesh has 2 separate pieces, and the one of node 64 (64 nodes) has no fixed node";
    bench.refuses("[fixed]", "[fixed]", "block.toml:11", what, "fix nodes of it, or remove the piece");
    let held = warning_of("group = \"left\"", "nodes = [0, 1, 4, 64, 65, 68]");
    assert!(held.contains("2 separate pieces"), "{held}");

    // Two tets that share an edge only.
    let mut hinge = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    hinge.extend([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]);
    let hinge = TetMesh::new(hinge, vec![[0, 1, 2, 3], [0, 1, 4, 5]]).expect("sound");
    bench.write("cube.msh", &gmsh(&hinge));
    let text = SCENE.replacen("node = 63", "node = 5", 1).replacen("[0.31, 0.1, 0.1]", "[0, 0, -0.01]", 1);
    let hinged =
        bench.resolve(&text.replacen("group = \"left\"", "nodes = [0, 2, 3]", 1)).expect("can be solved");
    assert!(
        hinged.warnings.join("\n").contains("not a closed manifold (1 bad edge"),
        "{:?}",
        hinged.warnings
    );
}

#[test]
fn regions_are_resolved_for_the_day_the_solver_takes_them() {
    let bench = Bench::new();
    let resolve = |rest: &str| {
        let text = SCENE.replacen("[material]", "[[material]]\ngroup = \"corner\"", 1);
        let scene =
            Scene::parse(&bench.path("block.toml"), text.replacen("[fixed]", rest, 1)).expect("well-formed");
        resolve::resolve(&scene, None)
    };
    let error = resolve("[fixed]").unwrap_err().to_string();
    assert!(error.contains("block.toml:6: 156 tets of the mesh in no material's group; add a"), "{error}");
    let second = "[[material]]\ngroup = \"all\"\nlaw = \"linear\"\nlambda_pa = 1.0\nmu_pa = 1.0\n[fixed]";
    let error = resolve(second).unwrap_err().to_string();
    assert!(error.contains("block.toml:12: tet 0 (0-based) already has a material"), "{error}");
    let error = resolve(&second.replacen("group = \"all\"", "", 1)).unwrap_err().to_string();
    assert!(error.contains("has no `group`; name the group of each region"), "{error}");
    let error = resolve(&second.replacen("\"all\"", "\"left\"", 1)).unwrap_err().to_string();
    assert!(error.contains("no group of volumes named \"left\"; use one of: all, corner"), "{error}");
    let text = SCENE.replacen("c01_pa = 1280.0", "c01_pa = 1280.0\ngroup = \"all\"", 1);
    let whole = Scene::parse(&bench.path("block.toml"), text).expect("well-formed");
    let regions = resolve::resolve(&whole, None).expect("sound").materials;
    assert_eq!(regions[0].tets, Some((0..162).collect()));
    let force = SCENE.replacen("[device]", "[body_force]\nforce_n_per_m3 = [0, 0, -1e4]\n[device]", 1);
    let heavy = Scene::parse(&bench.path("block.toml"), force).expect("well-formed");
    assert_eq!(resolve::resolve(&heavy, None).expect("sound").body_force, Some([0.0, 0.0, -1e4]));
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
        // In millimetres the body is ten times smaller, and so is what is near it.
        let to_nearest = if to.contains("mm") { "[0.031, 0.01, 0.01]" } else { "[0.31, 0.1, 0.1]" };
        let text = SCENE.replacen(from, to, 1).replacen("[0.31, 0.1, 0.1]", to_nearest, 1);
        let other = bench.resolve(&text).expect("sound");
        assert_ne!(other.content_hash(), scene.content_hash(), "{to}");
        assert_eq!(other.model_hash() != scene.model_hash(), of_the_model, "{to}");
    }
}
