//! Solves the same displacement from perturbed starts, and checks whether the branch is the same.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate_precompute::fem::material::{Lame, Material, StVenantKirchhoff};
use palpate_precompute::fem::{Configuration, Handle, Model, Pose, Problem, SolveFailure, Solver};
use palpate_precompute::scene::Scene;
use palpate_tests::{box_mesh, mooney_rivlin, nearest_node, nodes_where, soft_beam, st_venant_kirchhoff};

use super::table::{Case, Cost, row};
use super::walk::{body, problem, state};

/// Pseudo-random numbers in -1..1 from a seed.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut bits = 0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(seed + 1);
    move || {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Solves again at the displacement of `from`, with each free displacement perturbed by up to `size_m`.
fn again(
    problem: &Arc<Problem>,
    from: &Configuration,
    size_m: f64,
    seed: u64,
) -> Result<Configuration, SolveFailure> {
    let mut start = from.seed.state.clone();
    let mut random = noise(seed);
    for (value, fixed) in start.iter_mut().zip(problem.body.fixed.as_flattened()) {
        let push = size_m * random();
        if !fixed {
            *value += push;
        }
    }
    Solver::new(problem.clone()).solve_at(&Pose { ..from.seed.pose }, &start)
}

/// Largest difference of a displacement component, m.
fn distance_m(problem: &Problem, a: &Configuration, b: &Configuration) -> f64 {
    let n = problem.body.displacement_len();
    let pairs = a.seed.state.iter().zip(&b.seed.state).take(n);
    pairs.map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

/// Ten starts of each size. Returns how many reach the same branch, and their largest difference, m.
fn disturb(name: &str, problem: &Arc<Problem>, from: &Configuration, share: f64) -> (u32, f64) {
    let (mut back, mut other, mut failed, mut worst) = (0, 0, 0, 0.0f64);
    let (mut far, mut cost) = (0.0f64, Cost { equations: problem.unknowns(), ..Cost::default() });
    for seed in 0..10 {
        match again(problem, from, share * problem.body.edge_m, seed) {
            Ok(c) => {
                cost.iterations += c.iterations;
                cost.factorisations += c.factorisations;
                cost.increments += 1;
                let error = distance_m(problem, &c, from);
                if error < 1e-6 {
                    back += 1;
                    worst = worst.max(error);
                } else {
                    other += 1;
                    far = far.max(error);
                }
            }
            Err(f) => {
                failed += 1;
                cost.iterations += f.iterations;
            }
        }
    }
    let tried = format!("{name}, 10 starts perturbed by {share} edge");
    let result = format!(
        "{back} on the same branch (within {worst:.0e} m), {other} on others (up to {:.1} mm), {failed} failed",
        1e3 * far
    );
    row(Case::Branches, &tried, cost, &result, if back == 10 { "same branch" } else { "several branches" });
    (back, worst)
}

#[test]
fn a_perturbed_start_converges_to_the_same_branch() {
    for material in [st_venant_kirchhoff(), mooney_rivlin()] {
        let (_, _, active, body) = soft_beam(material.clone());
        let problem = problem(&body, Handle::node(active));
        let mut solver = Solver::new(problem.clone());
        let rest = solver.rest().expect("the beam is fixed");
        let here = solver.advance(&rest.seed, [0.004, 0.003, -0.012]).expect("the beam converges");
        for share in [1e-3, 1e-2, 0.1, 0.3] {
            let (back, worst) = disturb(material.name(), &problem, &here, share);
            if share <= 0.01 {
                assert_eq!(back, 10, "{} perturbed by {share} edge", material.name());
            }
            // The tolerance is 1e-8 of the force, before a final correction that squares the error.
            assert!(worst < 1e-10, "{}: same branch, but a difference of {worst:e} m", material.name());
        }
    }
}

/// A slender column under end compression buckles towards the irregularity of its lattice. Large
/// perturbations find other equilibria.
#[test]
fn a_pressed_column_has_more_than_one_equilibrium() {
    let material: Material = st_venant_kirchhoff();
    let mesh = box_mesh([12, 1, 1], 0.01);
    let model = Model::uniform(material, &nodes_where(&mesh, |x| x[0] == 0.0));
    let body = body(&mesh, &model);
    let end = nodes_where(&mesh, |x| (x[0] - 0.12).abs() < 1e-9);
    let handle = Handle::patch(nearest_node(&mesh, [0.12, 0.0, 0.0]), &end);
    let problem = problem(&body, handle);
    let mut solver = Solver::new(problem.clone());
    let mut straight = solver.rest().expect("the column is fixed");
    let mut first_unstable = None;
    for mm in 1..=12 {
        let pressed = solver.advance(&straight.seed, [-1e-3 * f64::from(mm), 0.0, 0.0]);
        straight = pressed.expect("the column converges under displacement control");
        if straight.unstable_modes != Some(0) {
            first_unstable.get_or_insert(mm);
        }
    }
    let cost = Cost::of(problem.unknowns(), &straight);
    let verdict = format!("first unstable at {first_unstable:?} mm");
    row(Case::Branches, "column of 120 x 10 x 10 mm pressed 12 mm", cost, &state(&straight), &verdict);
    let mut ends: Vec<Configuration> = Vec::new();
    for seed in 0..20 {
        let Ok(c) = again(&problem, &straight, 0.3 * body.edge_m, seed) else { continue };
        if ends.iter().all(|e| distance_m(&problem, e, &c) > 1e-6) {
            ends.push(c);
        }
    }
    ends.sort_by(|a, b| a.jet().energy_j.total_cmp(&b.jet().energy_j));
    for end in &ends {
        let apart = 1e3 * distance_m(&problem, end, &straight);
        let tried = format!("column, an equilibrium of 20 starts perturbed by 0.3 edge: {apart:.2} mm away");
        let verdict = format!("{:.6} mJ", 1e3 * end.jet().energy_j);
        row(Case::Branches, &tried, Cost::of(problem.unknowns(), end), &state(end), &verdict);
    }
    // The equilibrium of least energy is stable, and loading finds it.
    let lowest = ends.first().expect("at least one start converges");
    assert_eq!(lowest.unstable_modes, Some(0));
    assert!(distance_m(&problem, lowest, &straight) < 1e-9, "loading missed the equilibrium of least energy");
    assert!(ends.len() > 1, "large perturbations find other equilibria");
}

/// Larger residual of the interpolation of energy (per length) and force between two configurations, N.
fn excess_n(a: &Configuration, b: &Configuration) -> f64 {
    let (a, b) = (a.jet(), b.jet());
    let d = Vector3::from(b.control_m) - Vector3::from(a.control_m);
    let (ha, hb) = (Vector3::from(a.force_n), Vector3::from(b.force_n));
    let bend = d.dot(&((b.stiffness_n_m - a.stiffness_n_m) * d)) / 12.0;
    let energy_j = b.energy_j - a.energy_j - 0.5 * (ha + hb).dot(&d) + bend;
    let force_n = hb - ha - (a.stiffness_n_m + b.stiffness_n_m) * d * 0.5;
    (energy_j.abs() / d.norm()).max(force_n.norm())
}

/// The path meets the end of a branch: there W is not the integral of h. The path continues on another branch
/// and flags only this step.
#[test]
fn a_branch_jump_is_flagged_at_its_step() {
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/liver-small.toml");
    let mut scene = Scene::load(scene.as_ref()).and_then(|s| s.resolve()).expect("the bundled organ");
    for region in &mut scene.materials {
        region.material =
            Material::StVenantKirchhoff(StVenantKirchhoff { lame: Lame::from_young_poisson(9000.0, 0.45) });
    }
    let body = Arc::new(scene.body().expect("the rest state converges"));
    let mut solver = Solver::new(Arc::new(Problem::new(body, scene.active[0].node)));
    let mut here = solver.rest().expect("held");
    let (mut flagged, mut cost, mut smooth) = (Vec::new(), Cost::default(), 0.0f64);
    for step in 1..=50 {
        let next = solver.advance(&here.seed, [-1e-3 * f64::from(step), 0.0, 0.0]).expect("finishes");
        let excess_n = excess_n(&here, &next);
        if next.switched {
            flagged.push(step);
            assert!(excess_n > 0.3, "{excess_n}");
        } else {
            smooth = smooth.max(excess_n);
        }
        cost.iterations += next.iterations;
        cost.factorisations += next.factorisations;
        cost.increments += next.increments;
        here = next;
    }
    cost.equations = solver.problem().unknowns();
    let result = format!("branch jump at {flagged:?} mm, other steps continuous within {smooth:.2} N");
    row(Case::Branches, "StVK 9 kPa 0.45, organ A1 50 mm along -x", cost, &result, "flagged");
    assert_eq!(flagged, [46]);
    assert!(smooth < 0.1);
}
