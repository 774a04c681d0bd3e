//! A body of 47,197 equations, pressed by a fingertip: a configuration 10 mm from its neighbour needs no factor of the
//! present tangent, and is that of a solver that makes one in every step.

use std::sync::Arc;

use palpate_precompute::fem::{Constraints, Fingertip, Model, Order, Pad, PadProfile, Problem, Solver};
use palpate_tests::{box_mesh, mooney_rivlin, nodes_where};

use super::walk::{body, norm, relative_error};

const NEAR_M: [f64; 3] = [0.0, 0.0, -0.002];
const FAR_M: [f64; 3] = [0.0, 0.0, -0.012];

#[test]
fn a_large_body_needs_no_factor_10_mm_from_its_neighbour() {
    let mesh = box_mesh([12; 3], 0.1 / 12.0);
    let foot = nodes_where(&mesh, |x| x[2] == 0.0);
    let model = Model { order: Order::Quadratic, ..Model::uniform(mooney_rivlin(), &foot) };
    let body = body(&mesh, &model);
    let tip = Fingertip { radius_m: 0.015, stiffness_pa_m: 2e6, profile: PadProfile::Quartic };
    let pad = Pad::new(&body, tip, [0.05, 0.05, 0.1]).expect("the top is free");
    let free = Problem::with(body.clone(), None, Constraints::Elimination);
    assert!(free.unknowns() > 45_000, "{} equations", free.unknowns());

    let mut solver = Solver::new(Arc::new(free.at(pad.clone())));
    let rest = solver.rest().expect("the cube is fixed").seed;
    let near = solver.advance(&rest, NEAR_M).expect("2 mm converge").seed;
    let stepped = solver.advance(&near, FAR_M).expect("12 mm converge");
    assert_eq!(stepped.unstable_modes, None, "a factor was made");
    assert!(stepped.increments == 1 && stepped.iterations <= 12, "{} steps", stepped.iterations);
    drop(solver);

    let mut exact = free.at(pad);
    exact.newton.large_flops = f64::INFINITY;
    let exact = Solver::new(Arc::new(exact)).advance(&near, FAR_M).expect("12 mm converge");
    assert_eq!(exact.unstable_modes, Some(0));
    let (a, b) = (exact.seed.jet, stepped.seed.jet);
    let force = relative_error(a.force_n, b.force_n);
    let stiffness = (a.stiffness_n_m - b.stiffness_n_m).norm() / a.stiffness_n_m.norm();
    println!(
        "{:.3} N, differs by {force:.1e}, S by {stiffness:.1e}; {} steps",
        norm(a.force_n),
        stepped.iterations
    );
    assert!(force < 1e-7 && stiffness < 1e-6, "force differs by {force:.1e}, S by {stiffness:.1e}");
}
