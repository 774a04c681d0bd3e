//! Two spheres on one organ: the coupling of their forces, and what each hand feels live.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate_precompute::fem::{CoatedSphere, Constraints, Layer, Pose, Problem, Solver};
use palpate_precompute::scene::ResolvedScene;

use super::live_sphere::{compare, feel, reaction_n, scene, way};

/// A place of the skin with its outward normal: the free node nearest to a point.
fn nearest_on_skin(scene: &ResolvedScene, at_m: Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let surface = palpate_precompute::mesh::Surface::of(&scene.mesh);
    let away_m = |node: &u32| (Vector3::from(scene.mesh.nodes_m[*node as usize]) - at_m).norm();
    let nodes = 0..scene.mesh.nodes_m.len() as u32;
    let of_skin = nodes.filter_map(|node| Some((node, Vector3::from(surface.normal(node)?))));
    let nearest = of_skin.min_by(|(a, _), (b, _)| away_m(a).total_cmp(&away_m(b)));
    let (node, normal) = nearest.expect("it has a skin");
    (Vector3::from(scene.mesh.nodes_m[node as usize]), normal)
}

/// The ways of two spheres that press within 30 mm, one after the other, and slide towards each other, at a multiple of 100 mm/s.
fn ways(scene: &ResolvedScene, speed: f64) -> [Vec<Vector3<f64>>; 2] {
    let ticks = |of: usize| (of as f64 / speed).round() as usize;
    let (place_m, normal) = nearest_on_skin(scene, way(scene)[300]);
    let along = normal.cross(&Vector3::z()).normalize();
    let (second_m, second_normal) = nearest_on_skin(scene, place_m + 0.022 * along);
    let apart_m = (second_m - place_m).norm();
    assert!((0.015..0.03).contains(&apart_m), "{apart_m} m");
    let still = |at: Vector3<f64>, of: usize| std::iter::repeat_n(at, ticks(of));
    let line = |from: Vector3<f64>, to: Vector3<f64>, of: usize| {
        let ticks = ticks(of);
        (0..ticks).map(move |n| from + n as f64 / ticks as f64 * (to - from))
    };
    // Beside the body and pressed in by 8 mm.
    let out = |at_m: Vector3<f64>, normal: Vector3<f64>| [at_m + 0.03 * normal, at_m + 0.002 * normal];
    let towards = (second_m - place_m).normalize();
    let [from, to] = out(place_m, normal);
    let slid = to + 0.006 * towards;
    let one = (line(from, to, 280).chain(still(to, 300)).chain(line(to, slid, 60)))
        .chain(line(slid, slid + 0.028 * normal, 280))
        .collect::<Vec<_>>();
    let [from, to] = out(second_m, second_normal);
    let slid = to - 0.004 * towards;
    let other =
        (still(from, 200).chain(line(from, to, 280)).chain(line(to, slid, 40)).chain(still(slid, 60)))
            .chain(line(slid, slid + 0.028 * second_normal, 280))
            .chain(still(slid + 0.028 * second_normal, 60))
            .collect::<Vec<_>>();
    assert_eq!(one.len(), other.len());
    [one, other]
}

/// The ways of a hand that waits beside the skin, comes at 50 mm/s, presses 8 mm deep and leaves, and of the partner: it presses
/// `deep_m` beside it while the hand waits, and holds.
fn beside_a_held_partner(scene: &ResolvedScene, deep_m: f64) -> [Vec<Vector3<f64>>; 2] {
    // Where the ways go down, 30 mm straight to 8 mm below the skin.
    let [one, other] = ways(scene, 1.0);
    let at = |[out_m, deep_m]: [Vector3<f64>; 2], above_m: f64| {
        deep_m + (above_m + 8e-3) * (out_m - deep_m).normalize()
    };
    let [hand, partner] = [[one[0], one[280]], [other[200], other[480]]];
    let line = |from: Vector3<f64>, to: Vector3<f64>, ticks: usize| {
        (0..ticks).map(move |n| from + n as f64 / ticks as f64 * (to - from))
    };
    let still = |at: Vector3<f64>, ticks: usize| std::iter::repeat_n(at, ticks);
    let [above_m, below_m, held_m] = [at(hand, 12e-3), at(hand, -8e-3), at(partner, -deep_m)];
    let hand = still(above_m, 500)
        .chain(line(above_m, below_m, 400))
        .chain(still(below_m, 100))
        .chain(line(below_m, above_m, 400));
    let partner = line(at(partner, 4e-3), held_m, 120).chain(still(held_m, 1_280));
    [hand.collect(), partner.collect()]
}

/// The first touch beside a partner that holds is felt at once. Newton's method does not find it from the body at rest: that
/// under the partner alone is solved first.
#[test]
fn a_hand_comes_to_a_body_that_a_partner_holds_pressed() {
    let scene = scene();
    for (deep_m, least) in [(8e-3, 50), (12e-3, 25)] {
        let ways = beside_a_held_partner(&scene, deep_m);
        let felt = feel(&scene, 0.0, &ways);
        let (count, good, _) = compare(&felt[0], Some((&felt[1], &ways[1])));
        assert!(count >= least && f64::from(good) >= 0.95 * f64::from(count), "{good} of {count}");
    }
}

/// Each sphere feels the body that the other one deforms, where both press.
#[test]
fn two_spheres_feel_each_other_through_the_body() {
    let scene = scene();
    for (speed, least) in [(0.3, 0.98), (0.5, 0.95), (1.0, 0.9)] {
        let ways = ways(&scene, speed);
        let felt = feel(&scene, 0.0, &ways);
        let alone = feel(&scene, 0.0, &ways[..1]);
        let pairs = felt[0].1.iter().zip(&alone[0].1);
        let change_n = pairs.map(|((_, with), (_, without))| (reaction_n(with) - reaction_n(without)).norm());
        let change_n = change_n.fold(0.0, f64::max);
        println!("{} mm/s: the partner changes the force by up to {change_n:.3} N", 100.0 * speed);
        assert!(change_n > 0.3, "{change_n} N");
        let (mut count, mut good) = (0, 0);
        for of in 0..2 {
            let found = compare(&felt[of], Some((&felt[1 - of], &ways[1 - of])));
            (count, good) = (count + found.0, good + found.1);
        }
        assert!(count > 60 && f64::from(good) >= least * f64::from(count), "{good} of {count}");
    }
}

/// By central differences: dh/dp of a partner at p, its force dW/dp, and that both tools see the same dh/dp.
#[test]
fn the_coupling_of_two_spheres_is_the_difference_of_their_forces() {
    let scene = scene();
    let body = scene.body().expect("it can be solved");
    let [one, other] = ways(&scene, 1.0).map(|way| way[560]);
    let sphere = CoatedSphere::new(&body, 0.01, Layer::of(0.01), [0.0; 3]);
    let free = Problem::with(body.into(), None, Constraints::Elimination);
    let mut solver = Solver::new(Arc::new(free.at(sphere)));
    // The partner comes first, in steps of a millimetre.
    let outwards = |at: Vector3<f64>, from: Vector3<f64>, share: f64| at + share * (from - at);
    let [first, second] = ways(&scene, 1.0).map(|way| way[0]);
    let mut solved = |c: Vector3<f64>, p: Vector3<f64>| {
        let mut state = solver.problem().body.rest_state.clone();
        let mut found = None;
        for n in (0..=40).rev() {
            let share = f64::from(n) / 40.0;
            solver.set_partner(Some(outwards(p, second, share).into()));
            let pose = Pose::translation(outwards(c, first, share).into());
            let next = solver.solve_at(&pose, &state).expect("it converges");
            state.clone_from(&next.seed.state);
            found = Some(next);
        }
        let found = found.expect("there are steps");
        (*found.jet(), found.seed.coupling.expect("it has a partner"))
    };
    let (jet, coupling) = solved(one, other);
    assert!(Vector3::from(coupling.force_n).norm() > 0.3 && coupling.mixed_n_m.norm() > 10.0, "{coupling:?}");
    let step_m = 1e-5;
    for axis in 0..3 {
        let beside = |by_m: f64| other + by_m * Vector3::ith(axis, 1.0);
        let [(before, _), (after, _)] = [-step_m, step_m].map(|by_m| solved(one, beside(by_m)));
        let of_force = (Vector3::from(after.force_n) - Vector3::from(before.force_n)) / (2.0 * step_m);
        let of_energy = (after.energy_j - before.energy_j) / (2.0 * step_m);
        let column = coupling.mixed_n_m.column(axis);
        assert!((of_force - column).norm() < 1e-4 * coupling.mixed_n_m.norm(), "{of_force} {column}");
        assert!((of_energy - coupling.force_n[axis]).abs() < 1e-5, "{of_energy} {:?}", coupling.force_n);
    }
    // From the side of the partner it is the transpose.
    let (of_partner, back) = solved(other, one);
    assert!((back.mixed_n_m - coupling.mixed_n_m.transpose()).norm() < 1e-6 * coupling.mixed_n_m.norm());
    let forces = [(of_partner.force_n, coupling.force_n), (jet.force_n, back.force_n)];
    assert!(forces.iter().all(|(a, b)| (Vector3::from(*a) - Vector3::from(*b)).norm() < 1e-8), "{forces:?}");
}
