//! Forces on the bundled organ compared with GetFEM, which the paper used (`tests/peers`, results committed).

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;
use palpate_precompute::fem::material::{Material, Value};
use palpate_precompute::fem::{Body, Problem, Solver};
use palpate_precompute::scene::{ElementOrder, Scene};

/// One row: displacement, force and energy.
struct Row {
    displacement_m: [f64; 3],
    force_n: [f64; 3],
    energy_j: f64,
}

/// The first columns of a case: mesh, law, order, fixed set, active node.
type Key = (String, String, u8, String, String, u32);

fn golden() -> BTreeMap<Key, Vec<Row>> {
    let text = include_str!("../../peers/golden/forces.csv");
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().expect("the table has a header").split(',').collect();
    let column = |name: &str| header.iter().position(|h| *h == name).expect("a column of the golden table");
    let mut cases: BTreeMap<Key, Vec<Row>> = BTreeMap::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let text = |name: &str| cells[column(name)].to_owned();
        let number = |name: &str| -> f64 { cells[column(name)].parse().expect("a number") };
        let key = (
            text("case"),
            text("law"),
            number("order") as u8,
            text("mesh"),
            text("fixed"),
            number("active_node") as u32,
        );
        cases.entry(key).or_default().push(Row {
            displacement_m: ["dx_m", "dy_m", "dz_m"].map(number),
            force_n: ["fx_n", "fy_n", "fz_n"].map(number),
            energy_j: number("energy_j"),
        });
    }
    cases
}

/// The parameters of the liver, as in tests/peers/getfem_model.py.
fn material(law: &str) -> Material {
    let given = if law.starts_with("mooney-rivlin") {
        [("c10_pa", Value::Number(1300.0)), ("c01_pa", Value::Number(1280.0))]
    } else {
        [("young_pa", Value::Number(15480.0)), ("poisson", Value::Number(0.49))]
    };
    Material::from_parameters(law, &given).unwrap_or_else(|error| panic!("the golden table: {error}"))
}

#[test]
fn forces_and_energies_on_the_bundled_organ_agree_with_getfem() {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    let cases = golden();
    assert!(cases.len() >= 28, "the golden table is incomplete: {}", cases.len());
    println!("{:44} {:>5} {:>9} {:>9}   worst relative difference", "case", "rows", "force", "energy");
    for ((case, law, order, mesh, fixed, node), rows) in cases {
        let scene = Scene::load(&assets.join(format!("{mesh}.toml"))).and_then(|scene| scene.resolve());
        let mut scene = scene.unwrap_or_else(|error| panic!("{error}"));
        scene.order = if order == 1 { ElementOrder::Linear } else { ElementOrder::Quadratic };
        scene.materials[0].material = material(&law);
        scene.fixed = scene.mesh.node_groups[&fixed].clone();
        let body = Body::new(&scene.mesh, &scene.model()).expect("the organ is valid");
        let mut solver = Solver::new(Arc::new(Problem::new(Arc::new(body), node)));
        let mut here = solver.rest().expect("the organ is fixed");
        let (mut force, mut energy) = (0.0f64, 0.0f64);
        for row in &rows {
            here = solver.advance(&here.seed, row.displacement_m).unwrap_or_else(|e| panic!("{case}: {e}"));
            let exact = Vector3::from(row.force_n);
            force = force.max((Vector3::from(here.jet().force_n) - exact).norm() / exact.norm());
            energy = energy.max((here.jet().energy_j / row.energy_j - 1.0).abs());
        }
        println!("{case:44} {:>5} {force:9.1e} {energy:9.1e}", rows.len());
        // GetFEM stops at a residual of up to 2.5e-12 of the force. The energy error is of second order in
        // it.
        assert!(force < 1e-9 && energy < 1e-9, "{case}");
    }
}
