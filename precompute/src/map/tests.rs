//! Maps of the scene `lump` with linear elements, against single solves.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::*;
use crate::scene::{ElementOrder, Scene};
use crate::spec::{ActiveNode, Tool};

fn lump() -> ResolvedScene {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/scenes/lump.toml");
    let scene = Scene::load(path.as_ref()).and_then(|scene| scene.resolve()).expect("a bundled scene");
    ResolvedScene { order: ElementOrder::Linear, ..scene }
}

/// The places above the lump and beside it.
fn two(scene: &ResolvedScene) -> [Place; 2] {
    [0, 1].map(|n| Place::named(scene, &scene.active[n]).expect("on the skin"))
}

const GOAL: Goal = Goal { force_n: 1.0, max_depth_m: 0.012 };

fn groups() -> [String; 1] {
    ["lump".into()]
}

fn push(inclusion: &Inclusion, place: &Place, goal: &Goal) -> Found {
    let mapped = Mapped::new(&inclusion.with, Some(&inclusion.without)).expect("solvable");
    mapped.push(place, goal).expect("solvable at rest")
}

#[test]
fn stiffness_and_depth_are_those_of_a_solver() {
    let scene = lump();
    for tool in [scene.tool, Tool::Point] {
        let scene = ResolvedScene { tool, ..scene.clone() };
        let places = Places::over(&scene, Some(3));
        assert_eq!(places.places.len(), 3);
        let body = Arc::new(scene.body().expect("solvable"));
        let mapped = Mapped::new(&scene, None).expect("solvable");
        for place in &places.places {
            let goal = Goal { force_n: 0.3, max_depth_m: 0.02 };
            let found = mapped.push(place, &goal).expect("solvable at rest");
            let mut solver = Solver::new(scene.problems(&body).of(&place.active));
            let rest = solver.rest().expect("solvable");
            let m = nalgebra::Vector3::from(place.inward);
            let stiffness_n_m = m.dot(&(rest.jet().stiffness_n_m * m));
            assert!((found.press.stiffness_n_m() / stiffness_n_m - 1.0).abs() < 1e-12, "{tool:?}");
            let depth_m = found.depth_m.expect("it is soft enough");
            let there = solver.advance(&rest.seed, place.inward.map(|x| x * depth_m)).expect("solvable");
            let force_n = m.dot(&nalgebra::Vector3::from(there.jet().force_n));
            assert!((force_n / goal.force_n - 1.0).abs() < 1e-3, "{tool:?}: {force_n} N at {depth_m} m");
            assert!((found.press.force_n(depth_m) / goal.force_n - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn an_inclusion_of_the_same_constants_is_not_felt() {
    let mut scene = lump();
    scene.materials[1].material = scene.materials[0].material.clone();
    let inclusion = Inclusion::of_groups(&scene, &groups()).expect("a group with a material");
    for place in two(&scene) {
        let compared = push(&inclusion, &place, &GOAL).compared.expect("solvable");
        assert!(compared.detectability(&JND) < 1e-12, "{compared:?}");
    }
    let ball = Ball { centre_m: [-0.02, 0.0, 0.03], radius_m: 5e-3, ratio: 1.0 };
    let inclusion = Inclusion::ball(&scene, ball).expect("inside");
    let compared = push(&inclusion, &two(&scene)[1], &GOAL).compared.expect("solvable");
    assert!(compared.detectability(&JND) < 1e-12, "{compared:?}");
}

#[test]
fn a_stiff_lump_is_felt_above_it_and_not_beside() {
    let scene = lump();
    let inclusion = Inclusion::of_groups(&scene, &groups()).expect("a group with a material");
    assert_eq!(inclusion.without.materials[1].material, scene.materials[0].material);
    assert_eq!((&inclusion.with, inclusion.tets.len()), (&scene, scene.mesh.tet_groups["lump"].len()));
    let ball_m3 = 4.0 / 3.0 * std::f64::consts::PI * 0.008_f64.powi(3);
    assert!((inclusion.volume_m3 / ball_m3 - 1.0).abs() < 1e-4);
    let [above, beside] = two(&scene);
    let above = push(&inclusion, &above, &GOAL).compared.expect("solvable");
    assert!(above.detectability(&JND) > 1.5 && above.force_n > 1.1 * above.without_n, "{above:?}");
    let beside = push(&inclusion, &beside, &GOAL).compared.expect("solvable");
    assert!(beside.detectability(&JND) < 0.2, "{beside:?}");
    // A small force: the threshold decides, not the share.
    let small = Compared { force_n: 0.05, without_n: 0.04, ..above };
    assert!((small.detectability(&JND) - 0.5).abs() < 1e-12);
    assert!(
        (Compared { force_n: 0.9, without_n: 1.0, ..above }.detectability(&JND) - 0.1 / 0.07).abs() < 1e-12
    );
}

#[test]
fn a_push_that_stays_below_the_force_ends_at_the_cap() {
    let scene = lump();
    let inclusion = Inclusion::of_groups(&scene, &groups()).expect("a group with a material");
    let found = push(&inclusion, &two(&scene)[0], &Goal { force_n: 5.0, max_depth_m: 2e-3 });
    assert_eq!((found.depth_m, found.press.end_m(), found.press.failure), (None, 2e-3, None));
    let compared = found.compared.expect("solvable");
    assert!(compared.depth_m == 2e-3 && compared.force_n < 1.0 && compared.force_n > compared.without_n);
}

#[test]
fn the_figures_do_not_depend_on_the_threads_and_a_stop_ends_the_work() {
    let scene = lump();
    let places = Places::over(&scene, Some(5)).places;
    let mapped = Mapped::new(&scene, None).expect("solvable");
    let (stop, done) = (AtomicBool::new(false), AtomicUsize::new(0));
    let count = |n: usize| {
        done.fetch_max(n, Ordering::Relaxed);
    };
    let work = |threads| Work { threads, stop: &stop, done: &count };
    let alone = mapped.all(&places, &GOAL, work(1)).expect("solvable");
    assert_eq!(done.load(Ordering::Relaxed), 5);
    assert_eq!(mapped.all(&places, &GOAL, work(3)).expect("solvable"), alone);
    stop.store(true, Ordering::Relaxed);
    assert!(matches!(mapped.all(&places, &GOAL, work(2)), Err(MapError::Interrupted)));
}

#[test]
fn a_deeper_a_smaller_and_a_softer_ball_is_felt_less() {
    let mut scene = lump();
    scene.materials[1].material = scene.materials[0].material.clone();
    let place = &two(&scene)[1];
    let sweep =
        Sweep { covers_m: vec![4e-3, 10e-3, 0.5], radii_m: vec![5e-3, 8e-3], ratios: vec![0.2, 2.0, 8.0] };
    let (stop, done) = (AtomicBool::new(false), |_: usize| {});
    let work = Work { threads: 2, stop: &stop, done: &done };
    let rows = sweep.run(&scene, place, &Goal { force_n: 0.5, ..GOAL }, work).expect("solvable");
    assert_eq!(rows.len(), 18);
    let at = |cover: usize, radius: usize, ratio: usize| rows[6 * cover + 3 * radius + ratio].found;
    let value = |cover, radius, ratio| {
        let compared = at(cover, radius, ratio).and_then(|found| found.compared).expect("solvable");
        assert_eq!(compared.force_n > compared.without_n, sweep.ratios[ratio] > 1.0, "a soft ball gives way");
        compared.detectability(&JND)
    };
    for ratio in 0..3 {
        for radius in 0..2 {
            assert!(value(0, radius, ratio) > value(1, radius, ratio), "deeper");
        }
        for cover in 0..2 {
            assert!(value(cover, 1, ratio) > value(cover, 0, ratio), "smaller");
        }
    }
    assert!(value(0, 1, 2) > value(0, 1, 1), "softer");
    assert!((12..18).all(|row| rows[row].found.is_none()), "half a metre below the skin is outside");
    for found in rows.iter().filter_map(|row| row.found) {
        assert!((found.volume_share - 1.0).abs() < 0.05 && found.tets > 20, "{found:?}");
    }
}

#[test]
fn what_cannot_be_an_inclusion_is_refused() {
    let scene = lump();
    let of = |scene: &ResolvedScene, group: &str| {
        Inclusion::of_groups(scene, &[group.into()]).expect_err("refused")
    };
    let none = of(&scene, "lumps");
    assert_eq!(none, InclusionError::NoGroup { group: "lumps".into(), known: "lump, tissue".into() });
    let mut whole = scene.clone();
    whole.materials.truncate(1);
    whole.materials[0].tets = None;
    assert_eq!(of(&whole, "lump"), InclusionError::NoMaterial { group: "lump".into() });
    let both = Inclusion::of_groups(&scene, &["lump".into(), "tissue".into()]).expect_err("refused");
    assert_eq!(both, InclusionError::NothingAround);
    let ball = |centre_m, radius_m| {
        Inclusion::ball(&scene, Ball { centre_m, radius_m, ratio: 5.0 }).expect_err("refused")
    };
    assert_eq!(ball([0.2, 0.0, 0.0], 5e-3), InclusionError::Outside([0.2, 0.0, 0.0]));
    assert!(matches!(ball([-0.02, 0.0, 0.04], 8e-3), InclusionError::ThroughSkin { .. }));
    assert_eq!(ball([0.019, 0.0, 0.022], 8e-3), InclusionError::TwoMaterials);
}

/// A fingertip does not hold the node that a scene of a point tool names.
#[test]
fn a_fingertip_presses_where_a_scene_names_a_node() {
    let scene = lump();
    let place = &two(&scene)[0];
    // The vertex nearest to the contact point, a tenth of a millimetre away.
    let active = ActiveNode::node("node".into(), scene.active[0].node);
    let named = Place::named(&scene, &active).expect("on the skin");
    let of = |place: &Place| {
        let mapped = Mapped::new(&scene, None).expect("solvable");
        mapped.push(place, &GOAL).expect("solvable").press.stiffness_n_m()
    };
    assert!((of(&named) / of(place) - 1.0).abs() < 0.03, "{} {}", of(&named), of(place));
}

/// The places stand for the whole free skin.
#[test]
fn the_areas_are_those_of_the_free_skin() {
    let scene = lump();
    let all = Places::over(&scene, None);
    let few = Places::over(&scene, Some(7));
    assert_eq!((few.places.len(), all.places.len()), (7, all.nodes.len()));
    assert!((few.area_m2() / all.area_m2() - 1.0).abs() < 1e-12);
    // A vertex stands for a third of each of its triangles.
    let free_m2 = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|node| nalgebra::Vector3::from(scene.mesh.nodes_m[node as usize]));
        let free = triangle.iter().filter(|node| !scene.fixed.contains(node)).count();
        0.5 * (b - a).cross(&(c - a)).norm() * free as f64 / 3.0
    };
    let expected_m2: f64 = all.skin.triangles.iter().map(free_m2).sum();
    assert!((all.area_m2() / expected_m2 - 1.0).abs() < 1e-12, "{} {expected_m2}", all.area_m2());
    let values: Vec<Option<usize>> = (0..7).map(Some).collect();
    let on_skin = few.on_skin(&values);
    for (node, value) in few.skin.nodes.iter().zip(on_skin) {
        assert_eq!(value.is_none(), scene.fixed.contains(node));
    }
    let is_outward = |place: &Place| crate::num::vector::dot(place.inward, place.position_m) < 0.0;
    assert!(all.places.iter().all(is_outward), "normals point inwards");
    assert!(all.places.iter().all(|place| place.edge_m > 2e-3 && place.edge_m < 0.02));
}
