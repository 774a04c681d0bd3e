//! The tick: force for the hand, limits, faults that latch at zero. Stale samples are in `stale.rs`.

use crate::common::bench::{assert_faults, assert_latched, config, organ_blob, sample};
use palpate_core::{
    Command, Config, Controller, ControllerError, Fault, Method, Organ, Orientation, Phase, Sample, State,
    vec3,
};

#[test]
fn the_hand_gets_minus_h() {
    bench!(bench, config());
    let command = bench.press();
    assert_eq!((command.engaged, command.phase, command.clamped), (Some(0), Phase::Active, false));
    assert_eq!(command.hand_force_n, vec3::scale(command.reaction_n, -1.0));
    let exact = crate::common::force([0.0, 0.0, -5e-3])[2] as f32;
    assert!((command.reaction_n[2] - exact).abs() < 0.1, "{command:?} against {exact}");
    assert!((command.displacement_m[2] + 5e-3).abs() < 1e-7);
    assert!(command.coverage.is_some());
}

#[test]
fn disarmed_means_no_force() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let controller = Controller::new(&organ, config()).expect("packed");
    let mut state = State::new();
    for step in 0..50_u64 {
        let z = 0.001 - 0.0002 * step as f32;
        let command = controller.tick(&mut state, step * 1000, Some(&sample(step * 1000, [0.0, 0.0, z])));
        assert_eq!((command.hand_force_n, command.engaged, command.phase), ([0.0; 3], None, Phase::Disarmed));
        assert_eq!(command.hip_m, [0.0, 0.0, z], "the HIP is reported for the viewer");
    }
    let command = controller.tick(&mut state, 60_000, Some(&sample(60_000, [f32::NAN; 3])));
    assert!(vec3::is_finite(command.hip_m) && command.phase == Phase::Disarmed);
}

/// Where the model would pull a pushing tool in, the tool disengages; below the plane it does not engage
/// again.
#[test]
fn a_pushing_tool_disengages_where_the_model_pulls() {
    bench!(bench, config());
    bench.at([0.0, 0.0, 1e-4]);
    let mut slipped = None;
    for step in 0..150 {
        let x = 1e-4 * step as f32;
        let command = bench.at([x, x, -1e-4]);
        // h_z of the field is about 2000 x y along this path.
        assert!(command.reaction_n[2] <= 0.2, "step {step}: {command:?}");
        match slipped {
            None if command.engaged.is_none() => slipped = Some(step),
            None => {}
            Some(_) => assert_eq!((command.engaged, command.reaction_n), (None, [0.0; 3])),
        }
    }
    assert!(slipped.is_some_and(|step| (80..130).contains(&step)), "{slipped:?}");
}

/// Arming inside the organ engages nothing: contact needs a crossing.
#[test]
fn arming_inside_gives_no_force() {
    bench!(bench, config());
    for _ in 0..100 {
        assert_eq!(bench.at([0.0, 0.0, -5e-3]).hand_force_n, [0.0; 3]);
    }
}

#[test]
fn disarming_is_zero_at_once_and_ends_the_contact() {
    bench!(bench, config());
    bench.press();
    bench.state.disarm();
    assert_eq!(bench.at([0.0, 0.0, -5e-3]).hand_force_n, [0.0; 3]);
    assert!(bench.state.arm());
    assert_eq!(bench.at([0.0, 0.0, -5e-3]).engaged, None);
}

#[test]
fn a_position_that_is_not_finite() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for axis in 0..3 {
            bench!(bench, config());
            bench.press();
            let mut position_m = [0.0, 0.0, -5e-3];
            position_m[axis] = bad;
            let command = bench.at(position_m);
            assert_faults(command, Fault::NotFinite);
            assert_eq!(command.hip_m, [0.0, 0.0, -5e-3], "the last valid one");
            assert_latched(bench, Fault::NotFinite);
        }
    }
}

#[test]
fn an_orientation_that_is_no_rotation() {
    for bad in [[f32::NAN, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [0.0; 4]] {
        bench!(bench, config());
        bench.press();
        let [w, xyz @ ..] = bad;
        let sample =
            Sample { orientation: Orientation { w, xyz }, ..sample(bench.now_us + 1_000, [0.0, 0.0, -5e-3]) };
        bench.now_us += 1_000;
        let command = bench.controller.tick(&mut bench.state, bench.now_us, Some(&sample));
        assert_faults(command, Fault::NotFinite);
    }
}

#[test]
fn out_of_the_workspace() {
    let mut config = config();
    config.limits.max_position_m = 0.04;
    config.limits.max_speed_m_s = 1e6;
    for position_m in [[0.0401, 0.0, 0.0], [0.0, -0.05, 0.0], [0.0, 0.0, 1e30]] {
        bench!(bench, config);
        bench.press();
        assert_faults(bench.at(position_m), Fault::Workspace);
        assert_latched(bench, Fault::Workspace);
    }
}

#[test]
fn faster_than_a_hand() {
    let mut config = config();
    config.limits.max_speed_m_s = 1.0;
    // A jump of 1 cm in one sample: 2.5 m/s over the window.
    bench!(bench, config);
    bench.press();
    assert_faults(bench.at([0.01, 0.0, -5e-3]), Fault::Overspeed);
    assert_latched(bench, Fault::Overspeed);
    // A steady 1.1 m/s is detected within the window; 0.9 m/s is not a fault.
    for (speed, faults) in [(1.1, true), (0.9, false)] {
        bench!(bench, config);
        let mut tripped = None;
        for step in 0..100 {
            let command = bench.at([speed * 1e-3 * step as f32 - 0.05, 0.0, 0.1]);
            if command.phase != Phase::Active && tripped.is_none() {
                tripped = Some(step);
            }
        }
        assert_eq!(tripped.is_some(), faults, "{speed} m/s");
        assert!(tripped.is_none_or(|step| step <= 5), "{tripped:?}");
    }
}

/// Jitter of one encoder count per millisecond is 54 mm/s by finite differences: no fault at half of that.
#[test]
fn a_count_of_jitter_is_no_speed() {
    let mut config = config();
    config.limits.max_speed_m_s = 0.027;
    bench!(bench, config);
    for step in 0..200 {
        let command = bench.at([if step % 2 == 0 { 0.0 } else { 54e-6 }, 0.0, 0.1]);
        assert_eq!(command.phase, Phase::Active, "step {step}");
    }
}

/// The same speed is a fault at every rate of the device.
#[test]
fn overspeed_at_every_sample_rate() {
    for period_us in [125_u64, 250, 500, 1000, 2000, 5000] {
        for (speed, faults) in [(1.2_f32, true), (0.8, false)] {
            let blob = organ_blob();
            let organ = Organ::<2>::read(&blob).expect("good");
            let mut config = config();
            config.limits.max_speed_m_s = 1.0;
            let controller = Controller::new(&organ, config).expect("packed");
            let mut state = State::new();
            assert!(state.arm());
            for step in 0..(50_000 / period_us) {
                let now_us = step * period_us;
                let x = speed * now_us as f32 * 1e-6;
                controller.tick(&mut state, now_us, Some(&sample(now_us, [x, 0.0, 0.1])));
            }
            assert_eq!(
                state.phase() == Phase::SafeZero(Fault::Overspeed),
                faults,
                "{period_us} us, {speed} m/s"
            );
        }
    }
}

#[test]
fn time_that_runs_backwards_is_a_fault() {
    bench!(bench, config());
    bench.press();
    bench.now_us -= 5000;
    assert_faults(bench.at([0.0, 0.0, -5e-3]), Fault::Internal);
}

#[test]
fn the_force_ramps_up_after_arming() {
    let mut config = config();
    config.limits.ramp_s = 0.5;
    bench!(bench, config);
    bench.press();
    let full_n = |command: &Command| vec3::norm(command.reaction_n);
    // 201 ticks since arming, the first at time zero.
    for tick in 201..600 {
        let command = bench.at([0.0, 0.0, -5e-3]);
        let share = (tick as f32 / 500.0).min(1.0);
        let hand_n = vec3::norm(command.hand_force_n);
        assert!((hand_n - share * full_n(&command)).abs() < 1e-4, "tick {tick}: {hand_n}");
    }
}

/// Beyond the limit the force keeps its direction.
#[test]
fn the_clamp_keeps_the_direction() {
    let mut config = config();
    config.limits.max_force_n = 0.5;
    bench!(bench, config);
    let command = {
        for step in 0..100 {
            let step = (step as f32).min(30.0);
            bench.at([0.1e-3 * step, 0.0, 1e-3 - 0.2e-3 * step]);
        }
        bench.at([3e-3, 0.0, -5e-3])
    };
    assert!(command.clamped && vec3::norm(command.hand_force_n) <= 0.5);
    assert!(vec3::norm(command.hand_force_n) > 0.499_99);
    let direction = vec3::normalize_or_zero(vec3::scale(command.reaction_n, -1.0));
    assert!(crate::common::distance(direction, vec3::normalize_or_zero(command.hand_force_n)) < 1e-6);
}

/// The weight of the handle is part of the one sum that the last clamp limits.
#[test]
fn weight_and_organ_together_stay_within_the_limit() {
    let mut config = config();
    (config.limits.max_force_n, config.limits.ramp_s) = (1.0, 0.1);
    config.gravity_compensation_n = [0.0, 0.4, 0.0];
    bench!(bench, config);
    // In free air it rises with the ramp.
    let free: Vec<f32> = (0..200).map(|_| bench.at([0.0, 0.0, 1e-3]).hand_force_n[1]).collect();
    assert!(free.windows(2).all(|pair| pair[1] - pair[0] < 4.1e-3) && free[50] < 0.3, "{free:?}");
    assert_eq!(free[199], 0.4);
    let mut pressed = Command::default();
    for step in 0..120 {
        pressed = bench.at([0.0, 0.0, 1e-3 - 0.1e-3 * step as f32]);
        assert!(vec3::norm(pressed.hand_force_n) <= 1.0, "{pressed:?}");
    }
    assert!(pressed.clamped && vec3::norm(pressed.hand_force_n) > 0.999, "{pressed:?}");
    assert!(pressed.hand_force_n[1] > 0.3 && pressed.hand_force_n[2] > 0.8, "{pressed:?}");
    bench.state.trip(Fault::Watchdog);
    assert_eq!(bench.at([0.0, 0.0, 1e-3]).hand_force_n, vec3::ZERO);
}

#[test]
fn the_controller_refuses_invalid_configurations() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(&blob).expect("good");
    let refused = |config| Controller::new(&organ, config).expect_err("refused");
    assert_eq!(
        refused(Config::new(Method::RbfCubic)),
        ControllerError::MissingMethod { method: Method::RbfCubic, space: 0 }
    );
    for bad in [f32::NAN, f32::INFINITY, -1.0, 0.0] {
        let mut wrong = config();
        wrong.limits.max_force_n = bad;
        assert_eq!(refused(wrong), ControllerError::Config { what: "max_force_n" });
        let mut wrong = config();
        wrong.limits.max_slew_n_per_s = bad;
        assert_eq!(refused(wrong), ControllerError::Config { what: "max_slew_n_per_s" });
        let mut wrong = config();
        wrong.contact.capture_radius_m = bad;
        assert_eq!(refused(wrong), ControllerError::Config { what: "capture_radius_m" });
    }
    let mut wrong = config();
    wrong.limits.ramp_s = f32::NAN;
    assert_eq!(refused(wrong), ControllerError::Config { what: "ramp_s" });
    let mut wrong = config();
    wrong.limits.stale_fault_us = 0;
    assert_eq!(refused(wrong), ControllerError::Config { what: "stale_fault_us" });
    let mut wrong = config();
    wrong.passivity.position_step_m = -1.0;
    assert_eq!(refused(wrong), ControllerError::Config { what: "position_step_m" });
    for bad in [4.1, f32::NAN, f32::INFINITY] {
        let mut wrong = config();
        wrong.gravity_compensation_n[2] = bad;
        assert_eq!(refused(wrong), ControllerError::Config { what: "gravity_compensation_n" }, "{bad}");
    }
    // An infinite value means no limit; zero and NaN are refused.
    for (limit, is_sound) in [(f32::INFINITY, true), (3e3, true), (0.0, false), (f32::NAN, false)] {
        let mut wrong = config();
        wrong.limits.max_stiffness_n_m = limit;
        let error = ControllerError::Config { what: "max_stiffness_n_m" };
        assert_eq!(Controller::new(&organ, wrong).err(), (!is_sound).then_some(error), "{limit}");
    }
}
