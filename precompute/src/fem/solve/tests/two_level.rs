//! Solves without a factor of the present tangent, compared with those that make one.

use std::sync::Arc;

use crate::fem::body::{Body, Model};
use crate::fem::boundary::{Constraints, Contact, Handle};
use crate::fem::element::Order;
use crate::fem::material::{Lame, Material, NeoHookean, mooney_rivlin};
use crate::fem::pad::{Fingertip, Pad, PadProfile};
use crate::fem::solve::factor::Factor;
use crate::fem::solve::{Configuration, FollowOptions, Problem, Solver};
use crate::mesh::testing::{box_mesh, nodes_where};

fn neo_hookean() -> Material {
    Material::NeoHookean(NeoHookean { lame: Lame::from_young_poisson(15480.0, 0.45) })
}

/// So far away that the first steps lead through unstable states.
const FAR_M: [f64; 3] = [-0.06, 0.0, 0.0];
const WAY_M: [[f64; 3]; 3] = [[0.001, 0.0, -0.004], [0.003, 0.001, -0.01], [-0.008, 0.002, -0.012]];

/// A beam of 160 x 40 x 40 mm, held at its left end and touched on top near its right end, which turns.
fn problem(law: Material, order: Order, is_pad: bool, is_large: bool) -> Arc<Problem> {
    let mesh = box_mesh([8, 2, 2], 0.02);
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let top =
        nodes_where(&mesh, |x| (x[0] - 0.12).abs() < 0.01 && (x[1] - 0.02).abs() < 0.01 && x[2] == 0.04)[0];
    let body = Arc::new(Body::new(&mesh, &Model { order, ..Model::uniform(law, &fixed) }).expect("a body"));
    let mut free = Problem::with(body.clone(), None, Constraints::Elimination);
    free.newton.large_flops = if is_large { 0.0 } else { f64::INFINITY };
    let tip = Fingertip { radius_m: 0.015, stiffness_pa_m: 2e6, profile: PadProfile::Quartic };
    let contact: Contact = match Pad::new(&body, tip, body.nodes_m[top as usize]) {
        Some(pad) if is_pad => pad.into(),
        _ => Handle::node(top).into(),
    };
    Arc::new(free.at(contact))
}

fn path(problem: &Arc<Problem>) -> Vec<Configuration> {
    let mut solver = Solver::new(problem.clone());
    let mut way = vec![solver.rest().expect("the beam is fixed")];
    for target_m in WAY_M {
        let next = solver.advance(&way[way.len() - 1].seed, target_m).expect("the beam converges");
        way.push(next);
    }
    way
}

#[test]
fn without_a_factor_of_the_tangent_the_jets_are_the_same() {
    let pairs = [
        (neo_hookean(), Order::Linear),
        (mooney_rivlin(), Order::Linear),
        (mooney_rivlin(), Order::Quadratic),
    ];
    for (law, order) in pairs {
        for is_pad in [false, true] {
            let [exact, stepped] =
                [false, true].map(|is_large| path(&problem(law.clone(), order, is_pad, is_large)));
            for (exact, stepped) in exact.iter().zip(&stepped) {
                let (a, b) = (exact.jet(), stepped.jet());
                let name = format!("{} {order:?} pad {is_pad} at {:?}", law.name(), a.control_m);
                assert_eq!(stepped.unstable_modes, None, "{name}: no factor was made");
                let force: Vec<f64> = (0..3).map(|i| (a.force_n[i] - b.force_n[i]).abs()).collect();
                assert!(force.iter().all(|e| *e < 1e-7), "{name}: h differs by {force:?} N");
                assert!((a.energy_j - b.energy_j).abs() < 1e-10, "{name}: W");
                let stiffness = (a.stiffness_n_m - b.stiffness_n_m).norm() / a.stiffness_n_m.norm();
                assert!(stiffness < 1e-7, "{name}: S differs by {stiffness:e}");
                let size = a.third_n_m2.iter().fold(0.0f64, |m, x| m.max(x.abs()));
                let third = a.third_n_m2.iter().zip(&b.third_n_m2).map(|(a, b)| (a - b).abs() / size);
                let third = third.fold(0.0, f64::max);
                assert!(third < 1e-5, "{name}: W_ijk differs by {third:e}");
            }
        }
    }
}

/// Where the stability is wanted, the factor that gives it also gives the sensitivities, and only there.
#[test]
fn a_configuration_whose_stability_is_wanted_has_one_factor() {
    for (law, order) in [(neo_hookean(), Order::Linear), (mooney_rivlin(), Order::Quadratic)] {
        let exact = path(&problem(law.clone(), order, true, false));
        let mut solver = Solver::new(problem(law.clone(), order, true, true));
        for (from, exact) in exact.iter().zip(&exact[1..]) {
            let at = exact.jet().control_m;
            solver.determine_stability_at(Some(at));
            let found = solver.advance(&from.seed, at).expect("the beam converges");
            assert_eq!(found.unstable_modes, Some(0), "{} at {at:?}", law.name());
            assert!(!solver.factor.steps_without(), "the sensitivities are those of the factor");
            let stiffness = (exact.jet().stiffness_n_m - found.jet().stiffness_n_m).norm();
            assert!(stiffness < 1e-9 * exact.jet().stiffness_n_m.norm(), "S differs by {stiffness:e} N/m");
            solver.determine_stability_at(Some(at.map(|x| 0.5 * x)));
            let found = solver.advance(&from.seed, at).expect("the beam converges");
            assert!(found.unstable_modes.is_none() && solver.factor.steps_without(), "not asked for there");
        }
    }
}

/// The part near the tool is that of the solution: between the guess and it the body may have become unstable.
#[test]
fn the_near_field_of_the_sensitivities_is_that_of_the_solution() {
    let problem = problem(mooney_rivlin(), Order::Quadratic, true, true);
    let way = path(&problem);
    let mut solver = Solver::new(problem);
    solver.advance(&way[0].seed, way[1].jet().control_m).expect("the beam converges");
    let tangent = solver.assembled.tangent.clone();
    assert!(solver.factor.two_level().is_near(&tangent), "another tangent");
}

/// With a limit of one residual step the sensitivities get a factor, with none every Newton step too.
#[test]
fn where_the_residual_steps_stagnate_a_factor_takes_over() {
    for (law, order) in [(neo_hookean(), Order::Linear), (mooney_rivlin(), Order::Quadratic)] {
        let exact = path(&problem(law.clone(), order, true, false));
        for most in [0, 1] {
            let mut solver = Solver::new(problem(law.clone(), order, true, true));
            solver.factor.max_steps_without = most;
            for (from, exact) in exact.iter().zip(&exact[1..]) {
                let (a, at) = (exact.jet(), exact.jet().control_m);
                let name = format!("{}, at most {most} steps, at {at:?}", law.name());
                let found = solver.advance(&from.seed, at).expect("a factor solves it");
                assert_eq!(found.unstable_modes, Some(0), "{name}: the last factor is one of the tangent");
                let b = found.jet();
                let force = (0..3).map(|i| (a.force_n[i] - b.force_n[i]).abs()).fold(0.0, f64::max);
                assert!(force < 1e-9, "{name}: h differs by {force:e} N");
                let stiffness = (a.stiffness_n_m - b.stiffness_n_m).norm() / a.stiffness_n_m.norm();
                assert!(stiffness < 1e-9, "{name}: S differs by {stiffness:e}");
            }
        }
    }
}

/// Steps from the sensitivities of a state to those of another one.
fn steps(problem: &Arc<Problem>) -> u32 {
    let way = path(problem);
    let [.., from, to] = &way[..] else { panic!("a path") };
    let mut solver = Solver::new(problem.clone());
    solver.state.copy_from_slice(&to.seed.state);
    solver.prescribe(&to.seed.pose);
    solver.evaluate(true);
    solver.translation_columns();
    solver.factor = Factor::new(&problem.symbolic, &problem.pattern);
    let made = solver.factor.factorise_first(problem.tangent(&solver.assembled.tangent, &solver.state));
    assert!(made, "a stable beam");
    solver.begin_columns(&from.seed);
    let matrix = problem.tangent(&solver.assembled.tangent, &solver.state);
    let (left, steps) = solver.factor.refine(matrix, &solver.right, &mut solver.columns, (1e-7, 30));
    assert!(left <= 1e-7, "{left:e} left");
    steps
}

/// Both the turns and the factor near the tool save steps where the beam has bent.
#[test]
fn a_far_field_that_turns_and_a_near_field_that_is_fresh_save_steps() {
    let [whole, unturned, far_only] =
        [(0.05, true), (0.05, false), (0.0, true)].map(|(near_share, turns)| {
            let mut problem = problem(mooney_rivlin(), Order::Quadratic, true, true);
            let newton = &mut Arc::get_mut(&mut problem).expect("nobody else has it").newton;
            (newton.near_share, newton.turns) = (near_share, turns);
            steps(&problem)
        });
    assert!(whole <= 8, "{whole} steps");
    assert!(unturned > whole, "{unturned} steps without turns, {whole} with");
    assert!(far_only > whole, "{far_only} steps without the near field, {whole} with");
}

/// A regularisation of the pressures that P2/P1 bears costs P1/P1 twice as many steps.
#[test]
fn the_far_field_serves_pressures_of_linear_elements_too() {
    let of_linear = steps(&problem(mooney_rivlin(), Order::Linear, true, true));
    assert!(of_linear <= 8, "{of_linear} steps");
}

#[test]
fn a_continuation_without_factors_finds_the_same_force() {
    let problem = problem(mooney_rivlin(), Order::Quadratic, true, true);
    let way = path(&problem);
    let mut solver = Solver::new(problem);
    let mut to = way[0].seed.clone();
    let options = FollowOptions::default();
    for (from, exact) in way.iter().zip(&way[1..]) {
        let found =
            solver.follow(&from.seed, exact.jet().control_m, true, &options, &mut to).expect("it converges");
        assert_eq!(found.unstable_modes, None);
        let error: f64 =
            (0..3).map(|i| (to.jet.force_n[i] - exact.jet().force_n[i]).abs()).fold(0.0, f64::max);
        assert!(error < 1e-4, "{error:e} N at {:?}", exact.jet().control_m);
    }
}

/// Where the residual steps fail only factors lead on: a continuation that is to be given up makes none.
#[test]
fn a_continuation_is_given_up_before_it_makes_factors() {
    let problem = problem(mooney_rivlin(), Order::Quadratic, true, true);
    let rest = &path(&problem)[0].seed;
    let mut to = rest.clone();
    for gives_up in [true, false] {
        let mut solver = Solver::new(problem.clone());
        let options = FollowOptions { gives_up, ..FollowOptions::default() };
        let found = solver.follow(rest, FAR_M, true, &options, &mut to);
        assert_eq!(found.is_err(), gives_up, "{found:?}");
        assert!(!gives_up || solver.factor.steps_without(), "a factor was made");
        assert!(solver.advance(rest, FAR_M).is_ok(), "other solves make factors");
    }
}
