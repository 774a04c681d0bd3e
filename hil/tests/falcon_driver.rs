//! The real driver of the Falcon on the emulated device in memory: homing after a replug, calibration, weight
//! compensation, held torques.

use palpate_core::{Method, Organ, Phase, Vec3, vec3};
use palpate_hil::contract::CHECKS;
use palpate_hil::falcon::grip::NM_PER_MOTOR_COUNT;
use palpate_hil::fault::FaultKind;
use palpate_hil::rig::{FalconRig, Rig, RigKind};
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

/// The cable is pulled and plugged in again; the board keeps its power and its homing. The driver that is
/// opened then treats it as not homed, and gives neither a force nor a sample until the user homes the grip.
#[test]
fn a_replugged_falcon_is_homed_again_before_it_renders() {
    let mut rig = FalconRig::new(3);
    let (middle_m, workspace) = (rig.traits().middle_m, rig.profile().workspace);
    {
        let mut session = Session::homed(&mut rig, workspace).expect("homing succeeds");
        session.tick([0.0, 0.0, 2.0]).expect("a link");
        session.rig.inject(FaultKind::Replug);
        session.pass(5_000);
        session.rig.replug();
    }
    assert!(rig.force_record().force_n[2] > 1.0, "the device has no watchdog, which is the hazard");
    let mut session = Session::open(&mut rig, workspace).expect("it is plugged in");
    assert_eq!(session.rig.force_record().force_n, vec3::ZERO, "opening removes the force");
    session.rig.reset_record();
    // The hand moves without homing the grip.
    session.rig.follow(vec![
        at(0, middle_m),
        at(300_000, vec3::sub(middle_m, [0.0, 0.01, 0.01])),
        at(600_000, middle_m),
    ]);
    for _ in 0..1_500 {
        assert_eq!(session.tick([3.0, -2.0, 4.0]), Ok(None), "a sample before homing");
        assert_ne!(session.state(), DeviceState::Homed);
    }
    assert_eq!((session.state(), session.rig.force_record().largest_motor), (DeviceState::Unhomed, 0));
    let out_m = vec3::add(middle_m, [0.0, 0.0, 0.025]);
    session.rig.follow(vec![at(0, middle_m), at(200_000, out_m), at(300_000, out_m), at(400_000, middle_m)]);
    for _ in 0..1_000 {
        session.tick([0.0, 0.0, 2.0]).expect("a link");
    }
    assert_eq!(session.state(), DeviceState::Homed);
    assert!(
        session.rig.force_record().force_n[2] > 1.5 && session.rig.force_record().largest_unhomed_n == 0.0
    );
}

/// Three motors with different scales, one of them with reversed sign.
const ODD_NM_PER_COUNT: [f64; 3] = [-1.25e-4, 1e-4, -0.8e-4];

fn calibrated() -> Box<dyn Rig> {
    let mut profile = falcon();
    profile.calibration.counts_per_n_m = ODD_NM_PER_COUNT.map(|nm| nm.recip() as f32);
    Box::new(FalconRig::calibrated(ODD_NM_PER_COUNT, profile))
}

#[test]
fn a_profile_corrects_the_scale_and_sign_of_the_motors() {
    let forces = CHECKS.iter().find(|check| check.name.starts_with("forces arrive")).expect("a check");
    let corrected = RigKind { name: "calibrated", in_memory: true, make: |_| calibrated() };
    assert_eq!(forces.run(corrected), Ok(()));
    let odd = |_| -> Box<dyn Rig> { Box::new(FalconRig::calibrated(ODD_NM_PER_COUNT, falcon())) };
    let seen = forces.run(RigKind { name: "odd", in_memory: true, make: odd });
    assert!(seen.is_err(), "a reversed motor is detected");
    let turned = |_| -> Box<dyn Rig> {
        let mut profile = falcon();
        profile.calibration.counts_per_n_m = [1e4; 3];
        Box::new(FalconRig::calibrated(NM_PER_MOTOR_COUNT, profile))
    };
    let seen = forces.run(RigKind { name: "turned", in_memory: true, make: turned });
    assert!(seen.is_err(), "a wrong sign in the profile is detected");
}

/// The command exceeds 8 N while the grip moves at up to 1 m/s, so that its Jacobian changes.
#[test]
fn held_torques_stay_within_the_limit_while_the_grip_moves() {
    let mut largest_n: f32 = 0.0;
    let mut fastest_m_s: f32 = 0.0;
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
        for along in 0..3 {
            let mut rig = FalconRig::new(5);
            let (middle_m, limit_n) = (rig.traits().middle_m, rig.profile().max_force_n);
            let (workspace, max_n) = (rig.profile().workspace, limit_n + rig.traits().motor_step_n);
            let mut session = Session::homed(&mut rig, workspace).expect("homing succeeds");
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
            let felt_n = session.rig.force_record().largest_force_n;
            assert!(
                felt_n <= max_n,
                "{felt_n} N of {limit_n} with {force_n:?} requested and motion along {along}"
            );
            // A single motor at its maximum, 0.41 N m, does not give 8 N in every direction.
            assert!(felt_n > 0.75 * limit_n, "{felt_n} N: reduced more than necessary");
            largest_n = largest_n.max(felt_n);
            for pair in session.truth().windows(2) {
                let metres = vec3::distance(pair[0].1, pair[1].1);
                fastest_m_s =
                    fastest_m_s.max(metres * 1e6 / pair[1].0.saturating_sub(pair[0].0).max(1) as f32);
            }
        }
    }
    println!("largest {largest_n:.3} N, fastest {fastest_m_s:.2} m/s");
    assert!(fastest_m_s > 0.5, "{fastest_m_s} m/s is too slow");
}

/// Runs `test` with the hand deep in the organ, under a force.
fn in_contact(seed: u64, test: impl FnOnce(&mut Bench<'_, '_>)) {
    let mut rig = FalconRig::new(seed);
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("valid");
    session::with_loop(&mut rig, &organ, Method::Energy, |bench| {
        let path = session::press(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        bench.controls.arm();
        bench.run(700).expect("a fault-free link");
        assert!(vec3::norm(bench.rig.force_record().force_n) > 0.3, "no contact force");
        bench.rig.reset_record();
        test(bench);
    })
    .expect("homing succeeds");
}

/// An encoder miscounts permanently while the hand presses on the organ. The wrong position is accepted
/// neither at once nor later.
#[test]
fn an_encoder_jump_removes_the_force_permanently() {
    for axis in 0..3 {
        for by_m in [0.005, -0.005, 0.015, -0.015, 0.030, -0.030] {
            in_contact(7, |bench| {
                let case = format!("{by_m} m on {axis}");
                let before_n = vec3::norm(bench.rig.force_record().force_n);
                bench.rig.jump_encoder(axis, by_m);
                let records = bench.run(8).expect("the device stays connected");
                assert!(matches!(records[7].phase, Phase::SafeZero(_)), "{case}: {:?}", records[7].phase);
                assert_eq!(records[7].device, DeviceState::Unhomed, "{case}");
                let felt = bench.rig.force_record();
                assert_eq!(felt.force_n, vec3::ZERO, "{case}");
                assert!(felt.largest_force_n < before_n + 0.5, "{case}: {} N", felt.largest_force_n);
                bench.rig.reset_record();
                for tick in 0..1_500 {
                    if tick % 100 == 50 {
                        bench.controls.reset();
                    }
                    if tick % 100 == 60 {
                        bench.controls.arm();
                    }
                    let record = bench.step().expect("the device stays connected");
                    assert_ne!(record.phase, Phase::Active, "{case}: tick {tick}");
                    assert_eq!(record.sample, None, "{case}: tick {tick}");
                }
                assert_eq!(bench.rig.force_record().largest_motor, 0, "{case}: the force returned");
            });
        }
    }
}

/// Occasional corrupted replies must not look like a miscount.
#[test]
fn corrupted_replies_do_not_end_the_homing() {
    for seed in 0..20 {
        in_contact(seed, |bench| {
            bench.rig.set_faults(Faults::NONE, Faults { corrupt: 0.05, ..Faults::NONE });
            bench.run(500).expect("a transient fault");
            assert!(bench.rig.counts().corrupted > 5);
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
            // A flipped homing flag latches too, but the homing stays.
            let records = bench.run(20).expect("a fault-free link");
            assert_eq!(records[19].device, DeviceState::Homed, "seed {seed}");
            assert!(records[19].sample.is_some(), "seed {seed}");
        });
    }
}

const WEIGHT_N: f32 = 0.7;

/// Runs `test` with the hand above the organ, where the only force is the compensated weight of the grip.
fn with_weight_compensation(test: impl FnOnce(&mut Bench<'_, '_>)) {
    let mut profile = falcon();
    profile.calibration.gravity_n = WEIGHT_N;
    let mut rig = FalconRig::calibrated(NM_PER_MOTOR_COUNT, profile);
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).expect("valid");
    session::with_loop(&mut rig, &organ, Method::Energy, |bench| {
        let middle_m = bench.rig.traits().middle_m;
        bench.rig.follow(vec![at(0, middle_m), at(100_000, vec3::add(middle_m, [0.0, 0.0, 0.01]))]);
        let records = bench.run(300).expect("a fault-free link");
        assert!(records.iter().all(|record| record.phase == Phase::Disarmed));
        assert_eq!(bench.rig.force_record().largest_motor, 0, "no weight compensation before arming");
        bench.controls.arm();
        let records = bench.run(600).expect("a fault-free link");
        let felt = bench.rig.force_record();
        let recorded = records.last().map(|record| record.hand_force_n).expect("records");
        assert!((vec3::norm(recorded) - WEIGHT_N).abs() < 1e-6, "{recorded:?}: what is sent is recorded");
        let error_n = vec3::distance(felt.force_n, [0.0, WEIGHT_N, 0.0]);
        assert!(error_n < 0.02, "{:?} N: up is the device's +y", felt.force_n);
        assert!(
            felt.largest_step_n < 0.02,
            "the force must fade in without a jump: {} N",
            felt.largest_step_n
        );
        test(bench);
    })
    .expect("homing succeeds");
}

#[test]
fn the_weight_is_compensated_while_armed_and_not_after_a_fault() {
    with_weight_compensation(|bench| {
        bench.controls.disarm();
        bench.run(2).expect("a fault-free link");
        assert_eq!(bench.rig.force_record().force_n, vec3::ZERO, "disarmed");
    });
    with_weight_compensation(|bench| {
        bench.rig.inject(FaultKind::HomingLost);
        bench.run(4).expect("a fault-free link");
        assert_eq!(bench.rig.force_record().force_n, vec3::ZERO, "homing is lost");
    });
    with_weight_compensation(|bench| {
        bench.rig.set_faults(Faults::NONE, Faults { drop: 1.0, ..Faults::NONE });
        let records = bench.run(8).expect("a transient fault");
        assert!(records.iter().all(|record| record.phase == Phase::Active), "silence, and no fault yet");
        assert_eq!(
            bench.rig.force_record().force_n,
            vec3::ZERO,
            "it is held for three ticks, like the model's force"
        );
        bench.run(40).expect("a transient fault");
        bench.rig.set_faults(Faults::NONE, Faults::NONE);
        bench.run(100).expect("a fault-free link");
        assert_eq!(bench.rig.force_record().force_n, vec3::ZERO, "latched");
    });
    with_weight_compensation(|bench| {
        bench.end();
        assert_eq!(bench.rig.force_record().force_n, vec3::ZERO, "the loop has ended");
    });
}
