//! The field of a sphere: charts of s = sqrt(2 W) that agree where they overlap.

use crate::common::{Monomial, Recipe, polynomial};
use palpate_core::format::{Sphere, SurfaceHeader, Tool};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{
    AlignedBytes, Command, Config, Controller, HermiteNode, Method, Organ, Phase, Sample, State, TouchSurface,
};

/// The root in the coordinates of the centre, (0.01 - z) (10 + 60 x + 900 x^2 + 400 y^2): zero at z = 10 mm, where a
/// sphere of 9 mm with a layer of 1 mm touches the plane z = 0.
const ROOT: [Monomial; 8] = [
    (0.1, [0, 0, 0]),
    (-10.0, [0, 0, 1]),
    (0.6, [1, 0, 0]),
    (-60.0, [1, 0, 1]),
    (9.0, [2, 0, 0]),
    (-900.0, [2, 0, 1]),
    (4.0, [0, 2, 0]),
    (-400.0, [0, 2, 1]),
];

/// Places of the centre at zero displacement of the two charts.
const ORIGINS: [Vec3; 2] = [[0.0, 0.0, 0.007], [0.04, 0.0, 0.007]];

/// h of a centre.
fn force(centre_m: Vec3) -> [f64; 3] {
    let of = |orders| polynomial(&ROOT, centre_m, orders);
    let root = of([0; 3]).max(0.0);
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|orders| root * of(orders))
}

/// Two charts on a square of 60 mm: the left vertices belong to the first, the right ones to the second.
fn blob() -> AlignedBytes {
    blob_of(|_| 1.0)
}

/// The same with the root of each chart multiplied by a factor.
fn blob_of(factor: impl Fn(usize) -> f64) -> AlignedBytes {
    let recipe = Recipe {
        nodes: ORIGINS.to_vec(),
        spacing_m: 0.01,
        radius_m: 0.05,
        lattice_table: false,
        rbf: false,
        displacement: false,
        ..Recipe::default()
    };
    let lattice = recipe.lattice();
    recipe.blob_with(|draft| {
        draft.preamble.tool = Tool::Sphere(Sphere { radius_m: 0.009, layer_m: 0.001 });
        let corners = [[-0.01, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.01, 0.03]];
        // Where the centre is when the sphere just touches the plane z = 0.
        let plane = |axis: usize| corners.map(|corner| if axis < 2 { corner[axis] } else { 0.01_f32 });
        draft.preamble.contact = SurfaceHeader {
            node: draft.area.push(&[0_u32, 1, 1, 0]),
            position_m: [0, 1, 2].map(|axis| draft.area.push(&plane(axis))),
            triangles: draft.area.push(&[[0_u32, 1, 2], [0, 2, 3]]),
            fixed: draft.area.push(&[0_u8; 4]),
        };
        for (number, (space, origin_m)) in draft.spaces.iter_mut().zip(ORIGINS).enumerate() {
            let node = |slot: usize| -> HermiteNode {
                let at_m = vec3::add(origin_m, lattice.displacement_m(lattice.ijk(slot)));
                let mut node = HermiteNode::default();
                for (a, b, c) in (0..27).map(|code| (code / 9, code / 3 % 3, code % 3)) {
                    let scale = factor(number) * f64::from(lattice.spacing_m()).powi((a + b + c) as i32 - 1);
                    node[a][b][c] = (scale * polynomial(&ROOT, at_m, [a, b, c])) as f32;
                }
                node
            };
            let nodes: Vec<HermiteNode> = (0..lattice.slots()).map(node).collect();
            space.hermite.as_mut().expect("a table").nodes = draft.area.push(&nodes);
        }
    })
}

/// The commands on a path without friction, one sample per millisecond.
fn play(blob: &AlignedBytes, path: impl Iterator<Item = Vec3>) -> Vec<(Vec3, Command)> {
    play_with(0.0, blob, path)
}

fn play_with(friction: f32, blob: &AlignedBytes, path: impl Iterator<Item = Vec3>) -> Vec<(Vec3, Command)> {
    let organ = <Organ<'_, 2>>::read(blob).expect("good");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    let mut config = Config::new(Method::Energy);
    config.limits.max_stiffness_n_m = f32::INFINITY;
    config.contact.friction = friction;
    let surface = TouchSurface::new(&organ, &mut memory);
    let controller = Controller::new(&organ, config).expect("packed").on_surface(surface);
    let mut state = State::new();
    state.arm();
    let tick = |(t, position_m): (u64, Vec3)| {
        let sample = Sample { t_us: 1_000 * t, position_m, ..Sample::default() };
        (position_m, controller.tick(&mut state, sample.t_us, Some(&sample)))
    };
    (0..).zip(path).map(tick).collect()
}

fn error_n(found: Vec3, exact: [f64; 3]) -> f64 {
    (0..3).map(|k| (f64::from(found[k]) - exact[k]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn a_table_of_roots_gives_force_energy_and_stiffness() {
    let blob = blob();
    let organ = <Organ<'_, 2>>::read(&blob).expect("good");
    let space = &organ.spaces[0];
    assert!(space.has(Method::Energy) && !space.has(Method::Hermite));
    let mut largest = 0.0_f64;
    for d in [[0.004, -0.003, -0.006], [-0.013, 0.011, -0.021], [0.02, 0.005, 0.001], [0.0, 0.0, 0.009]] {
        let centre_m = vec3::add(ORIGINS[0], d);
        let (found, exact) = (space.estimate(Method::Energy, d).expect("packed"), force(centre_m));
        assert!(error_n(found.force_n, exact) < 1e-5, "{d:?}: {found:?} {exact:?}");
        largest = largest.max(exact.iter().map(|h| h.abs()).fold(0.0, f64::max));
        let root = polynomial(&ROOT, centre_m, [0; 3]).max(0.0);
        let energy_j = f64::from(found.energy_j.expect("an energy"));
        assert!((energy_j - 0.5 * root * root).abs() < 1e-7, "{energy_j} {root}");
        let alone_j = f64::from(space.energy_j(Method::Energy, d).expect("packed"));
        assert!((alone_j - energy_j).abs() < 1e-7, "{alone_j} {energy_j}");
        for axis in 0..3 {
            let at = |sign: f32| {
                let mut at = centre_m;
                at[axis] += sign * 1e-4;
                force(at)
            };
            let (low, high) = (at(-1.0), at(1.0));
            for i in 0..3 {
                let slope_n_m = (high[i] - low[i]) / 2e-4;
                let found_n_m = f64::from(found.stiffness_n_m[i][axis]);
                assert!((found_n_m - slope_n_m).abs() < 0.1, "{d:?} {i}{axis}: {found_n_m} {slope_n_m}");
            }
        }
    }
    assert!(largest > 1.0, "{largest} N");
    // Beside the body the root is negative, and the force exactly zero.
    let beside = space.estimate(Method::Energy, [0.0, 0.0, 0.009]).expect("packed");
    assert_eq!((beside.force_n, beside.energy_j), ([0.0; 3], Some(0.0)));
}

/// A touch begins and ends without a step, slides from one chart to the other, and has the force of the body everywhere.
#[test]
fn a_sphere_slides_over_its_charts() {
    let blob = blob();
    let down = (0..160).map(|n| [0.0, 0.0, 0.014 - 1e-4 * n as f32]);
    let along = (0..400).map(|n| [1e-4 * n as f32, 0.002, -0.002]);
    let up = (0..200).map(|n| [0.04, 0.0, -0.002 + 1e-4 * n as f32]);
    let played = play(&blob, down.chain(along).chain(up));
    let (mut previous_n, mut touched, mut blended) = ([0.0_f32; 3], 0, 0);
    for (position_m, command) in &played {
        assert_eq!(command.phase, Phase::Active);
        let exact = force(*position_m);
        assert!(error_n(command.reaction_n, exact) < 2e-5, "{position_m:?}: {command:?} {exact:?}");
        let step_n = vec3::distance(command.reaction_n, previous_n);
        assert!(step_n < 0.05, "{position_m:?}: a step of {step_n} N");
        previous_n = command.reaction_n;
        touched += usize::from(command.engaged.is_some());
        let weights = command.weights.map(|node| node.weight);
        assert!(command.engaged.is_none() || (weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        let of_second: f32 =
            command.weights.iter().filter(|node| node.space == 1).map(|node| node.weight).sum();
        blended += usize::from((0.2..0.8).contains(&of_second));
    }
    assert!(touched > 500 && blended > 200, "{touched} {blended}");
    assert_eq!(played.last().expect("a tick").1.engaged, None);
}

/// The displacement counts from the first touch, along the normal of the chart.
#[test]
fn the_displacement_of_a_sphere_is_its_depth() {
    let blob = blob();
    let played = play(&blob, (0..100).map(|n| [0.01, 0.01, 0.011 - 1e-4 * n as f32]));
    let (position_m, command) = played.last().expect("a tick");
    let [x, y, z] = command.displacement_m;
    assert!(x.abs() < 1e-6 && y.abs() < 1e-6, "{command:?}");
    assert!((z - (position_m[2] - 0.01)).abs() < 1e-6, "{command:?}");
}

/// A sphere that starts inside the body, where no surface is near, touches nothing.
#[test]
fn a_start_inside_the_body_has_no_force() {
    let blob = blob();
    let played = play(&blob, (0..5).map(|_| [0.02, 0.0, -0.015]));
    assert!(played.iter().all(|(_, command)| command.engaged.is_none() && command.reaction_n == [0.0; 3]));
}

/// One that starts just inside, where the surface is near, touches nothing until it has left the body and comes back.
#[test]
fn a_start_just_inside_has_no_force_until_the_sphere_has_left() {
    let blob = blob();
    let held = (0..5).map(|_| [0.02, 0.0, 0.0085]);
    let up = (0..30).map(|n| [0.02, 0.0, 0.0085 + 1e-4 * n as f32]);
    let down = (0..40).map(|n| [0.02, 0.0, 0.0115 - 1e-4 * n as f32]);
    let played = play(&blob, held.chain(up).chain(down));
    assert!(force(played[0].0)[2].abs() > 0.1, "a sphere is pressed there");
    assert!(played[..35].iter().all(|(_, command)| command.reaction_n == [0.0; 3]));
    let (at_m, last) = played.last().expect("a tick");
    assert!(error_n(last.reaction_n, force(*at_m)) < 2e-5 && last.reaction_n != [0.0; 3], "{last:?}");
}

/// Charts that differ push from the one with more energy to the other, so that a closed way moves no energy.
#[test]
fn charts_that_differ_pump_no_energy() {
    let blob = blob_of(|space| if space == 0 { 1.0 } else { 1.1 });
    let level = |x: f32, z: f32| [x, 0.004, z];
    let down = (0..130).map(|n| level(0.0, 0.012 - 1e-4 * n as f32));
    let across = (0..400).map(|n| level(1e-4 * n as f32, -0.001));
    let up = (0..130).map(|n| level(0.04, -0.001 + 1e-4 * n as f32));
    let played = play(&blob, down.chain(across).chain(up));
    let (work_j, moved_j) = work(&played);
    assert!(work_j.abs() < 1e-3 * moved_j, "{work_j} of {moved_j} J");
}

/// The work of the hand on a path, and the energy that it exchanges, J.
fn work(played: &[(Vec3, Command)]) -> (f64, f64) {
    let steps = played.windows(2).map(|pair| {
        let [(from_m, before), (to_m, after)] = pair else { return 0.0 };
        let mean_n = vec3::scale(vec3::add(before.reaction_n, after.reaction_n), 0.5);
        f64::from(vec3::dot(mean_n, vec3::sub(*to_m, *from_m)))
    });
    steps.fold((0.0, 0.0), |(sum, moved), step_j| (sum + step_j, moved + step_j.abs()))
}

/// With friction a press, a slide over both charts and a release cost energy, more with more friction; the slide feels
/// mu |h|, and neither touch nor release has a step.
#[test]
fn friction_of_a_sphere_only_dissipates() {
    let blob = blob_of(|space| if space == 0 { 1.0 } else { 1.1 });
    let level = |x: f32, z: f32| [x, 0.004, z];
    let path = || {
        let down = (0..130).map(move |n| level(0.0, 0.012 - 1e-4 * n as f32));
        let across = (0..400).map(move |n| level(1e-4 * n as f32, -0.001));
        let up = (0..130).map(move |n| level(0.04, -0.001 + 1e-4 * n as f32));
        let back = (0..400).map(move |n| level(0.04 - 1e-4 * n as f32, 0.012));
        down.chain(across).chain(up).chain(back)
    };
    let smooth = play(&blob, path());
    let mut spent_before_j = 1e-4 * work(&smooth).1;
    for friction in [0.1_f32, 0.3, 1.0] {
        let rough = play_with(friction, &blob, path());
        let spent_j = work(&rough).0;
        assert!(spent_j > 1.3 * spent_before_j, "{friction}: {spent_j} J after {spent_before_j} J");
        spent_before_j = spent_j;
        let mut previous_n = vec3::ZERO;
        for (n, ((_, without), (_, with))) in smooth.iter().zip(&rough).enumerate() {
            let along_n = vec3::sub(with.reaction_n, without.reaction_n);
            let most_n = friction * vec3::norm(without.reaction_n);
            assert!(vec3::norm(along_n) <= 1.000_1 * most_n + 1e-6, "{n}: {along_n:?} of {most_n} N");
            let is_sliding = (450..520).contains(&n);
            assert!(!is_sliding || vec3::norm(along_n) > 0.999 * most_n, "{n}: {along_n:?} of {most_n} N");
            // The spring has about 70 N/m, and the way of a tick is 0.1 mm.
            let step_n = vec3::distance(along_n, previous_n);
            assert!(step_n < 0.03, "{friction} {n}: a step of {step_n} N");
            previous_n = along_n;
        }
    }
}

/// A sphere that sticks is a spring: small circles that do not slip move no energy, over the blend of the charts too. The
/// first circle finds the greatest force and with it the stiffness of the spring.
#[test]
fn a_sphere_that_sticks_pumps_no_energy() {
    let blob = blob_of(|space| if space == 0 { 1.0 } else { 1.1 });
    let down = (0..130).map(|n| [0.02, 0.004, 0.012 - 1e-4 * n as f32]);
    let turn = |n: u32| {
        let (sin, cos) = (n as f32 * core::f32::consts::TAU / 2_000.0).sin_cos();
        [0.02 + 5e-4 * sin, 0.0035 + 5e-4 * cos, -0.0009 - 3e-4 * sin]
    };
    let before = down.len() + 2_000;
    let rough = play_with(0.5, &blob, down.clone().chain((0..=4_000).map(turn)));
    let smooth = play(&blob, down.chain((0..=4_000).map(turn)));
    let (work_j, moved_j) = work(&rough[before..]);
    assert!(work_j.abs() < 1e-3 * moved_j, "{work_j} of {moved_j} J");
    let along_n = rough.iter().zip(&smooth).map(|(a, b)| vec3::distance(a.1.reaction_n, b.1.reaction_n));
    let most_n = along_n.fold(0.0, f32::max);
    assert!(most_n > 0.02, "{most_n} N: the spring must be stretched");
}
