use std::sync::Arc;

use super::packed::{COLUMNS, delta};
use super::*;
use crate::fem::body::{Body, Model};
use crate::fem::element::Order;
use crate::fem::material::{Lame, Material, MooneyRivlin, NeoHookean, StVenantKirchhoff, mooney_rivlin};
use crate::fem::solve::{Problem, Solver};

/// A body without fixed nodes: the kernel of its tangent contains the six rigid-body modes.
fn floating(law: Material) -> (Arc<Problem>, Vec<f64>) {
    let mesh = crate::mesh::testing::cube(2, 1.0);
    let body = Arc::new(Body::new(&mesh, &Model::uniform(law, &[])).unwrap());
    let problem = Arc::new(Problem::with(body, None, crate::fem::boundary::Constraints::Elimination));
    let mut solver = Solver::new(problem.clone());
    solver.evaluate(true);
    let tangent = solver.assembled.tangent.clone();
    (problem, tangent)
}

#[test]
fn a_matrix_without_an_inverse_is_no_solution_whatever_route_is_taken() {
    let stiff =
        Material::StVenantKirchhoff(StVenantKirchhoff { lame: Lame::from_young_poisson(15480.0, 0.3) });
    let soft = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 });
    for law in [stiff, soft] {
        let (problem, tangent) = floating(law.clone());
        let n = problem.unknowns();
        let mut factor = Factor::new(&problem.symbolic, &problem.pattern);
        // A load that only a reaction can balance.
        let mut push = vec![0.0; n];
        push[problem.dofs.displacement(0)[0] as usize] = 1.0;
        let mut x = vec![0.0; n];
        for accuracy in [STEP_ACCURACY, SENSITIVITY_ACCURACY] {
            let solved = factor.factorise_and_solve(problem.matrix(&tangent), &push, &mut x, accuracy);
            let residual = solved.expect_err("no displacement balances it").residual;
            assert!(residual > 1e-3, "{}: residual {residual:.1e}", law.name());
        }
    }
}

#[test]
fn a_solve_is_as_good_as_was_asked_for() {
    let law = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 });
    let mesh = crate::mesh::testing::cube(3, 1.0);
    let fixed: Vec<u32> =
        (0..mesh.nodes_m.len() as u32).filter(|&n| mesh.nodes_m[n as usize][2] == 0.0).collect();
    let body = Arc::new(Body::new(&mesh, &Model::uniform(law, &fixed)).unwrap());
    let problem = Arc::new(Problem::new(body, 63));
    let mut solver = Solver::new(problem.clone());
    solver.evaluate(true);
    let n = problem.unknowns();
    let exact: Vec<f64> = (0..n).map(|i| ((i * 7919 + 13) % 101) as f64 / 101.0 - 0.5).collect();
    let (mut right, mut x) = (vec![0.0; n], vec![0.0; n]);
    let tangent = solver.assembled.tangent.clone();
    problem.pattern.multiply(&tangent, &exact, &mut right);
    let mut factor = Factor::new(&problem.symbolic, &problem.pattern);
    for accuracy in [STEP_ACCURACY, SENSITIVITY_ACCURACY] {
        let claimed = factor
            .factorise_and_solve(problem.matrix(&tangent), &right, &mut x, accuracy)
            .expect("the cube is held");
        let mut product = vec![0.0; n];
        problem.pattern.multiply(&tangent, &x, &mut product);
        let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|a| a * a).sum::<f64>().sqrt();
        let left =
            norm(&mut right.iter().zip(&product).map(|(b, p)| b - p)) / norm(&mut right.iter().copied());
        assert!(
            left <= accuracy.accepted && (left - claimed).abs() <= 1e-15,
            "{left:.1e}, claimed {claimed:.1e}"
        );
    }
    // LU takes over where the regularised factor is not accurate enough; it solves the same matrix.
    assert!(factor.factorise(problem.matrix(&tangent), Route::Pivoted));
    let residual = factor.solve(problem.matrix(&tangent), &right, &mut x, SENSITIVITY_ACCURACY);
    assert!(residual <= SENSITIVITY_ACCURACY.accepted, "LU: residual {residual:.1e}");
    assert_eq!(factor.unstable_modes(&problem.symbolic), None);
}

/// A block of more columns than one has room for is split, and rows that fill no panel are in most.
#[test]
fn a_packed_factor_solves_like_that_of_which_it_is_made() {
    let neo_hookean = Material::NeoHookean(NeoHookean { lame: Lame::from_young_poisson(15480.0, 0.45) });
    for (law, order, most) in [(neo_hookean, Order::Linear, 1e-3), (mooney_rivlin(), Order::Quadratic, 1e-2)]
    {
        let mesh = crate::mesh::testing::cube(6, 0.1);
        let fixed = crate::mesh::testing::nodes_where(&mesh, |x| x[2] == 0.0);
        let name = law.name();
        let body = Arc::new(Body::new(&mesh, &Model { order, ..Model::uniform(law, &fixed) }).unwrap());
        let problem = Arc::new(Problem::with(body, None, crate::fem::boundary::Constraints::Elimination));
        let (symbolic, n) = (&*problem.symbolic, problem.unknowns());
        let mut solver = Solver::new(problem.clone());
        solver.evaluate(true);
        let mut scratch = SingleScratch::new(symbolic, n);
        let mut single = SingleFactor::new(symbolic, n);
        assert!(single.make(problem.matrix(&solver.assembled.tangent), delta(order), &mut scratch));
        let right: Vec<f64> = (0..RIGHT_SIDES * n).map(|k| libm::sin(0.7 * k as f64)).collect();
        let mut exact = right.clone();
        single.solve(symbolic, &mut exact, &mut scratch);
        let packed = PackedFactor::new(symbolic, single).expect("a finite factor");
        assert!(packed.widest() == COLUMNS, "{name}: no block is split");
        let mut room = Vec::new();
        for count in [3, 1, 2] {
            let mut found = right[..count * n].to_vec();
            packed.solve(&mut found, &mut room);
            for (found, exact) in found.chunks(n).zip(exact.chunks(n)) {
                let away: Vec<f64> = found.iter().zip(exact).map(|(a, b)| a - b).collect();
                let share = magnitude(&away) / magnitude(exact);
                assert!(share < most && share > 0.0, "{name}, {count} columns: off by {share:.1e}");
            }
        }
    }
}
