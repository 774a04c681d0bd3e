use super::*;
use crate::synthetic;
use palpate_core::{Config, Controller, Method, State};

fn run(config: SimulatedConfig, stiffness_n_m: f32, steps: u64) -> Vec<(Vec3, Vec3, Vec3)> {
    let blob = synthetic::organ(&synthetic::Shape { stiffness_n_m, ..synthetic::Shape::default() });
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let controller = Controller::new(&organ, Config::new(Method::Trilinear)).expect("has the method");
    let mut hand = SimulatedHand::new(&organ, config);
    let (mut state, mut force) = (State::new(), vec3::ZERO);
    state.arm();
    (1..=steps)
        .map(|tick| {
            let now_us = tick * 1_000;
            let sample = hand.exchange(now_us, force).expect("never fails").expect("always samples");
            let command = controller.tick(&mut state, now_us, Some(&sample));
            assert_eq!(command.phase, palpate_core::Phase::Active, "tick {tick}");
            force = command.hand_force_n;
            (sample.position_m, command.displacement_m, command.reaction_n)
        })
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_others() {
    let one = run(SimulatedConfig::default(), 300.0, 9_000);
    assert_eq!(one, run(SimulatedConfig::default(), 300.0, 9_000));
    let hand = HandConfig { seed: 2, ..HandConfig::default() };
    assert_ne!(one, run(SimulatedConfig { hand, ..SimulatedConfig::default() }, 300.0, 9_000));
}

/// From soft to the stiffest organ for a Falcon: strokes reach the organ, stay bounded, and no oscillation
/// builds up.
#[test]
fn strokes_are_bounded_and_stable_on_soft_and_stiff_organs() {
    for stiffness_n_m in [100.0, 300.0, 1000.0, 2500.0] {
        let trace = run(SimulatedConfig::default(), stiffness_n_m, 14_000);
        let deepest = trace.iter().map(|(_, d, _)| vec3::norm(*d)).fold(0.0, f32::max);
        assert!(deepest > 0.004 && deepest < 0.045, "{stiffness_n_m}: {deepest}");
        // Largest step between two ticks: a stroke is slow, a limit cycle is not.
        let fastest = trace.windows(2).map(|pair| vec3::distance(pair[0].0, pair[1].0)).fold(0.0, f32::max);
        assert!(fastest < 0.6e-3, "{stiffness_n_m}: {fastest} m per tick");
    }
}

#[test]
fn a_persistent_hand_reaches_most_of_the_press_depth() {
    let depth = |persistence| {
        let hand = HandConfig { persistence, tremor_m: 0.0, ..HandConfig::default() };
        let config = SimulatedConfig { hand, ..SimulatedConfig::default() };
        run(config, 200.0, 1_060).iter().map(|(_, d, _)| vec3::norm(*d)).fold(0.0, f32::max)
    };
    let (passive, persistent) = (depth(0.0), depth(0.8));
    assert!(passive < 0.0115 && persistent > 0.0125 && persistent < 0.0165, "{passive} {persistent}");
}

#[test]
fn samples_lie_on_the_encoder_grid() {
    for (position, _, _) in run(SimulatedConfig::default(), 300.0, 500) {
        for metres in position {
            let counts = metres / 30.0e-6;
            assert!((counts - counts.round()).abs() < 1e-2, "{metres}");
        }
    }
}

#[test]
fn it_pushes_and_pulls() {
    let trace = run(SimulatedConfig::default(), 300.0, 7_000);
    let blob = synthetic::organ(&synthetic::Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let normal = organ.spaces[0].active.outward_normal;
    let along: Vec<f32> = trace.iter().map(|(_, _, h)| vec3::dot(*h, normal)).collect();
    assert!(along.iter().copied().fold(0.0, f32::min) < -1.0, "presses into the body");
    assert!(along.iter().copied().fold(0.0, f32::max) > 1.0, "pulls out of it");
}

fn on(profile: &Profile, palpation: Palpation, hand: HandConfig) -> SimulatedHand {
    SimulatedHand::with_palpation(
        palpation,
        SimulatedConfig { hand, ..SimulatedConfig::for_profile(profile) },
    )
}

fn still(at_m: Vec3) -> Palpation {
    // Above the surface, without contact: it stays there for an hour.
    Palpation::Tour(Script::press_and_hold(at_m, [0.0, 0.0, 1.0], -Script::PRESS_FROM_M, 3_600.0))
}

/// A force appears in a sample after one cycle of the loop and the delay of the link in both directions.
#[test]
fn a_force_acts_after_the_delay_of_loop_and_link() {
    let mut profile = Profile::bundled("simulated").expect("bundled");
    (profile.position_delay_us, profile.force_delay_us) = (1_000, 2_000);
    (profile.mechanism.encoder_quantum_m, profile.mechanism.coulomb_n) = (None, None);
    let mut hand = on(&profile, still([0.0, 0.0, 0.05]), HandConfig::LIGHT);
    let seen: Vec<f32> = (1..=9_u64)
        .map(|tick| {
            let force_n = if tick == 1 { [5.0, 0.0, 0.0] } else { vec3::ZERO };
            let sample = hand.exchange(tick * 1_000, force_n).expect("never fails").expect("always samples");
            assert_eq!(sample.t_us, (tick - 1) * 1_000, "its age is the delay of the link");
            sample.position_m[0]
        })
        .collect();
    // Sent at the first exchange, the force acts for 1 ms from 2 ms later and is measured 1 ms after that.
    assert!(seen[..4].iter().all(|x| *x == 0.0), "{seen:?}");
    assert!(seen[4] > 1e-6 && seen[5] > seen[4], "{seen:?}");
    // 5 N on 0.15 kg for 1 ms: 33 mm/s.
    assert!(((seen[5] - seen[4]) / 33.3e-6 - 1.0).abs() < 0.05, "{seen:?}");
}

#[test]
fn a_profile_gives_the_placement_and_the_reach_of_the_hand() {
    let profile = Profile::bundled("falcon").expect("bundled");
    let mut hand = on(&profile, still([0.03, 0.02, 0.01]), HandConfig::default());
    let sample = hand.exchange(2_000, vec3::ZERO).expect("never fails").expect("always samples");
    // Three encoder steps, with a workspace scale of three.
    assert!(vec3::distance(sample.position_m, [0.03, 0.02, 0.015]) < 3.0 * 3.0 * 54e-6, "{sample:?}");
    assert!(vec3::distance(hand.device_position_m(), [0.01, 0.02 / 3.0, 0.125]) < 1e-4);
    // The target is a metre away; the handle stops at 40 mm, which is 120 mm in the model.
    let mut hand = on(&profile, still([1.0, 0.0, 0.0]), HandConfig::default());
    for tick in 0..2_000_u64 {
        let sample = hand.exchange(tick * 1_000, vec3::ZERO).expect("never fails").expect("always samples");
        let away_m = vec3::norm(sample.position_m);
        assert!((0.1195..0.1210).contains(&away_m), "{away_m}");
    }
    let info = hand.info();
    assert_eq!(info.max_force_n, 8.0);
    assert!((info.max_stiffness_n_m - 1_000.0 / 3.0).abs() < 1e-3);
}

/// The work of the motors equals the hand's kinetic energy plus the loss by drag, within one percent.
#[test]
fn the_energy_through_the_handle_is_balanced() {
    let profile = Profile::bundled("simulated").expect("bundled");
    let limp = HandConfig { stiffness_n_m: 0.0, ..HandConfig::LIGHT };
    let mut hand = on(&profile, still([0.0, 0.0, 0.05]), limp);
    for tick in 0..200_u64 {
        hand.exchange(tick * 1_000, [0.5, 0.0, 0.0]).expect("never fails");
    }
    let (work, mass_kg) = (hand.work(), 0.1 + limp.mass_kg);
    let motion_j = 0.5 * f64::from(mass_kg * vec3::norm(hand.hand.velocity_m_s()).powi(2));
    assert!(work.motors_j > 0.01 && work.drag_j < -1e-3, "{work:?}");
    assert!((work.device_j() / motion_j - 1.0).abs() < 0.01, "{work:?}, {motion_j} J of motion");
}
