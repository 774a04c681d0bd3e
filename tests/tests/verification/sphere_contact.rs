//! A rigid sphere against the skin: f, S and W_ijk are the derivatives of W(c), and the contact is one.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate_precompute::fem::{
    Body, CoatedSphere, Constraints, FailureReason, Layer, Model, Order, Pose, Pressed, Problem, Solver,
    SphereSolver,
};
use palpate_precompute::num::{EnergyJet, THIRD_INDICES};
use palpate_precompute::scene::Scene;
use palpate_tests::{beam, documents, livers, mooney_rivlin, nodes_where};

const RADIUS_M: f64 = 0.012;
/// Of the centre over the top of the beam, whose middle is at (0.06, 0.02, 0.04) m, and pressed in by 4 mm.
const PRESSED_M: [f64; 3] = [0.0531, 0.0227, 0.048];
const STEP_M: f64 = 1e-5;

fn pressed(body: &Arc<Body>) -> (SphereSolver, Pressed) {
    let problem = Problem::with(body.clone(), None, Constraints::Elimination);
    let mut solver = SphereSolver::new(Arc::new(problem), RADIUS_M);
    let rest = solver.rest(PRESSED_M).expect("the beam is fixed");
    assert_eq!(rest.contacts(), 0, "it begins beside the body");
    let here = solver.advance(&rest, PRESSED_M).expect("4 mm into the beam");
    (solver, here)
}

/// By central differences, for every law and both orders, while the features with a force are the same.
#[test]
fn the_derivatives_of_the_energy_of_a_sphere_are_its_differences() {
    let mesh = beam();
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    for (law, order) in
        livers().into_iter().flat_map(|law| [(law.clone(), Order::Linear), (law, Order::Quadratic)])
    {
        let name = format!("{} {order:?}", law.name());
        let model = Model { order, ..Model::uniform(law, &fixed) };
        let body = Arc::new(Body::new(&mesh, &model).expect("every element has volume"));
        let (mut solver, here) = pressed(&body);
        let jet = *here.configuration.jet();
        assert!(here.contacts() > 0 && jet.force_n[2] < -0.01, "{name}: {:?}", jet.force_n);
        assert_eq!(here.configuration.unstable_modes, Some(0), "{name}");
        let mut beside = |axis: usize, by_m: f64| -> EnergyJet {
            let mut centre_m = PRESSED_M;
            centre_m[axis] += by_m;
            let found = solver.advance(&here, centre_m).expect("it is near");
            assert_eq!(found.contacts(), here.contacts(), "{name}: another set");
            *found.configuration.jet()
        };
        let mut worst = [0.0f64; 3];
        let third = |i: usize, j: usize, k: usize| {
            let mut at = [i, j, k];
            at.sort_unstable();
            jet.third_n_m2[THIRD_INDICES.iter().position(|triple| *triple == at).expect("a triple")]
        };
        let size = jet.third_n_m2.iter().fold(0.0f64, |m, t| m.max(t.abs()));
        for axis in 0..3 {
            let near = [-2.0, -1.0, 1.0, 2.0].map(|steps| beside(axis, steps * STEP_M));
            // Of fourth order in the step.
            let slope = |of: &dyn Fn(&EnergyJet) -> f64| {
                let [a, b, c, d] = near.each_ref().map(of);
                (8.0 * (c - b) - (d - a)) / (12.0 * STEP_M)
            };
            let force_n = Vector3::from(jet.force_n);
            let energy = slope(&|jet| jet.energy_j) - force_n[axis];
            worst[0] = worst[0].max(energy.abs() / force_n.norm());
            for j in 0..3 {
                let force = slope(&|jet| jet.force_n[j]) - jet.stiffness_n_m[(j, axis)];
                worst[1] = worst[1].max(force.abs() / jet.stiffness_n_m.norm());
                for k in 0..3 {
                    let stiffness = slope(&|jet| jet.stiffness_n_m[(j, k)]) - third(axis, j, k);
                    worst[2] = worst[2].max(stiffness.abs() / size);
                }
            }
        }
        println!(
            "{name:46} {:9.1e} {:9.1e} {:9.1e}   {} contacts",
            worst[0],
            worst[1],
            worst[2],
            here.contacts()
        );
        // Fibres that begin to be stretched have no third derivative.
        let limits = [1e-6, 1e-6, if name.starts_with("holzapfel") { 1e-3 } else { 1e-6 }];
        assert!(worst.iter().zip(limits).all(|(error, limit)| *error < limit), "{name}: {worst:?}");
    }
}

/// The force presses, no node is inside the sphere, and away from the body it is exactly zero.
#[test]
fn a_sphere_pushes_and_never_overlaps() {
    let mesh = beam();
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let model = Model::uniform(livers().remove(0), &fixed);
    let body = Arc::new(Body::new(&mesh, &model).expect("every element has volume"));
    let (mut solver, mut here) = pressed(&body);
    for step in 0..20 {
        let centre_m = [PRESSED_M[0], PRESSED_M[1], PRESSED_M[2] - 2e-4 * f64::from(step)];
        here = solver.advance(&here, centre_m).expect("it presses on");
        let state = &here.configuration.seed.state;
        for (node, x) in body.nodes_m.iter().enumerate() {
            let at = Vector3::from(*x) + Vector3::from_column_slice(&state[3 * node..3 * node + 3]);
            let away_m = (at - Vector3::from(centre_m)).norm();
            assert!(away_m > RADIUS_M * (1.0 - 1e-8), "node {node} is {away_m} m from the centre");
        }
        assert!(here.configuration.jet().force_n[2] < 0.0);
    }
    let away = solver.advance(&here, [0.0531, 0.0227, 0.06]).expect("it leaves");
    assert_eq!((away.contacts(), away.configuration.jet().force_n), (0, [0.0; 3]));
    assert!(solver.is_inside([0.05, 0.02, 0.02]) && !solver.is_inside(PRESSED_M));
}

/// A wholly fixed face is a wall: the hard sphere has no equilibrium there, the layer one pushes back by itself.
#[test]
fn the_fixed_part_is_a_wall() {
    let mesh = beam();
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let model = Model::uniform(mooney_rivlin(), &fixed);
    let body = Arc::new(Body::new(&mesh, &model).expect("every element has volume"));
    let problem = Arc::new(Problem::with(body.clone(), None, Constraints::Elimination));
    let (beside_m, against_m) = ([-0.0135, 0.02, 0.02], [-0.0115, 0.02, 0.02]);
    let mut hard = SphereSolver::new(problem.clone(), RADIUS_M);
    let rest = hard.rest(beside_m).expect("the beam is fixed");
    let failure = hard.advance(&rest, against_m).expect_err("a wall");
    assert_eq!(failure.reason, FailureReason::FixedPart);
    let coated = CoatedSphere::new(&body, RADIUS_M, Layer::of(RADIUS_M), [0.0; 3]);
    let mut soft = Solver::new(Arc::new(problem.at(coated)));
    let away = soft.solve_at(&Pose::translation(beside_m), &body.rest_state).expect("the beam is fixed");
    assert_eq!(away.jet().force_n, [0.0; 3]);
    let pressed = soft.advance(&away.seed, against_m).expect("the layer gives way");
    assert!(pressed.jet().force_n[0] > 1.0, "{:?}", pressed.jet().force_n);
    assert!(pressed.seed.state.iter().all(|u| u.abs() < 1e-12), "nothing moves");
    let failure =
        soft.advance(&pressed.seed, [-0.004, 0.02, 0.02]).expect_err("the wall is inside the sphere");
    assert_eq!(failure.reason, FailureReason::Pierced);
}

/// Press o12 of the reference presses of a sphere of 5 mm: at its end a face leaves the contact and the body falls
/// into another equilibrium, whose force is that of an independent implementation.
#[test]
fn beyond_a_snap_the_body_comes_to_rest() {
    let path = documents::root().join("assets/liver-small.toml");
    let scene = Scene::load(&path).and_then(|scene| scene.resolve()).expect("a scene of the project");
    let model = Model::uniform(mooney_rivlin(), &scene.fixed);
    let body = Arc::new(Body::new(&scene.mesh, &model).expect("every element has volume"));
    let problem = Problem::with(body, None, Constraints::Elimination);
    let mut solver = SphereSolver::new(Arc::new(problem), 0.005);
    let first_m =
        Vector3::new(-0.057_071_479_821_974_66, 0.052_080_339_951_202_294, -0.063_687_031_468_945_05);
    let last_m = Vector3::new(-0.051_617_695_906_420_62, 0.043_133_123_126_956_09, -0.048_138_203_471_779_08);
    let mut here = solver.rest(first_m.into()).expect("the organ is fixed");
    for step in 1..=15 {
        assert!(!here.configuration.switched, "step {step}");
        let centre_m = first_m + f64::from(step) / 15.0 * (last_m - first_m);
        here = solver.advance(&here, centre_m.into()).expect("a step of 1.25 mm");
    }
    let reference_n = Vector3::new(0.403_311_689_942_725_9, -3.076_566_883_116_012, 4.489_812_992_194_734);
    let error_n = Vector3::from(here.configuration.jet().force_n) - reference_n;
    assert!(here.configuration.switched && error_n.norm() < 1e-6 * reference_n.norm(), "{error_n}");
    assert_eq!((here.configuration.unstable_modes, here.contacts()), (Some(0), 4));
}

/// A small sphere in the middle of a block touches no skin. It is not beside it.
#[test]
fn a_state_with_the_sphere_inside_does_not_count() {
    let mesh = beam();
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let body = Arc::new(Body::new(&mesh, &Model::uniform(mooney_rivlin(), &fixed)).expect("it has volume"));
    let free = Problem::with(body.clone(), None, Constraints::Elimination);
    let radius_m = 0.004;
    let coated = CoatedSphere::new(&body, radius_m, Layer::of(radius_m), [0.0; 3]);
    let mut solver = Solver::new(Arc::new(free.at(coated)));
    let (middle_m, beside_m) = ([0.06, 0.02, 0.02], [0.06, 0.02, 0.05]);
    let inside = solver.solve_at(&Pose::translation(middle_m), &body.rest_state).expect_err("inside");
    assert_eq!(inside.reason, FailureReason::Pierced);
    solver.solve_at(&Pose::translation(beside_m), &body.rest_state).expect("beside");
}
