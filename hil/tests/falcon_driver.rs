//! The real driver of the Falcon on the emulated one in memory: homing after a replug, calibration, the weight of the grip, held torques.

use palpate_core::{Method, Organ, Phase, Vec3, vec3};
use palpate_hil::contract::CHECKS;
use palpate_hil::falcon::grip::NM_PER_MOTOR_COUNT;
use palpate_hil::rig::{Cut, FalconRig, Kind, Mishap, Rig};
use palpate_hil::session::{self, Bench, Session};
use palpate_hil::{Faults, Waypoint};
use palpate_host::device::DeviceState;
use palpate_host::device::profile::Profile;

fn falcon() -> Profile {
    Profile::bundled("falcon").expect("bundled")
}

fn at(t_us: u64, position_m: Vec3) -> Waypoint {
    Waypoint { t_us, position_m }
}

/// The cable is pulled and put in again; the board keeps its power and its homing. Opened anew the driver knows of no homing, and gives neither a
/// force nor a sample, until the user has homed the grip in front of it.
#[test]
fn a_falcon_that_kept_its_homing_is_homed_again_before_it_may_push() {
    let mut rig = FalconRig::new(3);
    let (middle_m, workspace) = (rig.traits().middle_m, rig.profile().workspace);
    {
        let mut session = Session::homed(&mut rig, workspace).expect("it is homed");
        session.tick([0.0, 0.0, 2.0]).expect("a link");
        session.rig.unplug(Cut::Between);
        session.pass(5_000);
        session.rig.replug();
    }
    assert!(rig.felt().force_n[2] > 1.0, "it has no watchdog: this is the hazard");
    let mut session = Session::open(&mut rig, workspace).expect("it is there");
    assert_eq!(session.rig.felt().force_n, vec3::ZERO, "opening takes the force away");
    session.rig.forget();
    // A hand that moves about and does not home it.
    session.rig.follow(vec![
        at(0, middle_m),
        at(300_000, vec3::sub(middle_m, [0.0, 0.01, 0.01])),
        at(600_000, middle_m),
    ]);
    for _ in 0..1_500 {
        assert_eq!(
            session.tick([3.0, -2.0, 4.0]),
            Ok(None),
            "a sample of a place that nobody has seen homed"
        );
        assert_ne!(session.state(), DeviceState::Homed);
    }
    assert_eq!((session.state(), session.rig.felt().largest_motor), (DeviceState::Unhomed, 0));
    let out_m = vec3::add(middle_m, [0.0, 0.0, 0.025]);
    session.rig.follow(vec![at(0, middle_m), at(200_000, out_m), at(300_000, out_m), at(400_000, middle_m)]);
    for _ in 0..1_000 {
        session.tick([0.0, 0.0, 2.0]).expect("a link");
    }
    assert_eq!(session.state(), DeviceState::Homed);
    assert!(session.rig.felt().force_n[2] > 1.5 && session.rig.felt().largest_unhomed_n == 0.0);
}

/// Three motors of different makes, one of them turned round.
const ODD_NM_PER_COUNT: [f64; 3] = [-1.25e-4, 1e-4, -0.8e-4];

fn calibrated() -> Box<dyn Rig> {
    let mut profile = falcon();
    profile.calibration.counts_per_n_m = ODD_NM_PER_COUNT.map(|nm| nm.recip() as f32);
    Box::new(FalconRig::calibrated(ODD_NM_PER_COUNT, profile))
}

#[test]
fn a_profile_mends_motors_of_another_scale_and_sign() {
    let forces = CHECKS.iter().find(|check| check.name.starts_with("forces arrive")).expect("a check");
    let mended = Kind { name: "calibrated", in_memory: true, make: |_| calibrated() };
    assert_eq!(forces.run(mended), Ok(()));
    let odd = |_| -> Box<dyn Rig> { Box::new(FalconRig::calibrated(ODD_NM_PER_COUNT, falcon())) };
    let seen = forces.run(Kind { name: "odd", in_memory: true, make: odd });
    assert!(seen.is_err(), "a motor that is turned round is seen");
    let turned = |_| -> Box<dyn Rig> {
        let mut profile = falcon();
        profile.calibration.counts_per_n_m = [1e4; 3];
        Box::new(FalconRig::calibrated(NM_PER_MOTOR_COUNT, profile))
    };
    let seen = forces.run(Kind { name: "turned", in_memory: true, make: turned });
    assert!(seen.is_err(), "and a sign that is wrong in the profile");
}

/// What is asked is eight newtons and more, the grip goes at up to a metre a second, and its Jacobian with it.
#[test]
fn torques_that_are_held_stay_within_the_limit_while_the_grip_moves() {
    let mut largest_n: f32 = 0.0;
    let mut fastest_m_s: f32 = 0.0;
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
        for along in 0..3 {
            let mut rig = FalconRig::new(5);
            let (middle_m, limit_n) = (rig.traits().middle_m, rig.profile().max_force_n);
            let (workspace, most_n) = (rig.profile().workspace, limit_n + rig.traits().motor_step_n);
            let mut session = Session::homed(&mut rig, workspace).expect("it is homed");
            let away = |reach_m: f32| {
                let mut to_m = middle_m;
                to_m[along] += reach_m;
                to_m
            };
            let turns =
                (0..12_u64).map(|i| at(60_000 * i, away(if i.is_multiple_of(2) { 0.02 } else { -0.02 })));
            session.rig.follow(turns.collect());
            let mut force_n = vec3::ZERO;
            force_n[axis] = sign * 20.0;
            for _ in 0..720 {
                let _ = session.tick(force_n);
            }
            let felt_n = session.rig.felt().largest_force_n;
            assert!(
                felt_n <= most_n,
                "{felt_n} N of {limit_n} with {force_n:?} asked for and moved along {along}"
            );
            // A single motor at its most, 0.41 N m, is no eight newtons in every direction.
            assert!(felt_n > 0.75 * limit_n, "{felt_n} N: shortened more than it needs");
            largest_n = largest_n.max(felt_n);
            for pair in session.truth().windows(2) {
                let metres = vec3::distance(pair[0].1, pair[1].1);
                fastest_m_s =
                    fastest_m_s.max(metres * 1e6 / pair[1].0.saturating_sub(pair[0].0).max(1) as f32);
            }
        }
    }
    println!("largest {largest_n:.3} N, fastest {fastest_m_s:.2} m/s");
    assert!(fastest_m_s > 0.5, "{fastest_m_s} m/s is no motion");
}

/// Deep in the organ with a force on the hand, then `test`.
fn leaning(seed: u64, test: impl FnOnce(&mut Bench<'_, '_>)) {
    let mut rig = FalconRig::new(seed);
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("sound");
    session::with_loop(&mut rig, &organ, Method::Energy, |bench| {
        let path = session::press(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        bench.controls.arm();
        bench.run(700).expect("a sound link");
        assert!(vec3::norm(bench.rig.felt().force_n) > 0.3, "it leans on nothing");
        bench.rig.forget();
        test(bench);
    })
    .expect("it is homed");
}

/// An encoder miscounts while the hand leans on the organ, and goes on miscounting. The false place is neither taken at once nor a little later.
#[test]
fn an_encoder_that_jumps_ends_the_force_for_good() {
    for axis in 0..3 {
        for by_m in [0.005, -0.005, 0.015, -0.015, 0.030, -0.030] {
            leaning(7, |bench| {
                let case = format!("{by_m} m on {axis}");
                let before_n = vec3::norm(bench.rig.felt().force_n);
                assert!(bench.rig.strike(Mishap::EncoderJump { axis, by_m }));
                let records = bench.run(8).expect("a fault, and a device that is there");
                assert!(matches!(records[7].phase, Phase::SafeZero(_)), "{case}: {:?}", records[7].phase);
                assert_eq!(records[7].device, DeviceState::Unhomed, "{case}");
                let felt = bench.rig.felt();
                assert_eq!(felt.force_n, vec3::ZERO, "{case}");
                assert!(felt.largest_force_n < before_n + 0.5, "{case}: {} N", felt.largest_force_n);
                bench.rig.forget();
                for tick in 0..1_500 {
                    if tick % 100 == 50 {
                        bench.controls.reset();
                    }
                    if tick % 100 == 60 {
                        bench.controls.arm();
                    }
                    let record = bench.step().expect("a device that is there");
                    assert_ne!(record.phase, Phase::Active, "{case}: tick {tick}");
                    assert_eq!(record.sample, None, "{case}: tick {tick}");
                }
                assert_eq!(bench.rig.felt().largest_motor, 0, "{case}: it comes back");
            });
        }
    }
}

/// Replies that are damaged now and then are no encoder that miscounts.
#[test]
fn damaged_replies_do_not_end_the_homing() {
    for seed in 0..20 {
        leaning(seed, |bench| {
            bench.rig.set_faults(Faults::NONE, Faults { corrupt: 0.05, ..Faults::NONE });
            bench.run(500).expect("a passing fault");
            assert!(bench.rig.counts().corrupted > 5);
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
            // A flipped bit of the homing latches as well, but passes.
            let records = bench.run(20).expect("a sound link");
            assert_eq!(records[19].device, DeviceState::Homed, "seed {seed}");
            assert!(records[19].sample.is_some(), "seed {seed}");
        });
    }
}

const WEIGHT_N: f32 = 0.7;

/// Held above the organ, so that the weight of the grip is all there is to carry.
fn carrying(test: impl FnOnce(&mut Bench<'_, '_>)) {
    let mut profile = falcon();
    profile.calibration.gravity_n = WEIGHT_N;
    let mut rig = FalconRig::calibrated(NM_PER_MOTOR_COUNT, profile);
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("sound");
    session::with_loop(&mut rig, &organ, Method::Energy, |bench| {
        let middle_m = bench.rig.traits().middle_m;
        bench.rig.follow(vec![at(0, middle_m), at(100_000, vec3::add(middle_m, [0.0, 0.0, 0.01]))]);
        let records = bench.run(300).expect("a sound link");
        assert!(records.iter().all(|record| record.phase == Phase::Disarmed));
        assert_eq!(bench.rig.felt().largest_motor, 0, "nothing is carried before it is armed");
        bench.controls.arm();
        bench.run(600).expect("a sound link");
        let felt = bench.rig.felt();
        let off_n = vec3::distance(felt.force_n, [0.0, WEIGHT_N, 0.0]);
        assert!(off_n < 0.02, "{:?} N: up is the device's +y", felt.force_n);
        assert!(felt.largest_step_n < 0.02, "it rises, it does not jump: {} N", felt.largest_step_n);
        test(bench);
    })
    .expect("it is homed");
}

#[test]
fn the_weight_of_the_grip_is_carried_while_it_is_armed_and_dropped_with_every_fault() {
    carrying(|bench| {
        bench.controls.disarm();
        bench.run(2).expect("a sound link");
        assert_eq!(bench.rig.felt().force_n, vec3::ZERO, "disarmed");
    });
    carrying(|bench| {
        bench.rig.strike(Mishap::LoseHoming);
        bench.run(4).expect("a sound link");
        assert_eq!(bench.rig.felt().force_n, vec3::ZERO, "homing is lost");
    });
    carrying(|bench| {
        bench.rig.set_faults(Faults::NONE, Faults { drop: 1.0, ..Faults::NONE });
        let records = bench.run(8).expect("a passing fault");
        assert!(records.iter().all(|record| record.phase == Phase::Active), "silence, and no fault yet");
        assert_eq!(
            bench.rig.felt().force_n,
            vec3::ZERO,
            "it goes with the model's force: three ticks are held"
        );
        bench.run(40).expect("a passing fault");
        bench.rig.set_faults(Faults::NONE, Faults::NONE);
        bench.run(100).expect("a sound link");
        assert_eq!(bench.rig.felt().force_n, vec3::ZERO, "latched");
    });
    carrying(|bench| {
        bench.end();
        assert_eq!(bench.rig.felt().force_n, vec3::ZERO, "the loop has ended");
    });
}
