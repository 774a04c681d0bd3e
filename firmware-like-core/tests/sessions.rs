//! Random sessions: the limits hold for any input, and equal inputs give equal commands.

use crate::common::bench::{config, organ_blob};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Controller, Method, Organ, Phase, Sample, State};
use proptest::prelude::*;

/// One step of a random session.
#[derive(Debug, Clone)]
enum Step {
    Sample { elapsed_us: u64, age_us: i64, position_m: Vec3, buttons: u32 },
    Move { elapsed_us: u64, by_m: Vec3, buttons: u32 },
    Nothing { elapsed_us: u64 },
    Arm,
    Disarm,
    Reset,
}

fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        20 => -0.03_f32..0.03,
        1 => any::<f32>(),
        1 => Just(f32::NAN),
        1 => Just(0.0),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    let elapsed = prop_oneof![20 => 900_u64..1100, 1 => 0_u64..30_000, 1 => Just(0)];
    let buttons = prop_oneof![Just(0_u32), Just(1), any::<u32>()];
    let small = -1.5e-3_f32..1.5e-3;
    prop_oneof![
        2 => (elapsed.clone(), -2000_i64..20_000, [coordinate(), coordinate(), coordinate()], buttons.clone())
            .prop_map(|(elapsed_us, age_us, position_m, buttons)| Step::Sample { elapsed_us, age_us, position_m, buttons }),
        100 => (elapsed.clone(), [small.clone(), small.clone(), small], buttons)
            .prop_map(|(elapsed_us, by_m, buttons)| Step::Move { elapsed_us, by_m, buttons }),
        5 => elapsed.prop_map(|elapsed_us| Step::Nothing { elapsed_us }),
        5 => Just(Step::Arm),
        1 => Just(Step::Disarm),
        5 => Just(Step::Reset),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// The force is finite and within the limit. Its slew is within the limit too, unless the force becomes
    /// zero. It is zero after faults. A second state with the same steps gives the same commands, bit for
    /// bit.
    #[test]
    fn limits_hold_for_any_input(
        steps in prop::collection::vec(step(), 1..400),
        method in prop::sample::select(vec![Method::Trilinear, Method::Tricubic, Method::Hybrid]),
        max_force_n in prop_oneof![Just(8.0_f32), 0.01_f32..20.0],
        max_slew_n_per_s in prop_oneof![Just(1000.0_f32), 1.0_f32..5000.0],
    ) {
        let blob = organ_blob();
        let organ = Organ::<2>::read(&blob).expect("good");
        let mut config = config();
        config.method = Some(method);
        config.limits.max_force_n = max_force_n;
        config.limits.max_slew_n_per_s = max_slew_n_per_s;
        config.limits.max_speed_m_s = 3.0;
        let controller = Controller::new(&organ, config).expect("packed");
        let (mut state, mut twin) = (State::new(), State::new());
        let mut now_us = 1_000_000_u64;
        let mut hip_m = [0.0, 0.0, 1e-3];
        let mut last_n = [0.0_f32; 3];
        for step in steps {
            let (elapsed_us, sample) = match step {
                Step::Arm => { state.arm(); twin.arm(); continue }
                Step::Disarm => { state.disarm(); twin.disarm(); continue }
                Step::Reset => { state.reset(); twin.reset(); continue }
                Step::Nothing { elapsed_us } => (elapsed_us, None),
                Step::Move { elapsed_us, by_m, buttons } => {
                    hip_m = vec3::add(hip_m, by_m);
                    let t_us = now_us + elapsed_us;
                    (elapsed_us, Some(Sample { t_us, position_m: hip_m, buttons, ..Sample::default() }))
                }
                Step::Sample { elapsed_us, age_us, position_m, buttons } => {
                    let t_us = (now_us + elapsed_us).saturating_add_signed(-age_us);
                    (elapsed_us, Some(Sample { t_us, position_m, buttons, ..Sample::default() }))
                }
            };
            now_us += elapsed_us;
            let before = state.phase();
            let command = controller.tick(&mut state, now_us, sample.as_ref());
            prop_assert_eq!(command, controller.tick(&mut twin, now_us, sample.as_ref()));

            let force_n = command.hand_force_n;
            prop_assert!(vec3::is_finite(force_n) && vec3::is_finite(command.reaction_n));
            prop_assert!(vec3::is_finite(command.hip_m) && vec3::is_finite(command.displacement_m));
            let norm_n = force_n.map(f64::from).iter().map(|x| x * x).sum::<f64>().sqrt();
            prop_assert!(norm_n <= f64::from(max_force_n), "{norm_n} > {max_force_n}");
            prop_assert_eq!(command.phase, state.phase());
            if command.phase != Phase::Active {
                prop_assert_eq!(force_n, [0.0; 3]);
            }
            if matches!(before, Phase::SafeZero(_)) {
                prop_assert_eq!(command.phase, before);
            }
            if force_n != [0.0; 3] {
                let change_n = f64::from(crate::common::distance(force_n, last_n));
                let allowed_n = f64::from(max_slew_n_per_s) * elapsed_us as f64 * 1e-6;
                // f32 rounding of forces up to the limit.
                let rounding_n = f64::from(max_force_n) * 4e-7;
                prop_assert!(change_n <= allowed_n * 1.000_001 + rounding_n, "{change_n} > {allowed_n}");
            }
            last_n = force_n;
            if !vec3::is_finite(hip_m) || vec3::max_abs(hip_m) > 0.1 {
                hip_m = [0.0, 0.0, 1e-3];
            }
        }
    }
}

/// A random walk engages, disengages and reaches the force limit, otherwise the sessions would prove nothing.
#[test]
fn a_random_walk_reaches_every_state() {
    bench!(bench, {
        let mut config = config();
        config.limits.max_force_n = 0.6;
        config
    });
    let mut random = crate::common::Random(21);
    let mut hip_m = [0.0, 0.0, 1e-3];
    let (mut engaged, mut free, mut clamped) = (0, 0, 0);
    for _ in 0..20_000 {
        hip_m = vec3::add(vec3::scale(hip_m, 0.98), random.point(1.2e-3));
        let command = bench.at(hip_m);
        assert_eq!(command.phase, Phase::Active);
        engaged += usize::from(command.engaged.is_some());
        free += usize::from(command.engaged.is_none());
        clamped += usize::from(command.clamped);
    }
    assert!(engaged > 1000 && free > 1000 && clamped > 100, "{engaged} {free} {clamped}");
}
