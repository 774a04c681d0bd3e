use std::path::Path;

use super::*;
use crate::live::Truth;
use crate::mesh::TetMesh;
use crate::mesh::testing::nodes_where;
use crate::scene::Scene;

const COLUMN: &str = r#"
name = "column"
[mesh]
file = "none.msh"
unit = "m"
[material]
law = "neo-hookean"
young_pa = 15480.0
poisson = 0.45
[fixed]
box = { min = [-1, -1, -1], max = [1e-6, 1, 1] }
[[active]]
name = "end"
node = 10
"#;

/// A straight column of 100 x 10 x 10 mm that is compressed at its end buckles. Steps without a factor of the tangent stay
/// on the straight branch.
#[test]
fn the_truth_of_a_large_body_leaves_an_unstable_branch() {
    let mesh = TetMesh::cuboid([10, 1, 1], 0.01);
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let scene = Scene::parse(Path::new("column.toml"), COLUMN.into()).expect("well-formed");
    let scene = scene.resolve_in(mesh, fixed).expect("sound");
    let forces = [f64::INFINITY, 0.0].map(|large_flops| {
        let mut live = LiveSolver::new(&scene).expect("it can be touched");
        Arc::get_mut(&mut live.free).expect("nobody else has it").newton.large_flops = large_flops;
        let end = |place: &crate::pack::Place| place.rest_m[0] > 0.099;
        let contact = live.skin.contacts.iter().position(end).expect("on the skin") as u16;
        let mut truth = Truth::new(&live);
        let force_n = (1..=10).map(|step| {
            let control_m = [-2e-3 * f64::from(step), 0.0, 0.0];
            let touch = Touch { contacts: [(contact, 1.0), (0, 0.0), (0, 0.0)], control_m };
            norm(truth.force_n(&touch).expect("it rests"))
        });
        let force_n: Vec<f64> = force_n.collect();
        (force_n, truth.landings())
    });
    let [(exact_n, landed), (large_n, large_landed)] = forces;
    println!("{exact_n:?} {landed} {large_n:?} {large_landed}");
    assert!(landed > 0 && large_landed > 0, "{landed} {large_landed}");
    for (exact_n, large_n) in exact_n.iter().zip(&large_n) {
        assert!((exact_n - large_n).abs() < 0.01 * exact_n, "{exact_n} {large_n}");
    }
}
