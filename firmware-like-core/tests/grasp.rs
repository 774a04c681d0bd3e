//! Grasps on a body that is active everywhere: where they begin, what ends them, and how the force fades.

use crate::common::ball::{RADIUS_M, ball, uneven};
use crate::common::sphere;
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Config, Controller, Method, Organ, Sample, State};

/// A release under 4 N: the force decays to zero in small steps.
#[test]
fn the_force_fades_after_a_release() {
    ball!(bench, ball(|_| 1.0, 162), 0.3);
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

/// A release during a gap in the samples: the force stays zero after the gap.
#[test]
fn nothing_fades_after_a_gap_at_zero() {
    ball!(bench, ball(|_| 1.0, 162), 0.3);
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

/// The distance from the surface decides, inside and outside, at a node or between nodes.
#[test]
fn a_grasp_begins_only_near_the_surface() {
    ball!(bench, ball(|_| 1.0, 162), 0.3);
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
            // Disarming resets the path, so that the jump to this HIP is not a crossing of the surface.
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

/// A grasp is lost beyond the grid and beyond the force of the device, and needs a new press.
#[test]
fn a_grasp_is_lost_at_its_limits() {
    let pull = |max_force_n: f32, max_stiffness_n_m: f32| {
        let blob = ball(|_| 1.0, 162);
        let organ = <Organ<'_>>::read(&blob).expect("good");
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
                ..Sample::default()
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
    let capped = pull(2.0, 200.0).expect("2.2 N at the hand, 200 N/m");
    assert!((capped - 0.011).abs() < 4e-4, "{capped}");
    let by_reach = pull(1e3, 3e3).expect("1.1 times 20 mm");
    assert!((by_reach - 0.022).abs() < 2e-4, "{by_reach}");
}

/// A grasp during a slide keeps its spaces and weights: the force does not jump.
#[test]
fn a_grasp_in_the_middle_of_a_slide() {
    ball!(bench, ball(uneven, 162), 0.3);
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
    assert!(before.weights.iter().filter(|share| share.weight > 0.0).count() > 1, "{before:?}");
    assert!(vec3::distance(before.hand_force_n, grasped.hand_force_n) < 0.05);
    let pulled = (1..=40).map(|step| bench.at_with([hip_m[0], 0.0, hip_m[2] + 2e-4 * step as f32], 1)).last();
    let pulled = pulled.expect("some");
    assert!(pulled.engaged.is_some() && vec3::dot(pulled.reaction_n, [0.0, 0.0, 1.0]) > 0.5, "{pulled:?}");
    assert_eq!(pulled.weights, grasped.weights, "a grasp does not slide");
}
