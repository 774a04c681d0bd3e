//! Pulls of 60 mm on the bundled organ: every law, both active nodes.

use nalgebra::Vector3;
use palpate_precompute::fem::Handle;
use palpate_precompute::fem::Solver;
use palpate_precompute::mesh::Surface;

use super::table::{Case, Cost, row};
use super::walk::{body, norm, organ, problem, relative_error, state, walk};

const STEP_M: f64 = 0.005;
const STEPS: u32 = 12;

#[test]
fn every_law_converges_over_a_pull_of_60_mm() {
    let scene = organ();
    let skin = Surface::of(&scene.mesh);
    for active in &scene.active {
        let outward = skin.normal(active.node).expect("active nodes are on the surface");
        let end = Vector3::from(outward).normalize() * (STEP_M * f64::from(STEPS));
        for law in palpate_tests::livers() {
            let mut scene = scene.clone();
            scene.materials[0].material = law.clone();
            let body = body(&scene.mesh, &scene.model());
            let mut solver = Solver::new(problem(&body, Handle::node(active.node)));
            let name = format!("{}, {}", law.name(), active.name);
            let pulled = walk(&mut solver, outward, STEP_M, STEPS).expect("the organ is fixed");
            let work = pulled.work_j / pulled.last.jet().energy_j - 1.0;
            let verdict = format!("{}; work/energy - 1 = {work:.0e}", pulled.verdict());
            row(Case::OrganPull, &format!("{name}, 12 x 5 mm"), pulled.cost, &pulled.result(), &verdict);
            assert!(pulled.failure.is_none(), "{name}: {:?}", pulled.failure);
            assert_eq!(pulled.last.inverted, 0, "{name}");
            // The energy is a potential of the force over the whole pull.
            assert!(work.abs() < 2e-3, "{name}: {work:e}");
            let mut balance = Vector3::from(pulled.last.jet().force_n);
            for &node in &scene.fixed {
                balance += Vector3::from_column_slice(&solver.nodal_force_n()[3 * node as usize..][..3]);
            }
            assert!(balance.norm() < 1e-7 * norm(pulled.last.jet().force_n), "{name}: {balance}");
            // The whole pull as one transition reaches the same state with other increments.
            let rest = solver.rest().expect("the organ is fixed");
            match solver.advance(&rest.seed, end.into()) {
                Ok(at_once) => {
                    let error = relative_error(at_once.jet().force_n, pulled.last.jet().force_n);
                    let cost = Cost::of(pulled.cost.equations, &at_once);
                    let verdict = format!("force {error:.0e} from the steps");
                    row(Case::OrganPull, &format!("{name}, 60 mm at once"), cost, &state(&at_once), &verdict);
                    assert!(error < 1e-6, "{name}: another branch, {error:e}");
                }
                Err(failure) => {
                    let cost = Cost { iterations: failure.iterations, ..Cost::default() };
                    let tried = format!("{name}, 60 mm at once");
                    row(Case::OrganPull, &tried, cost, "-", &failure.reason.to_string());
                }
            }
        }
    }
}
