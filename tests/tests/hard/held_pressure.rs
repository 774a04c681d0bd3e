//! Incompressible bodies with boundary conditions that leave the pressure undetermined.

use palpate_precompute::fem::{Handle, Model, Order, PressureFault, Region, Solver};
use palpate_precompute::mesh::Surface;
use palpate_tests::{box_mesh, mooney_rivlin, nearest_node, nodes_where};

use super::table::{Case, Cost, row};
use super::walk::{body, problem, state};

#[test]
fn a_completely_fixed_surface_is_refused_and_does_not_converge() {
    let mesh = box_mesh([4, 4, 4], 0.01);
    let top = nearest_node(&mesh, [0.02, 0.02, 0.04]);
    let fixed: Vec<u32> = Surface::of(&mesh).nodes.into_iter().filter(|&n| n != top).collect();
    let handle = Handle::node(top);
    let model = Model::uniform(mooney_rivlin(), &fixed);
    let held = body(&mesh, &model);
    let fault = held.check_pressures(Some(&handle)).expect_err("planted fault");
    assert!(matches!(fault, PressureFault::Undetermined { .. }));
    row(
        Case::HeldPressure,
        "surface fixed, tool on it: check",
        Cost::default(),
        &fault.to_string(),
        "refused",
    );
    // The solver without the check: the displacement requires a volume change.
    let mut solver = Solver::new(problem(&held, handle.clone()));
    let pushed = solver.rest().and_then(|rest| solver.advance(&rest.seed, [0.0, 0.0, -0.002]));
    let failure = pushed.expect_err("no equilibrium exists");
    let cost = Cost { iterations: failure.iterations, ..Cost::default() };
    row(
        Case::HeldPressure,
        "surface fixed, tool on it: solver",
        cost,
        &failure.to_string(),
        &failure.reason.to_string(),
    );
    // Either fix works: the bulk modulus that the message names, or a free side.
    let mut soft = model.clone();
    soft.regions = vec![Region { material: mooney_rivlin(), bulk_modulus_pa: Some(1e6) }];
    let mut open = model.clone();
    open.fixed = nodes_where(&mesh, |x| x[2] == 0.0);
    for (name, model) in [("with bulk_pa = 1e6", soft), ("with only the bottom fixed", open)] {
        let body = body(&mesh, &model);
        assert_eq!(body.check_pressures(Some(&handle)), Ok(()), "{name}");
        let mut solver = Solver::new(problem(&body, handle.clone()));
        let rest = solver.rest().expect("held");
        let c = solver.advance(&rest.seed, [0.0, 0.0, -0.002]).expect("the fix works");
        let cost = Cost::of(solver.problem().unknowns(), &c);
        row(Case::HeldPressure, name, cost, &state(&c), "solved");
    }
}

/// Few free nodes among many: P1/P1 has a pressure at each of their neighbours.
#[test]
fn more_pressures_than_displacements_are_refused_and_the_fix_converges() {
    let mesh = box_mesh([4, 4, 4], 0.01);
    let top = nearest_node(&mesh, [0.02, 0.02, 0.04]);
    let free = |x: [f64; 3]| x[2] > 0.031 && (x[0] - 0.02).abs() < 0.011 && (x[1] - 0.02).abs() < 0.011;
    let mut model = Model::uniform(mooney_rivlin(), &nodes_where(&mesh, |x| !free(x)));
    let handle = Handle::node(top);
    let check = |model: &Model| body(&mesh, model).check_pressures(Some(&handle));
    let fault = check(&model).expect_err("planted fault");
    assert!(matches!(fault, PressureFault::Locked { .. }), "{fault}");
    row(Case::HeldPressure, "nine free nodes: check", Cost::default(), &fault.to_string(), "refused");
    let push = |model: &Model| {
        let mut solver = Solver::new(problem(&body(&mesh, model), handle.clone()));
        let pushed = solver.rest().and_then(|rest| solver.advance(&rest.seed, [0.0, 0.0, -0.001]));
        (pushed, solver.problem().unknowns())
    };
    let (locked, _) = push(&model);
    let outcome = locked.as_ref().map_or_else(|f| f.reason.to_string(), state);
    row(Case::HeldPressure, "nine free nodes: solver", Cost::default(), &outcome, "locked");
    assert!(locked.is_err(), "{outcome}");
    model.order = Order::Quadratic;
    assert_eq!(check(&model), Ok(()));
    let (solved, equations) = push(&model);
    let solved = solved.expect("the fix works");
    row(
        Case::HeldPressure,
        "nine free nodes, order = 2",
        Cost::of(equations, &solved),
        &state(&solved),
        "solved",
    );
}
