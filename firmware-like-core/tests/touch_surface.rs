//! A body that is active everywhere: touch, sliding, the border of the active region. `crossing.rs` tests the
//! search for the surface, `grasp.rs` the grasps.

use crate::common::ball::{Hand, RADIUS_M, ball, uneven};
use crate::common::{Random, Recipe, sphere};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Command, Organ, State};

/// At every point of the surface the first sample below it has only the force of its depth.
#[test]
fn touch_begins_without_force_everywhere() {
    let mut random = Random(3);
    for friction in [0.3, f32::INFINITY] {
        ball!(bench, ball(uneven, 162), friction);
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

/// Measured values of a stroke across many triangles.
struct Stroke {
    largest_step_n: f32,
    nodes: std::collections::BTreeSet<u16>,
    peak_n: f32,
    work_j: f64,
}

/// Moves into the ball by `depth_m`, round it `turns` times at `speed_m_s`, and out again.
fn round(bench: &mut Hand<'_>, depth_m: f32, turns: f32, speed_m_s: f32) -> Stroke {
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

/// Across edges the force changes as little as inside a triangle, although neighbouring spaces differ by a
/// third.
#[test]
fn sliding_is_continuous_across_every_edge() {
    ball!(even, ball(|_| 1.0, 162), 0.3);
    let smooth = round(&mut even, 0.006, 1.0, 0.1);
    ball!(bench, ball(uneven, 162), 0.3);
    let stroke = round(&mut bench, 0.006, 1.0, 0.1);
    assert!(stroke.nodes.len() > 12 && stroke.peak_n > 1.5, "{:?} {}", stroke.nodes, stroke.peak_n);
    // 0.1 mm per tick at 520 N/m is 52 mN; the spaces differ by up to 1.4 N.
    assert!(stroke.largest_step_n < 0.06, "{} against {}", stroke.largest_step_n, smooth.largest_step_n);
}

/// Sliding costs the hand the work of friction, mu |h_n| times the path, and never returns energy.
#[test]
fn friction_dissipates_energy() {
    for friction in [0.05, 0.3, 1.0] {
        ball!(bench, ball(|_| 1.0, 162), friction);
        let stroke = round(&mut bench, 0.004, 1.0, 0.02);
        let way_m = f64::from(core::f32::consts::TAU * (RADIUS_M - 0.004));
        let worth_j = f64::from(friction) * 400.0 * 0.004 * way_m;
        let ratio = -stroke.work_j / worth_j;
        assert!((0.6..1.6).contains(&ratio), "mu {friction}: {ratio} of {worth_j} J");
    }
    ball!(bench, ball(uneven, 162), 0.3);
    assert!(round(&mut bench, 0.004, 3.0, 0.1).work_j < 0.0);
}

/// With infinite friction one node is held, and a tool that moves along the surface drags it.
#[test]
fn a_tool_that_sticks_stays_with_its_node() {
    ball!(bench, ball(|_| 1.0, 162), f32::INFINITY);
    let outward = [0.0, 0.0, 1.0];
    for step in 0..100 {
        bench.at([0.0, 0.0, RADIUS_M + 1e-3 - 5e-5 * step as f32]);
    }
    let first = bench.at(vec3::scale(outward, RADIUS_M - 4e-3));
    let dragged =
        (1..=60).map(|step| bench.at([1e-4 * step as f32, 0.0, RADIUS_M - 4e-3])).last().expect("some");
    assert_eq!((first.engaged, first.weights[0].weight), (dragged.engaged, 1.0));
    assert!((dragged.displacement_m[0] - 6e-3).abs() < 1e-6 && dragged.reaction_n[0] > 2.0, "{dragged:?}");
}

/// At the border of the active region the force is that of the last nodes, with friction and without a step,
/// and the tool disengages without a jump.
#[test]
fn the_border_of_the_active_region_is_no_wall() {
    let body = sphere(RADIUS_M, 2);
    // The vertices with z > 0 are active; active nodes are the first vertices.
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
    ball!(bench, recipe.blob(), 0.1);
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
    // The circle continues 10 mm below the plane of the border before the capture radius ends the contact. An
    // anchor that stuck at the border would reach 8 N.
    assert!(lowest_m < -5e-3 && peak_n < 4.5, "continues beyond the border: {lowest_m} m, {peak_n} N");
    assert!(released, "the tool disengages further round the body");
}

/// A change to another organ with the same nodes during a touch: the transition of the force has small steps.
#[test]
fn another_model_takes_over_without_a_step() {
    let (soft, stiff) = (ball(|_| 1.0, 162), ball(|_| 1.9, 162));
    let (soft, stiff) = (<Organ<'_>>::read(&soft).expect("good"), <Organ<'_>>::read(&stiff).expect("good"));
    let (mut one, mut two) = (Vec::new(), Vec::new());
    let mut bench = Hand::new(&soft, &mut one, 0.3);
    let other = Hand::new(&stiff, &mut two, 0.3).controller;
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
    // A change to an organ with other nodes: the touch ends, also smoothly.
    bench.state.hand_over(false);
    let ended = bench.at([0.0, 0.0, RADIUS_M - 5e-3]);
    assert!(ended.engaged.is_none() && vec3::distance(ended.hand_force_n, force_n) < 0.15);
}
