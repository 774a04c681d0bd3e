//! A body that is active all over: bare touch, sliding, letting go, another body under the hand.

mod common;

use common::{Aligned, Random, Recipe, sphere};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Command, Config, Controller, Method, Organ, Phase, Sample, State, TouchSurface};

const RADIUS_M: f32 = 0.04;

/// Neighbours differ by up to a third.
fn uneven(node: u32) -> f64 {
    1.0 + 0.3 * (f64::from(node) * 2.4).sin()
}

fn ball(stiffer: fn(u32) -> f64, active: usize) -> Aligned {
    let body = sphere(RADIUS_M, 2);
    let nodes = body.0[..active].to_vec();
    let recipe = Recipe {
        nodes,
        normal: vec3::normalize_or_zero,
        stiffer,
        body: Some(body),
        radius_m: 0.02,
        // Isotropic, so that the same way into the body is as hard everywhere.
        force: |d| d.map(|x| 400.0 * f64::from(x)),
        ghost: |d| d.map(|x| 400.0 * f64::from(x)),
        rbf: false,
        hermite: false,
        displacement: false,
        ..Recipe::default()
    };
    recipe.blob()
}

struct Bench<'o> {
    controller: Controller<'o, 'o>,
    state: State,
    now_us: u64,
}

impl<'o> Bench<'o> {
    fn new(organ: &'o Organ<'o>, memory: &'o mut Vec<u32>, friction: f32) -> Self {
        let mut config = Config::new(Method::Trilinear);
        config.limits.ramp_s = 0.0;
        config.contact.friction = friction;
        memory.resize(TouchSurface::words(organ), 0);
        let surface = TouchSurface::new(organ, memory);
        assert!(surface.is_some());
        let controller = Controller::new(organ, config).expect("packed").on_surface(surface);
        let mut state = State::new();
        assert!(state.arm());
        Self { controller, state, now_us: 1_000_000 }
    }

    fn at_with(&mut self, position_m: Vec3, buttons: u32) -> Command {
        self.now_us += 1_000;
        let sample = Sample { t_us: self.now_us, position_m, buttons };
        let command = self.controller.tick(&mut self.state, self.now_us, Some(&sample));
        assert_eq!(command.phase, Phase::Active, "{command:?}");
        command
    }

    fn at(&mut self, position_m: Vec3) -> Command {
        self.at_with(position_m, 0)
    }
}

macro_rules! bench {
    ($bench:ident, $blob:expr, $friction:expr) => {
        let blob = $blob;
        let organ = <Organ<'_>>::read(blob.bytes()).expect("good");
        let mut memory = Vec::new();
        let mut $bench = Bench::new(&organ, &mut memory, $friction);
    };
}

/// Every triangle in all lists it belongs to: each way in from outside is found, whatever triangle, edge or corner it goes through.
#[test]
fn every_way_in_is_found_and_no_way_out() {
    let blob = ball(|_| 1.0, 162);
    let organ = <Organ<'_>>::read(blob.bytes()).expect("good");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    let surface = TouchSurface::new(&organ, &mut memory).expect("a surface");
    let (vertices, triangles) = sphere(RADIUS_M, 2);
    let corner = |i: u32| vertices[i as usize];
    let mut aims = vertices.clone();
    for &[a, b, c] in &triangles {
        let edge = vec3::scale(vec3::add(corner(a), corner(b)), 0.5);
        let third = vec3::scale(vec3::add(vec3::add(corner(a), corner(b)), corner(c)), 1.0 / 3.0);
        aims.extend([edge, third]);
    }
    for aim in aims {
        let (outside, inside) = (vec3::scale(aim, 1.01), vec3::scale(aim, 0.995));
        let found = surface.crossing(outside, inside).unwrap_or_else(|| panic!("{aim:?}"));
        assert!(vec3::distance(found.at_m, aim) < 1e-6, "{found:?} for {aim:?}");
        assert!(vec3::distance(surface.point(&found.foot), aim) < 1e-5, "{found:?} for {aim:?}");
        assert_eq!(surface.crossing(inside, outside), None);
        assert_eq!(surface.crossing(inside, vec3::scale(aim, 0.99)), None);
    }
    // However long the way is, as after a gap: where it enters, not where it would enter again. Beside the body is none of its business;
    // NaN is nothing.
    for aim in &vertices {
        let found =
            surface.crossing(vec3::scale(*aim, 1.7), vec3::scale(*aim, -3.0)).expect("all through it");
        assert!(vec3::distance(found.at_m, *aim) < 1e-5, "{found:?} for {aim:?}");
    }
    assert_eq!(surface.crossing([0.1, 0.1, 0.1], [0.101, 0.1, 0.1]), None);
    assert_eq!(surface.crossing([f32::NAN; 3], [0.0; 3]), None);
}

/// The acceptance of the lists: against a test of every triangle.
#[test]
fn the_cells_hide_no_triangle() {
    let blob = ball(|_| 1.0, 162);
    let organ = <Organ<'_>>::read(blob.bytes()).expect("good");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    let surface = TouchSurface::new(&organ, &mut memory).expect("a surface");
    let mut random = Random(7);
    let mut hits = 0;
    for _ in 0..20_000 {
        let from = vec3::scale(
            vec3::normalize_or_zero(random.point(1.0)),
            RADIUS_M * (0.97 + 0.05 * random.next().abs()),
        );
        let to = vec3::add(from, random.point(0.002));
        let inside = |p: Vec3| vec3::norm(p) < 0.995 * RADIUS_M * 0.98;
        let found = surface.crossing(from, to);
        hits += usize::from(found.is_some());
        if vec3::norm(from) > RADIUS_M && inside(to) {
            assert!(found.is_some(), "{from:?} {to:?}");
        }
        if vec3::norm(to) > RADIUS_M || inside(from) {
            assert!(found.is_none(), "{from:?} {to:?}");
        }
    }
    assert!(hits > 1_000, "{hits}");
}

/// A way right through one ball in another enters both: where it enters first counts, however many triangles are on the way.
#[test]
fn a_long_way_ends_at_the_first_surface() {
    let (outer, triangles) = sphere(RADIUS_M, 4);
    let inner = outer.iter().map(|vertex| vec3::scale(*vertex, 0.97));
    let vertices: Vec<Vec3> = inner.chain(outer.iter().copied()).collect();
    let shifted = |triangle: &[u32; 3]| triangle.map(|vertex| vertex + outer.len() as u32);
    let nodes = vec![outer[0]];
    for outer_first in [true, false] {
        let (one, other) = (triangles.iter().copied(), triangles.iter().map(shifted));
        let triangles: Vec<[u32; 3]> =
            if outer_first { other.chain(one).collect() } else { one.chain(other).collect() };
        assert!(triangles.len() > 10_000);
        let body = Some((vertices.clone(), triangles));
        let recipe =
            Recipe { nodes: nodes.clone(), body, rbf: false, displacement: false, ..Recipe::default() };
        let blob = recipe.blob();
        let organ = <Organ<'_>>::read(blob.bytes()).expect("good");
        let mut memory = vec![0; TouchSurface::words(&organ)];
        let surface = TouchSurface::new(&organ, &mut memory).expect("a surface");
        let mut random = Random(11);
        for _ in 0..500 {
            let from = vec3::scale(vec3::normalize_or_zero(random.point(1.0)), 1.6 * RADIUS_M);
            let to = vec3::add(vec3::scale(from, -1.0), random.point(0.3 * RADIUS_M));
            let found = surface.crossing(from, to).expect("right through both");
            let radius_m = vec3::norm(found.at_m);
            assert!(
                (0.99..1.001).contains(&(radius_m / RADIUS_M)),
                "{found:?}, {radius_m} m from the middle"
            );
            assert!(vec3::dot(found.at_m, from) > 0.0, "on the near side: {found:?}");
        }
    }
}

/// Anywhere on any triangle the first sample below the surface has no more force than its depth is worth.
#[test]
fn bare_touch_is_without_force_anywhere() {
    let mut random = Random(3);
    for friction in [0.3, f32::INFINITY] {
        bench!(bench, ball(uneven, 162), friction);
        for _ in 0..300 {
            let outward = vec3::normalize_or_zero(random.point(1.0));
            bench.state = State::new();
            bench.state.arm();
            let mut touched = None;
            for step in 0..60 {
                let command = bench.at(vec3::scale(outward, RADIUS_M + 1e-3 - 5e-5 * step as f32));
                let force_n = vec3::norm(command.reaction_n);
                if command.engaged.is_some() && touched.is_none() {
                    // 50 um at 400 N/m times 1.3.
                    assert!(force_n < 0.027, "{command:?}");
                    touched = Some(step);
                }
            }
            assert!(touched.is_some(), "{outward:?}");
        }
    }
}

/// Largest change of a force from tick to tick while the tool goes over many triangles, and where it got to.
struct Stroke {
    largest_step_n: f32,
    nodes: std::collections::BTreeSet<u16>,
    peak_n: f32,
    work_j: f64,
}

/// Dips `depth_m` into the ball and goes round it, `turns` times at `speed_m_s`, then comes out.
fn round(bench: &mut Bench<'_>, depth_m: f32, turns: f32, speed_m_s: f32) -> Stroke {
    let mut stroke = Stroke { largest_step_n: 0.0, nodes: Default::default(), peak_n: 0.0, work_j: 0.0 };
    let (axis, other): (Vec3, Vec3) = ([0.36, 0.48, 0.8], [0.8, -0.6, 0.0]);
    let at = |angle: f32, radius: f32| {
        let on = vec3::add(vec3::scale(axis, angle.cos()), vec3::scale(other, angle.sin()));
        vec3::scale(on, radius)
    };
    let per_tick = speed_m_s * 1e-3 / RADIUS_M;
    let ticks = (core::f32::consts::TAU * turns / per_tick) as usize;
    let mut before: Option<(Vec3, Vec3)> = None;
    let inward = (depth_m / 5e-5) as usize;
    for step in 0..2 * inward + ticks + 100 {
        let (dip, angle) = if step < inward + 50 {
            (step as f32 / inward as f32, 0.0)
        } else if step < inward + 50 + ticks {
            (1.0, (step - inward - 50) as f32 * per_tick)
        } else {
            (1.0 - (step - inward - 50 - ticks) as f32 / inward as f32, ticks as f32 * per_tick)
        };
        let hip_m = at(angle, RADIUS_M + 1e-3 - (depth_m + 1e-3) * dip.clamp(-0.2, 1.0));
        let command = bench.at(hip_m);
        stroke.nodes.extend(command.engaged);
        stroke.peak_n = stroke.peak_n.max(vec3::norm(command.reaction_n));
        if let Some((force_n, then_m)) = before {
            stroke.largest_step_n = stroke.largest_step_n.max(vec3::distance(force_n, command.hand_force_n));
            stroke.work_j += f64::from(vec3::dot(force_n, vec3::sub(hip_m, then_m)));
        }
        before = Some((command.hand_force_n, hip_m));
    }
    stroke
}

/// Over every seam the force changes as little as inside a triangle, though neighbours differ by a third.
#[test]
fn sliding_is_continuous_over_every_seam() {
    bench!(even, ball(|_| 1.0, 162), 0.3);
    let smooth = round(&mut even, 0.006, 1.0, 0.1);
    bench!(bench, ball(uneven, 162), 0.3);
    let stroke = round(&mut bench, 0.006, 1.0, 0.1);
    assert!(stroke.nodes.len() > 12 && stroke.peak_n > 1.5, "{:?} {}", stroke.nodes, stroke.peak_n);
    // 0.1 mm a tick at 520 N/m is 52 mN; the spaces differ by up to 1.4 N.
    assert!(stroke.largest_step_n < 0.06, "{} against {}", stroke.largest_step_n, smooth.largest_step_n);
}

/// What sliding costs the hand is friction: about mu |h_n| times the way, and never below nothing.
#[test]
fn friction_takes_energy_and_gives_none() {
    for friction in [0.05, 0.3, 1.0] {
        bench!(bench, ball(|_| 1.0, 162), friction);
        let stroke = round(&mut bench, 0.004, 1.0, 0.02);
        let way_m = f64::from(core::f32::consts::TAU * (RADIUS_M - 0.004));
        let worth_j = f64::from(friction) * 400.0 * 0.004 * way_m;
        let ratio = -stroke.work_j / worth_j;
        assert!((0.6..1.6).contains(&ratio), "mu {friction}: {ratio} of {worth_j} J");
    }
    bench!(bench, ball(uneven, 162), 0.3);
    assert!(round(&mut bench, 0.004, 3.0, 0.1).work_j < 0.0);
}

/// The paper's snap: one node answers, and a tool dragged along the surface drags it.
#[test]
fn a_tool_that_sticks_stays_with_its_node() {
    bench!(bench, ball(|_| 1.0, 162), f32::INFINITY);
    let outward = [0.0, 0.0, 1.0];
    for step in 0..100 {
        bench.at([0.0, 0.0, RADIUS_M + 1e-3 - 5e-5 * step as f32]);
    }
    let first = bench.at(vec3::scale(outward, RADIUS_M - 4e-3));
    let dragged =
        (1..=60).map(|step| bench.at([1e-4 * step as f32, 0.0, RADIUS_M - 4e-3])).last().expect("some");
    assert_eq!((first.engaged, first.shares[0].weight), (dragged.engaged, 1.0));
    assert!((dragged.displacement_m[0] - 6e-3).abs() < 1e-6 && dragged.reaction_n[0] > 2.0, "{dragged:?}");
}

/// Where the active nodes end the last ones go on to answer; friction holds, no wall, and the tool comes off without a jump.
#[test]
fn the_border_of_the_active_region_is_no_wall() {
    let body = sphere(RADIUS_M, 2);
    // Only what lies above z = 0: nodes must be the first vertices, so sort them to the front.
    let mut order: Vec<usize> = (0..body.0.len()).collect();
    order.sort_by(|&a, &b| body.0[b][2].total_cmp(&body.0[a][2]));
    let vertices: Vec<Vec3> = order.iter().map(|&i| body.0[i]).collect();
    let place = |old: u32| order.iter().position(|&i| i == old as usize).expect("a permutation") as u32;
    let triangles = body.1.iter().map(|triangle| triangle.map(place)).collect();
    let active = vertices.iter().filter(|vertex| vertex[2] > 0.0).count();
    let recipe = Recipe {
        nodes: vertices[..active].to_vec(),
        normal: vec3::normalize_or_zero,
        body: Some((vertices, triangles)),
        force: |d| d.map(|x| 400.0 * f64::from(x)),
        ghost: |d| d.map(|x| 400.0 * f64::from(x)),
        rbf: false,
        hermite: false,
        displacement: false,
        ..Recipe::default()
    };
    bench!(bench, recipe.blob(), 0.1);
    let mut before: Option<Command> = None;
    let (mut lowest_m, mut released, mut peak_n) = (RADIUS_M, false, 0.0_f32);
    for step in 0..900 {
        let dip = (step as f32 * 5e-5).min(4e-3);
        let angle = (step as f32 - 80.0).max(0.0) * 2.5e-3;
        let hip_m = vec3::scale([angle.sin(), 0.1 * angle.sin(), angle.cos()], RADIUS_M + 1e-4 - dip);
        let command = bench.at(hip_m);
        if let Some(before) = before {
            let step_n = vec3::distance(before.hand_force_n, command.hand_force_n);
            assert!(step_n < 0.3, "{step}: {step_n}");
            released |= before.engaged.is_some() && command.engaged.is_none();
        }
        if command.engaged.is_some() {
            let anchor_m = vec3::sub(hip_m, command.displacement_m);
            lowest_m = lowest_m.min(anchor_m[2]);
            peak_n = peak_n.max(vec3::norm(command.reaction_n));
        }
        before = Some(command);
    }
    // The circle dives 10 mm below the plane of the border's nodes before the capture radius ends it; a foot that stuck there would be torn at 8 N.
    assert!(lowest_m < -5e-3 && peak_n < 4.5, "goes on over the border: {lowest_m} m, {peak_n} N");
    assert!(released, "a tool that goes on round the body comes off");
}

/// A button up under 4 N: the force leaves in many small steps, and ends.
#[test]
fn letting_go_fades() {
    bench!(bench, ball(|_| 1.0, 162), 0.3);
    let out = |metres: f32| [0.0, 0.0, RADIUS_M + metres];
    for _ in 0..5 {
        bench.at(out(1e-3));
    }
    for step in 0..100 {
        bench.at_with(out(1e-3 + 1e-4 * step as f32), 1);
    }
    let held = bench.at_with(out(0.011), 1);
    assert!(vec3::norm(held.hand_force_n) > 3.9 && held.hand_force_n[2] < 0.0, "{held:?}");
    let mut force_n = held.hand_force_n;
    for tick in 0..40 {
        let command = bench.at_with(out(0.011), 0);
        assert_eq!((command.engaged, command.reaction_n), (None, vec3::ZERO));
        let step_n = vec3::distance(force_n, command.hand_force_n);
        assert!(step_n < 0.15, "tick {tick}: {step_n}");
        force_n = command.hand_force_n;
    }
    assert_eq!(force_n, vec3::ZERO);
}

/// A device that was silent while it was let go gets no force back when it speaks again.
#[test]
fn nothing_fades_after_a_gap_at_zero() {
    bench!(bench, ball(|_| 1.0, 162), 0.3);
    let out = |metres: f32| [0.0, 0.0, RADIUS_M + metres];
    for step in 0..105 {
        bench.at_with(out(1e-3 + 1e-4 * (step as f32 - 5.0).max(0.0)), u32::from(step > 5));
    }
    for _ in 0..6 {
        bench.now_us += 1_000;
        bench.controller.tick(&mut bench.state, bench.now_us, None);
    }
    for _ in 0..40 {
        let command = bench.at_with(out(0.0109), 0);
        assert_eq!((command.engaged, command.hand_force_n), (None, vec3::ZERO));
    }
}

/// By the distance from the surface, inside and outside, over a node or between nodes.
#[test]
fn only_what_is_close_is_taken_hold_of() {
    bench!(bench, ball(|_| 1.0, 162), 0.3);
    let directions = {
        let (vertices, triangles) = sphere(RADIUS_M, 2);
        let middle = |&[a, b, c]: &[u32; 3]| {
            let [a, b, c] = [a, b, c].map(|i| vertices[i as usize]);
            vec3::scale(vec3::add(vec3::add(a, b), c), 1.0 / 3.0)
        };
        let middles: Vec<Vec3> = triangles.iter().take(40).map(middle).collect();
        vertices.iter().take(40).copied().chain(middles).collect::<Vec<_>>()
    };
    for foot_m in directions {
        for (height_m, takes) in [(2.8e-3, true), (3.3e-3, false), (-2.8e-3, true), (-3.3e-3, false)] {
            let out = vec3::normalize_or_zero(foot_m);
            let hip_m = vec3::add(foot_m, vec3::scale(out, height_m));
            // There without a way through the surface.
            bench.state.disarm();
            bench.now_us += 50_000;
            bench.state.arm();
            bench.at(hip_m);
            let grasped = bench.at_with(hip_m, 1);
            assert_eq!(grasped.engaged.is_some(), takes, "{height_m} m off {foot_m:?}");
            bench.at(hip_m);
        }
    }
}

/// A grasp slips off beyond the grid or beyond what the device holds, and a press is needed to take hold again.
#[test]
fn a_grasp_slips_at_its_limits() {
    let pull = |max_force_n: f32, max_stiffness_n_m: f32| {
        let blob = ball(|_| 1.0, 162);
        let organ = <Organ<'_>>::read(blob.bytes()).expect("good");
        let mut config = Config::new(Method::Trilinear);
        config.limits.ramp_s = 0.0;
        (config.limits.max_force_n, config.limits.max_stiffness_n_m) = (max_force_n, max_stiffness_n_m);
        let controller = Controller::new(&organ, config).expect("packed");
        let (mut state, mut slipped_m) = (State::new(), None);
        state.arm();
        for step in 0..400_u64 {
            let metres = 1e-4 * step as f32;
            let sample = Sample {
                t_us: step * 1_000,
                position_m: [0.0, 0.0, RADIUS_M + metres],
                buttons: u32::from(step > 2),
            };
            let command = controller.tick(&mut state, step * 1_000, Some(&sample));
            match (slipped_m, step) {
                (None, 5..) if command.engaged.is_none() => slipped_m = Some(metres - 3e-4),
                (Some(_), _) => assert_eq!(command.engaged, None, "without a new press"),
                _ => {}
            }
        }
        slipped_m
    };
    let by_force = pull(4.0, 3e3).expect("4.4 N at 400 N/m");
    assert!((by_force - 0.011).abs() < 2e-4, "{by_force}");
    let capped = pull(2.0, 200.0).expect("2.2 N at 200 N/m: it is what the hand feels that counts");
    assert!((capped - 0.011).abs() < 4e-4, "{capped}");
    let by_reach = pull(1e3, 3e3).expect("1.1 times 20 mm");
    assert!((by_reach - 0.022).abs() < 2e-4, "{by_reach}");
}

/// Another organ of the same nodes under the same touch: the force goes over in small steps and arrives.
#[test]
fn another_model_takes_over_without_a_step() {
    let (soft, stiff) = (ball(|_| 1.0, 162), ball(|_| 1.9, 162));
    let (soft, stiff) =
        (<Organ<'_>>::read(soft.bytes()).expect("good"), <Organ<'_>>::read(stiff.bytes()).expect("good"));
    let (mut one, mut two) = (Vec::new(), Vec::new());
    let mut bench = Bench::new(&soft, &mut one, 0.3);
    let other = Bench::new(&stiff, &mut two, 0.3).controller;
    for step in 0..120 {
        bench.at([0.0, 0.0, RADIUS_M + 1e-3 - 1e-4 * (step as f32).min(60.0)]);
    }
    let before = bench.at([0.0, 0.0, RADIUS_M - 5e-3]);
    bench.controller = other;
    bench.state.hand_over(true);
    let mut force_n = before.hand_force_n;
    for tick in 0..60 {
        let command = bench.at([0.0, 0.0, RADIUS_M - 5e-3]);
        assert!(command.engaged == before.engaged && command.displacement_m == before.displacement_m);
        let step_n = vec3::distance(force_n, command.hand_force_n);
        assert!(step_n < 0.07, "tick {tick}: {step_n}");
        force_n = command.hand_force_n;
    }
    let ratio = vec3::norm(force_n) / vec3::norm(before.hand_force_n);
    assert!((ratio - 1.9).abs() < 1e-3, "{ratio}");
    // Other nodes: the touch ends, smoothly too.
    bench.state.hand_over(false);
    let ended = bench.at([0.0, 0.0, RADIUS_M - 5e-3]);
    assert!(ended.engaged.is_none() && vec3::distance(ended.hand_force_n, force_n) < 0.15);
}

/// What grasps while it slides keeps its blend: the force does not jump.
#[test]
fn grasping_in_the_middle_of_a_slide() {
    bench!(bench, ball(uneven, 162), 0.3);
    for step in 0..60 {
        bench.at([0.0, 0.0, RADIUS_M + 1e-3 - 1e-4 * step as f32]);
    }
    let mut hip_m = [0.0, 0.0, RADIUS_M - 4.9e-3];
    for _ in 0..60 {
        hip_m[0] += 1e-4;
        bench.at(hip_m);
    }
    let before = bench.at(hip_m);
    let grasped = bench.at_with(hip_m, 1);
    assert!(before.shares.iter().filter(|share| share.weight > 0.0).count() > 1, "{before:?}");
    assert!(vec3::distance(before.hand_force_n, grasped.hand_force_n) < 0.05);
    let pulled = (1..=40).map(|step| bench.at_with([hip_m[0], 0.0, hip_m[2] + 2e-4 * step as f32], 1)).last();
    let pulled = pulled.expect("some");
    assert!(pulled.engaged.is_some() && vec3::dot(pulled.reaction_n, [0.0, 0.0, 1.0]) > 0.5, "{pulled:?}");
    assert_eq!(pulled.shares, grasped.shares, "a grasp does not slide");
}
