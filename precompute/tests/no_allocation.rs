//! The solver beside the loop does not allocate once its solvers and the contact's equations exist.

use std::path::Path;
use std::sync::Arc;

use assert_no_alloc::assert_no_alloc;
use palpate_precompute::fem::{Constraints, DESCENT_STEPS, FollowOptions, Handle, Problem, Seed, Solver};
use palpate_precompute::live::{Hand, LiveSolver, Step, Touch};
use palpate_precompute::scene::{ResolvedScene, Scene};

fn scene() -> ResolvedScene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    Scene::load(&path).expect("a bundled scene").resolve().expect("a bundled scene")
}

#[test]
fn continuation_descent_and_change_of_contact_do_not_allocate() {
    let scene = scene();
    let body = Arc::new(scene.body().expect("a body"));
    let free = Problem::with(body.clone(), None, Constraints::Elimination);
    let contacts = [scene.active[0].node, scene.active[1].node].map(Handle::node);
    let problems = contacts.map(|handle| Arc::new(free.at(handle)));
    let mut solver = Solver::new(problems[0].clone());
    let rest = Seed::at_rest(&body);
    let (mut from, mut to) = (rest.clone(), rest.clone());
    let options = FollowOptions::default();
    let mut one_round = || {
        for problem in &problems {
            solver.touch(problem.clone());
            solver.follow(&rest, [0.0; 3], true, &options, &mut from).expect("the body at rest");
            for depth_m in [0.002, 0.004] {
                let found = solver.follow(&from, [0.0, 0.0, -depth_m], false, &options, &mut to);
                found.expect("a step of 2 mm");
                std::mem::swap(&mut from, &mut to);
            }
            solver.relax(&from, [0.0, 0.001, -0.005], DESCENT_STEPS, &mut to).expect("it rests");
        }
    };
    // The first use takes the memory.
    one_round();
    assert_no_alloc(one_round);
}

#[test]
fn a_step_at_a_contact_that_was_touched_does_not_allocate() {
    let scene = scene();
    let mut solver = LiveSolver::new(&scene).expect("it can be touched");
    let node = scene.active[0].node;
    let contact = solver.skin().contacts.iter().position(|place| place.node == node).expect("on the skin");
    let normal = solver.skin().contacts[contact].normal;
    let hand = |depth_m: f64| {
        let control_m = normal.map(|n| -depth_m * n);
        let contacts = [(contact as u16, 1.0), (0, 0.0), (0, 0.0)];
        Hand { touch: Some(Touch { contacts, control_m }), ..Hand::default() }
    };
    let mut to_end = |depth_m: f64| {
        let mut solved = 0;
        while solver.step(&hand(depth_m)) != Step::Idle {
            while solver.published().is_some() {
                solved += 1;
            }
        }
        solved
    };
    to_end(0.001);
    to_end(0.004);
    let solved = assert_no_alloc(|| (1..=20).map(|mm| to_end(1e-3 * f64::from(mm))).sum::<u32>());
    assert!(solved >= 3, "{solved} jets");
}
