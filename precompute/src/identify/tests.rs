//! Derivatives by differences, and recovery of known constants.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use super::forward::Reaction;
use super::*;
use crate::num::sequence::{split_mix, unit_interval};
use crate::num::vector::norm;

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/scenes")
}

/// A bundled scene with other tables.
fn scene(name: &str, change: impl Fn(String) -> String) -> Scene {
    let path = scenes().join(name);
    let text = std::fs::read_to_string(&path).expect("a bundled scene");
    Scene::parse(&path, change(text)).expect("a scene")
}

fn data(text: &str) -> Data {
    Data::parse(Path::new("data.csv"), text.as_bytes(), Some([0.0, 0.0, -1.0])).expect("a table")
}

/// The table with the forces of the model at these values of the constants, and noise.
fn measured(scene: &Scene, free: &[&str], values: &[f64], table: &Data, noise_n: f64, seed: u64) -> Data {
    let constants = scene.constants();
    let free: Vec<SceneConstant> =
        free.iter().map(|name| constants.iter().find(|c| c.name == *name).expect("named").clone()).collect();
    let mut forward =
        Forward::new((scene, &scene.resolve().expect("a scene")), &free, table, None, Run::run_to_end())
            .expect("a problem");
    let reactions = forward.reactions(values, &|_, _| ()).expect("equilibria");
    let mut random = seed << 20;
    let mut gaussian = || {
        let mut next = || {
            random += 1;
            unit_interval(split_mix(split_mix(random)))
        };
        noise_n * ((0..12).map(|_| next()).sum::<f64>() - 6.0)
    };
    let mut table = table.clone();
    for (row, reaction) in table.rows.iter_mut().zip(&reactions) {
        row.force_n = Force::Vector(reaction.force_n.map(|f| f + gaussian()));
    }
    table
}

fn options(free: &[&str]) -> Options {
    Options { free: free.iter().map(|name| (*name).to_owned()).collect(), ..Options::default() }
}

fn fit(scene: &Scene, data: &Data, options: &Options, run: Run<'_>) -> Result<Identified, IdentifyError> {
    identify(scene, &scene.resolve().expect("a scene"), data, options, run, |_| ())
}

/// dh/dtheta against central differences of solved forces.
fn check_jacobian(scene: &Scene, names: &[&str], table: &Data) {
    let constants = scene.constants();
    let free: Vec<SceneConstant> =
        names.iter().map(|name| constants.iter().find(|c| c.name == *name).expect(name).clone()).collect();
    let values: Vec<f64> = free.iter().map(|constant| constant.value).collect();
    let mut forward =
        Forward::new((scene, &scene.resolve().expect("a scene")), &free, table, None, Run::run_to_end())
            .expect("a problem");
    let here = forward.reactions(&values, &|_, _| ()).expect("equilibria");
    for (k, name) in names.iter().enumerate() {
        let mut at = |share: f64| {
            let mut values = values.clone();
            values[k] *= 1.0 + share;
            forward.reactions(&values, &|_, _| ()).expect("equilibria")
        };
        let step = 2e-4;
        let [far, near] = [2.0 * step, step].map(|step| (at(step), at(-step), 2.0 * step * values[k]));
        let mut worst = 0.0_f64;
        let largest = here.iter().map(|row| norm(row.by_constants[k])).fold(0.0, f64::max);
        for (row, reaction) in here.iter().enumerate() {
            let slope = |(more, less, step): &(Vec<Reaction>, Vec<Reaction>, f64), axis: usize| {
                (more[row].force_n[axis] - less[row].force_n[axis]) / step
            };
            for axis in 0..3 {
                // Richardson's extrapolation: the error of the differences is of fourth order.
                let difference = (4.0 * slope(&near, axis) - slope(&far, axis)) / 3.0;
                worst = worst.max((reaction.by_constants[k][axis] - difference).abs() / largest);
            }
        }
        assert!(worst < 1e-6, "{name}: {worst:.1e}");
    }
}

const PUSH: &str = "dx_mm,dy_mm,dz_mm,fx_n,fy_n,fz_n\n0.5,0,-2,0,0,0\n1,1,-5,0,0,0\n2,0,-9,0,0,0\n";

#[test]
fn the_derivatives_are_those_of_differences_for_every_law() {
    let table = data(PUSH);
    let laws = [
        ("mooney-rivlin", "c10_pa = 1300.0\nc01_pa = 1280.0", &["c10_pa", "c01_pa"][..]),
        (
            "mooney-rivlin-reduced",
            "c10_pa = 1300.0\nc01_pa = 1280.0\nbulk_pa = 2e5",
            &["c10_pa", "c01_pa", "bulk_pa"],
        ),
        ("st-venant-kirchhoff", "young_pa = 15480.0\npoisson = 0.45", &["young_pa", "poisson"]),
        ("neo-hookean", "lambda_pa = 5e4\nmu_pa = 5e3", &["lambda_pa", "mu_pa"]),
        ("linear", "young_pa = 15480.0\npoisson = 0.4", &["young_pa", "poisson"]),
        (
            "holzapfel-gasser-ogden",
            "c10_pa = 2000.0\nk1_pa = 3000.0\nk2 = 2.0\nfibre = [1.0, 0.0, 0.0]",
            &["c10_pa", "k1_pa"],
        ),
    ];
    for (law, constants, names) in laws {
        let text = format!(
            "[mesh]\nfile = \"../liver-small.msh\"\n[material]\nlaw = \"{law}\"\n{constants}\n[fixed]\ngroup = \"F1\"\n\
             [[active]]\nname = \"A1\"\nnode = 199\n"
        );
        check_jacobian(&Scene::parse(&scenes().join("law.toml"), text).expect(law), names, &table);
    }
}

#[test]
fn the_derivatives_are_those_of_differences_for_every_contact_and_element() {
    let law =
        "[material]\nlaw = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0\n[fixed]\ngroup = \"F1\"\n";
    let mesh = |more: &str| format!("[mesh]\nfile = \"../liver-small.msh\"\n{more}{law}");
    let (rest_m, normal) = skin_place();
    let free = ["c10_pa", "c01_pa"];
    let along = |from_m: f64, depths_mm: &[f64], position: bool| {
        let column = if position { "" } else { "d" };
        let mut text = format!("{column}x_m,{column}y_m,{column}z_m,fx_n,fy_n,fz_n\n");
        for depth in depths_mm {
            let at: Vec<String> = (0..3)
                .map(|k| {
                    let rest = if position { rest_m[k] } else { 0.0 };
                    (rest + normal[k] * (from_m - 1e-3 * depth)).to_string()
                })
                .collect();
            text.push_str(&format!("{},0,0,0\n", at.join(",")));
        }
        data(&text)
    };
    let point = format!("[[active]]\nname = \"A1\"\npoint = [{}, {}, {}]\n", rest_m[0], rest_m[1], rest_m[2]);
    let finger = "[tool]\nshape = \"fingertip\"\nradius_m = 0.015\nstiffness_pa_m = 2e7\n";
    let cases = [
        (
            "patch",
            mesh("") + "[[active]]\nname = \"A1\"\nnode = 199\npatch_radius_m = 0.02\n",
            along(0.0, &[3.0, 8.0], false),
        ),
        (
            "multipliers",
            mesh("") + "[[active]]\nname = \"A1\"\nnode = 199\n[solver]\nconstraints = \"multipliers\"\n",
            along(0.0, &[3.0, 8.0], false),
        ),
        (
            "stabilised",
            mesh("") + "[[active]]\nname = \"A1\"\nnode = 199\n[solver]\npressure = \"stabilised\"\n",
            along(0.0, &[3.0, 8.0], false),
        ),
        (
            "second order",
            mesh("order = 2\n") + "[[active]]\nname = \"A1\"\nnode = 199\n",
            along(0.0, &[3.0], false),
        ),
        ("fingertip", mesh("") + finger + &point, along(0.0, &[3.0, 6.0], false)),
        ("near the tool", mesh("order = \"tool\"\n") + finger + &point, along(0.0, &[3.0], false)),
        (
            "sphere",
            mesh("") + "[tool]\nshape = \"sphere\"\nradius_m = 0.01\n",
            along(0.01, &[-2.0, 2.0, 4.0], true),
        ),
        (
            "capsule",
            mesh("")
                + "[tool]\nshape = \"capsule\"\nradius_m = 0.01\nlength_m = 0.01\naxis = [1.0, 0.0, 0.0]\n",
            along(0.01, &[-2.0, 2.0, 4.0], true),
        ),
    ];
    for (name, text, table) in cases {
        let scene =
            Scene::parse(&scenes().join(name), text).unwrap_or_else(|error| panic!("{name}: {error}"));
        println!("{name}");
        check_jacobian(&scene, &free, &table);
    }
}

/// The tumour of the bundled scene, touched at single nodes of linear elements, which is fast.
fn two_regions() -> Scene {
    scene("tumour.toml", |text| {
        let text =
            text.replace("order = 2\n", "").replace("[tool]\nshape = \"fingertip\"\nradius_m = 0.015\n", "");
        text.replace("c10_pa = 1300.0\n", "c10_pa = 2000.0 # a guess\n")
            .replace("c10_pa = 13000.0", "c10_pa = 6000.0")
    })
}

#[test]
fn two_regions_are_identified_from_noisy_forces_and_the_scene_keeps_its_text() {
    let scene = two_regions();
    let mut table = "active,dx_mm,dy_mm,dz_mm,fx_n,fy_n,fz_n\n".to_owned();
    for place in ["above", "beside"] {
        for depth in [2, 5, 8, 11] {
            table.push_str(&format!("{place},0,-{depth},1,0,0,0\n"));
        }
    }
    let names = ["tissue.c10_pa", "tumour.c10_pa"];
    let table = measured(&scene, &names, &[1300.0, 13000.0], &data(&table), 2e-4, 1);
    let found = fit(&scene, &table, &options(&names), Run::run_to_end()).expect("identified");
    for (parameter, truth) in found.parameters.iter().zip([1300.0, 13000.0]) {
        assert!((parameter.value - truth).abs() < 4.0 * parameter.standard_error, "{parameter:?}");
        assert!(parameter.standard_error < 0.2 * truth, "{parameter:?}");
    }
    assert!(!found.is_misfit, "{:?}", found.warnings);
    let text = found.scene.text_for(&scenes()).expect("the folder is there");
    let value = found.parameters[0].value;
    assert!(text.contains(&format!("c10_pa = {value:?} # a guess")), "{text}");
    let elsewhere = found.scene.text_for(Path::new("/")).expect("the folder is there");
    assert!(
        elsewhere.contains("/tumour.msh\"") && !elsewhere.contains("file = \"tumour.msh\""),
        "{elsewhere}"
    );
    // The same bits on any number of threads.
    let run = Run { threads: 1, ..Run::run_to_end() };
    let alone = fit(&scene, &table, &options(&names), run).expect("identified");
    assert_eq!(alone.parameters, found.parameters);
}

/// St. Venant-Kirchhoff, at the top of the small organ.
fn stiff() -> Scene {
    let text = "[mesh]\nfile = \"../liver-small.msh\"\n[material]\nlaw = \"st-venant-kirchhoff\"\nyoung_pa = 9000.0\n\
                poisson = 0.4\n[fixed]\ngroup = \"F1\"\n[[active]]\nname = \"A1\"\nnode = 199\n";
    Scene::parse(&scenes().join("stiff.toml"), text.into()).expect("a scene")
}

#[test]
fn an_outlier_counts_little_with_a_robust_loss() {
    let scene = stiff();
    let rows: String = (1..=8).map(|depth| format!("0,0,-{depth},0,0,0\n")).collect();
    let table = data(&format!("dx_mm,dy_mm,dz_mm,fx_n,fy_n,fz_n\n{rows}"));
    let mut table = measured(&scene, &["young_pa"], &[15_480.0], &table, 1e-3, 2);
    // A row in another unit.
    if let Force::Vector(force) = &mut table.rows[2].force_n {
        force.iter_mut().for_each(|f| *f *= 10.0);
    }
    let error = |loss| {
        let options = Options { loss, ..options(&["young_pa"]) };
        let found = fit(&scene, &table, &options, Run::run_to_end()).expect("identified");
        (found.parameters[0].value / 15_480.0 - 1.0).abs()
    };
    let [linear, huber, soft] = [Loss::Linear, Loss::Huber, Loss::SoftL1].map(error);
    assert!(linear > 0.2 && huber < 0.01 && soft < 0.01, "{linear:.3} {huber:.4} {soft:.4}");
}

/// The skin at node 199 of the small organ: place and outward normal.
fn skin_place() -> ([f64; 3], [f64; 3]) {
    let resolved = stiff().resolve().expect("a scene");
    let surface = crate::mesh::Surface::of(&resolved.mesh);
    let active = &resolved.active[0];
    (active.place_m(&resolved.mesh), active.normal(&surface).expect("on the skin"))
}

#[test]
fn a_sphere_may_begin_in_contact_withdraw_and_slide() {
    let (rest_m, normal) = skin_place();
    let tool = "[tool]\nshape = \"sphere\"\nradius_m = 0.01\n";
    let text = stiff().text().replace("[[active]]\nname = \"A1\"\nnode = 199\n", tool);
    let scene = Scene::parse(&scenes().join("sphere.toml"), text).expect("a scene");
    let mut table = "test,x_m,y_m,z_m,fx_n,fy_n,fz_n\n".to_owned();
    for (test, places_mm) in [
        ("withdraw", vec![[0.0, 5.0], [0.0, 3.0], [0.0, -1.0]]),
        ("slide", vec![[0.0, 3.0], [3.0, 3.0]]),
        ("press and withdraw", vec![[0.0, -1.0], [0.0, 5.0], [0.0, -2.0]]),
    ] {
        for [side_mm, depth_mm] in places_mm {
            let side_m = [1e-3 * side_mm, 0.0, 0.0];
            let at = |k: usize| rest_m[k] + normal[k] * (0.01 - 1e-3 * depth_mm) + side_m[k];
            table.push_str(&format!("{test},{},{},{},0,0,0\n", at(0), at(1), at(2)));
        }
    }
    let table = measured(&scene, &["young_pa"], &[15_480.0], &data(&table), 0.0, 1);
    let found = fit(&scene, &table, &options(&["young_pa"]), Run::run_to_end()).expect("identified");
    assert!((found.parameters[0].value / 15_480.0 - 1.0).abs() < 1e-6, "{:?}", found.parameters);
}

/// Depth and force of a pull have the signs of a push: only the skin tells the direction.
#[test]
fn a_direction_out_of_the_body_is_a_warning() {
    let (_, normal) = skin_place();
    let warned = |direction: [f64; 3]| {
        let table = "depth_mm,force_n\n2,0.4\n4,0.8\n6,1.2\n";
        let table = Data::parse(Path::new("d.csv"), table.as_bytes(), Some(direction)).expect("a table");
        let found = fit(&stiff(), &table, &options(&["young_pa"]), Run::run_to_end()).expect("identified");
        found.warnings.iter().any(|warning| warning.contains("points out of the body at \"A1\""))
    };
    assert!(warned(normal) && !warned(normal.map(|x| -x)));
}

#[test]
fn a_bound_at_zero_does_not_hold_a_constant_that_begins_there() {
    let scene = scene("indentation.toml", |text| text.replace("c01_pa = 600.0", "c01_pa = 0.0"));
    let table = measured(&scene, &["c10_pa", "c01_pa"], &[1300.0, 1280.0], &data(PUSH), 0.0, 1);
    let bounds = vec![("c01_pa".to_owned(), Bounds { low: 0.0, high: f64::INFINITY })];
    let options = Options { bounds, ..options(&["c10_pa", "c01_pa"]) };
    let found = fit(&scene, &table, &options, Run::run_to_end()).expect("identified");
    assert!((found.parameters[1].value - 1280.0).abs() < 0.1 && found.evaluations < 20, "{found:?}");
}

#[test]
fn a_value_at_its_bound_has_no_interval() {
    let scene = stiff();
    let table = measured(&scene, &["young_pa"], &[15_480.0], &data(PUSH), 1e-3, 3);
    let bounds = vec![("young_pa".to_owned(), Bounds { low: 5000.0, high: 12_000.0 })];
    let options = Options { bounds, ..options(&["young_pa"]) };
    let found = fit(&scene, &table, &options, Run::run_to_end()).expect("identified");
    let [young] = &found.parameters[..] else { panic!("one constant") };
    assert!(
        young.is_at_bound && (young.value - 12_000.0).abs() < 0.1 && young.low == young.high,
        "{young:?}"
    );
    assert!(found.warnings.iter().any(|warning| warning.contains("at its bound")), "{:?}", found.warnings);
}

#[test]
fn what_cannot_be_identified_is_one_line() {
    let (scene, table) = (stiff(), data(PUSH));
    let refused = |scene: &Scene, table: &Data, options: &Options| {
        let found = fit(scene, table, options, Run::run_to_end());
        found.map(|found| found.parameters).expect_err("refused").to_string()
    };
    let error = refused(&scene, &table, &options(&["c10_pa"]));
    assert!(
        error.contains("no material has the constant `c10_pa`; the scene states young_pa, poisson"),
        "{error}"
    );
    let error = refused(&scene, &table, &options(&["young_pa", "young_pa"]));
    assert!(error.contains("named twice"), "{error}");
    let fibres = super::tests::scene("fibres.toml", |text| text);
    let error = refused(&fibres, &table, &options(&["k2"]));
    assert!(error.contains("not linear in it; choose from c10_pa, k1_pa"), "{error}");
    let short = data("depth_mm,force_n\n5,1\n");
    let error = refused(&scene, &short, &options(&["young_pa"]));
    assert!(error.contains("1 measured force components for 1 constants"), "{error}");
    let lost = Options { active: Some("A9".into()), ..options(&["young_pa"]) };
    assert!(
        refused(&scene, &table, &lost).contains("data.csv:2: the scene has no active node \"A9\"; it has"),
        "A9"
    );
    let bounds = |low, high| Options {
        bounds: vec![("young_pa".into(), Bounds { low, high })],
        ..options(&["young_pa"])
    };
    assert!(refused(&scene, &table, &bounds(9.0, 1.0)).contains("no interval"));
    assert!(refused(&scene, &table, &bounds(1.0, 9.0)).contains("not within its bounds"));
    // The sphere's place is a position.
    let sphere = super::tests::scene("probe.toml", |text| text);
    let error = refused(&sphere, &table, &options(&["tissue.mu_pa"]));
    assert!(error.contains("give positions of its centre"), "{error}");
    let heavy = super::tests::scene("gravity.toml", |text| text);
    let name = heavy.constants()[0].name.clone();
    let error = refused(&heavy, &table, &options(&[&name]));
    assert!(error.contains("[body_force] depends on the constants"), "{error}");
}

#[test]
fn a_raised_flag_ends_the_fit() {
    let stop = AtomicBool::new(true);
    let run = Run { threads: 2, stop: &stop };
    let found = fit(&stiff(), &data(&PUSH.replace(",0,0,0\n", ",0,0,-1\n")), &options(&["young_pa"]), run);
    assert!(matches!(found.map(|_| ()), Err(IdentifyError::Interrupted)));
}
