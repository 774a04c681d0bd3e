use std::path::Path;

use super::*;
use crate::live::Truth;
use crate::mesh::TetMesh;
use crate::mesh::testing::nodes_where;
use crate::num::vector::distance;
use crate::scene::Scene;

const SCENE: &str = r#"
name = "block"
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
name = "last"
"#;

/// A scene of a block that is fixed where this coordinate is zero.
fn scene(mesh: TetMesh, axis: usize) -> ResolvedScene {
    let fixed = nodes_where(&mesh, |x| x[axis] == 0.0);
    let text = format!("{SCENE}node = {}", mesh.nodes_m.len() - 1);
    let scene = Scene::parse(Path::new("block.toml"), text).expect("well-formed");
    scene.resolve_in(mesh, fixed).expect("sound")
}

/// A straight column of 100 x 10 x 10 mm that is compressed at its end buckles. Steps without a factor of the tangent stay
/// on the straight branch.
#[test]
fn the_truth_of_a_large_body_leaves_an_unstable_branch() {
    let scene = scene(TetMesh::cuboid([10, 1, 1], 0.01), 0);
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

/// A slab of 100 x 100 x 50 mm that needs no factor, where one would take seconds, and the contact in the middle of its top.
fn large_slab() -> (LiveSolver, u16) {
    let mut live = LiveSolver::new(&scene(TetMesh::cuboid([8, 8, 4], 0.0125), 2)).expect("it can be touched");
    Arc::get_mut(&mut live.free).expect("nobody else has it").newton.large_flops = 0.0;
    live.times.descends(1);
    live.times.took(1.0);
    let middle = |place: &crate::pack::Place| distance(place.rest_m, [0.05, 0.05, 0.05]) < 1e-9;
    let contact = live.skin.contacts.iter().position(middle).expect("on the skin") as u16;
    (live, contact)
}

/// Over a large body a tool waits until all is prepared. It may then lean by 7 mm in a press of 22 mm at once.
#[test]
fn leaning_presses_into_a_large_body_are_prepared() {
    let (mut live, contact) = large_slab();
    let hand = Hand { hip_m: [0.05, 0.05, 0.06], ..Hand::default() };
    while live.step(&hand) != Step::Idle {
        live.took(0.1);
        assert!(live.totals().jets < 100 && live.totals().lost == 0, "{:?}", live.totals());
    }
    for [x_m, y_m] in [[0.0, 0.0], [7e-3, 0.0], [-7e-3, 0.0], [0.0, 7e-3], [0.0, -7e-3]] {
        let touch = Touch { contacts: [(contact, 1.0), (0, 0.0), (0, 0.0)], control_m: [x_m, y_m, -0.022] };
        assert!(live.knows(&touch), "{x_m} {y_m}");
    }
}

/// A hand that comes near a large body presses soon: the nearest place is known to its depth before others at rest are.
#[test]
fn the_nearest_place_of_a_large_body_is_prepared_first() {
    let (mut live, contact) = large_slab();
    let hand = Hand { hip_m: [0.052, 0.05, 0.06], ..Hand::default() };
    for depth_m in [0.0, 0.012, 0.024] {
        let touch = Touch { contacts: [(contact, 1.0), (0, 0.0), (0, 0.0)], control_m: [0.0, 0.0, -depth_m] };
        let mut steps = 0;
        while !live.knows(&touch) || live.known[usize::from(contact)].is_empty() {
            assert!(live.step(&hand) != Step::Idle && steps < 2, "{depth_m} m after {:?}", live.totals());
            live.took(0.1);
            steps += 1;
        }
    }
    assert_eq!(live.known.iter().filter(|known| !known.is_empty()).count(), 1, "only this place");
}

/// In a touch of a large body points of little weight wait until the others are known.
#[test]
fn points_of_little_weight_wait() {
    let (mut live, contact) = large_slab();
    let light = live.skin.around(contact)[0];
    let touch = Touch { contacts: [(contact, 0.95), (light, 0.05), (0, 0.0)], control_m: [0.0, 0.0, -0.01] };
    let hand = Hand { hip_m: [0.05, 0.05, 0.04], touch: Some(touch), ..Hand::default() };
    let is_known = |live: &LiveSolver, of: u16| !live.known[usize::from(of)].is_empty();
    while !is_known(&live, light) {
        assert!(live.step(&hand) != Step::Idle, "it is forgotten");
        live.took(0.1);
    }
    let heavy = Touch { contacts: [(contact, 1.0), (0, 0.0), (0, 0.0)], ..touch };
    assert!(is_known(&live, contact) && live.knows(&heavy), "the light one came first");
    // With an equal weight it is known at rest before anything is solved at the hand.
    let (mut live, contact) = large_slab();
    let touch = Touch { contacts: [(contact, 0.5), (light, 0.5), (0, 0.0)], ..touch };
    let hand = Hand { touch: Some(touch), ..hand };
    for _ in 0..2 {
        live.step(&hand);
        live.took(0.1);
    }
    assert!(is_known(&live, contact) && is_known(&live, light), "{:?}", live.totals());
}

/// Where no factor is made, a solve ahead of the hand takes as many steps as one at the hand: one that ends early is lost.
#[test]
fn a_far_press_ahead_of_the_hand_into_a_large_body_is_found() {
    let (mut live, contact) = large_slab();
    for control_m in [[0.0; 3], [0.0, 0.0, -0.02]] {
        live.solve(Task { contact, control_m, aim: Aim::Ahead });
        assert!(live.known[usize::from(contact)].has_near(control_m, REST, 1e-9), "{control_m:?}");
    }
}

/// A press to the floor of a slab of 25 mm is found nowhere. Where a factor takes a second nobody tries it again and again.
#[test]
fn a_press_that_leads_nowhere_is_not_tried_again() {
    let mut live = LiveSolver::new(&scene(TetMesh::cuboid([8, 8, 2], 0.0125), 2)).expect("it can be touched");
    live.renew_beside(|| ());
    live.times.begin(Some(1));
    live.times.took(1.0);
    let hand = Hand { hip_m: [0.05, 0.05, 0.035], ..Hand::default() };
    let mut steps = 0;
    while live.step(&hand) != Step::Idle || live.is_renewing() {
        live.took(1.0);
        steps += 1;
        assert!(steps < 200, "{:?} {:?}", live.totals(), live.lost);
    }
}

/// What a hand may come to is tried again from nearer by, unless it is one of the presses that prepare a touch: those stay
/// where they are. So far through the floor no fold hides the position.
#[test]
fn only_a_press_that_leads_nowhere_is_lost() {
    for is_slow in [false, true] {
        let mut live =
            LiveSolver::new(&scene(TetMesh::cuboid([8, 8, 2], 0.0125), 2)).expect("it can be touched");
        live.renew_beside(|| ());
        if is_slow {
            live.times.begin(Some(1));
            live.times.took(1.0);
        }
        let middle = |place: &crate::pack::Place| distance(place.rest_m, [0.05, 0.05, 0.025]) < 1e-9;
        let contact = live.skin.contacts.iter().position(middle).expect("on the skin") as u16;
        let task = |z_m| Task { contact, control_m: [0.0, 0.0, z_m], aim: Aim::Ahead };
        live.solve(task(0.0));
        live.solve(task(-0.4));
        assert!(!live.known[usize::from(contact)].has_near(task(-0.4).control_m, REST, 0.1), "it is found");
        assert_eq!(live.lost.contains(&task(-0.4)), is_slow, "{:?}", live.lost);
    }
}
