//! The tick: faults latch at zero, limits hold whatever comes in, and the same input gives the same output.

mod common;

use common::{Aligned, Recipe};
use palpate_core::controller::ControllerError;
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Command, Config, Controller, Fault, Method, Organ, Phase, Sample, State};
use proptest::prelude::*;

fn organ_blob() -> Aligned {
    Recipe { nodes: vec![[0.0; 3], [0.05, 0.0, 0.0]], radius_m: 0.03, rbf: false, ..Recipe::default() }.blob()
}

fn config() -> Config {
    let mut config = Config::new(Method::Hybrid);
    config.limits.ramp_s = 0.0;
    config
}

fn sample(t_us: u64, position_m: Vec3) -> Sample {
    Sample { t_us, position_m, buttons: 0 }
}

/// Runs ticks of 1 ms with the same sample position function; returns the commands.
struct Bench<'o, 'a> {
    controller: Controller<'o, 'a, 2>,
    state: State,
    now_us: u64,
}

impl<'o, 'a> Bench<'o, 'a> {
    fn new(organ: &'o Organ<'a, 2>, config: Config) -> Self {
        let controller = Controller::new(organ, config).expect("the method is packed");
        let mut bench = Self { controller, state: State::new(), now_us: 1_000_000 };
        assert!(bench.state.arm());
        bench
    }

    fn at(&mut self, position_m: Vec3) -> Command {
        self.now_us += 1000;
        let sample = sample(self.now_us, position_m);
        self.controller.tick(&mut self.state, self.now_us, Some(&sample))
    }

    fn without_sample(&mut self) -> Command {
        self.now_us += 1000;
        self.controller.tick(&mut self.state, self.now_us, None)
    }

    /// Presses 5 mm deep at 0.2 m/s and stays; the force is steady at the end.
    fn press(&mut self) -> Command {
        for step in 0..200 {
            self.at([0.0, 0.0, 1e-3 - 0.2e-3 * (step as f32).min(30.0)]);
        }
        let command = self.at([0.0, 0.0, -5e-3]);
        assert!(command.reaction_n[2] < -0.5 && command.hand_force_n[2] > 0.0, "pressed: {command:?}");
        command
    }
}

macro_rules! bench {
    ($bench:ident, $config:expr) => {
        let blob = organ_blob();
        let organ = Organ::read(blob.bytes()).expect("good");
        let mut $bench = Bench::new(&organ, $config);
    };
}

#[test]
fn the_hand_gets_minus_h() {
    bench!(bench, config());
    let command = bench.press();
    assert_eq!((command.engaged, command.phase, command.clamped), (Some(0), Phase::Active, false));
    assert_eq!(command.hand_force_n, vec3::neg(command.reaction_n));
    let exact = common::force([0.0, 0.0, -5e-3])[2] as f32;
    assert!((command.reaction_n[2] - exact).abs() < 0.1, "{command:?} against {exact}");
    assert!((command.displacement_m[2] + 5e-3).abs() < 1e-7);
    assert!(command.coverage.is_some());
}

#[test]
fn disarmed_means_no_force() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(blob.bytes()).expect("good");
    let controller = Controller::new(&organ, config()).expect("packed");
    let mut state = State::new();
    for step in 0..50_u64 {
        let z = 0.001 - 0.0002 * step as f32;
        let command = controller.tick(&mut state, step * 1000, Some(&sample(step * 1000, [0.0, 0.0, z])));
        assert_eq!((command.hand_force_n, command.engaged, command.phase), ([0.0; 3], None, Phase::Disarmed));
        assert_eq!(command.hip_m, [0.0, 0.0, z], "the viewer sees the tool");
    }
    let command = controller.tick(&mut state, 60_000, Some(&sample(60_000, [f32::NAN; 3])));
    assert!(vec3::is_finite(command.hip_m) && command.phase == Phase::Disarmed);
}

/// Sliding along the surface until the model would pull the tool in: a pushing tool slips off, and stays off below the plane.
#[test]
fn a_pushing_tool_slips_off_where_the_model_pulls() {
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

/// Arming deep inside the organ must not snap: contact needs a crossing.
#[test]
fn arming_inside_gives_no_force() {
    bench!(bench, config());
    for _ in 0..100 {
        assert_eq!(bench.at([0.0, 0.0, -5e-3]).hand_force_n, [0.0; 3]);
    }
}

#[test]
fn disarming_is_zero_at_once_and_forgets_the_contact() {
    bench!(bench, config());
    bench.press();
    bench.state.disarm();
    assert_eq!(bench.at([0.0, 0.0, -5e-3]).hand_force_n, [0.0; 3]);
    assert!(bench.state.arm());
    assert_eq!(bench.at([0.0, 0.0, -5e-3]).engaged, None);
}

/// Zero in the same tick, and latched: neither good samples nor arming alone bring the force back.
fn assert_latched(mut bench: Bench<'_, '_>, fault: Fault) {
    assert_eq!(bench.state.phase(), Phase::SafeZero(fault));
    for step in 0..100 {
        let command = bench.at([0.0, 0.0, 1e-3 - 0.1e-3 * step as f32]);
        assert_eq!((command.hand_force_n, command.phase), ([0.0; 3], Phase::SafeZero(fault)));
        assert!(!bench.state.arm());
        bench.state.disarm();
    }
    bench.state.reset();
    assert_eq!(bench.state.phase(), Phase::Disarmed);
    assert_eq!(bench.at([0.0, 0.0, 1e-3]).hand_force_n, [0.0; 3]);
    assert!(bench.state.arm());
    bench.press();
}

fn assert_faults(command: Command, fault: Fault) {
    assert_eq!((command.hand_force_n, command.reaction_n, command.engaged), ([0.0; 3], [0.0; 3], None));
    assert_eq!(command.phase, Phase::SafeZero(fault));
    assert!(vec3::is_finite(command.hip_m));
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
            assert_eq!(command.hip_m, [0.0, 0.0, -5e-3], "the last good one");
            assert_latched(bench, Fault::NotFinite);
        }
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
    // 1.1 m/s, smoothly: found within the window; 0.9 m/s for as long: not.
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

/// One encoder count back and forth each millisecond is 54 mm/s by finite differences: no trip at half of that.
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

/// The same speed trips whatever the rate of the device.
#[test]
fn overspeed_at_every_sample_rate() {
    for period_us in [125_u64, 250, 500, 1000, 2000, 5000] {
        for (speed, faults) in [(1.2_f32, true), (0.8, false)] {
            let blob = organ_blob();
            let organ = Organ::<2>::read(blob.bytes()).expect("good");
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

/// Hold for 3 ticks, then zero, then at 10 ms a latched fault.
#[test]
fn stale_samples() {
    bench!(bench, config());
    let held = bench.press();
    for _ in 0..3 {
        assert_eq!(bench.without_sample(), held);
    }
    for _ in 4..10 {
        let command = bench.without_sample();
        assert_eq!((command.hand_force_n, command.phase), ([0.0; 3], Phase::Active));
        assert_eq!(command.engaged, Some(0), "the contact is kept");
    }
    assert_faults(bench.without_sample(), Fault::Stale);
    assert_latched(bench, Fault::Stale);
}

/// A tick that comes 9 ms after the last may change the force by what 2 ms allow, no more.
#[test]
fn a_late_tick_buys_no_large_step() {
    let mut fast = config();
    (fast.limits.max_slew_n_per_s, fast.limits.max_speed_m_s) = (200.0, 100.0);
    for (late_us, most_n) in [(1_000, 0.2), (2_000, 0.4), (9_000, 0.4)] {
        bench!(bench, fast);
        let before = bench.press();
        bench.now_us += late_us;
        let sample = sample(bench.now_us, [0.0, 0.0, -12e-3]);
        let late = bench.controller.tick(&mut bench.state, bench.now_us, Some(&sample));
        let step_n = vec3::distance(late.hand_force_n, before.hand_force_n);
        assert_eq!(late.phase, Phase::Active);
        assert!((step_n - most_n).abs() < 1e-3, "{late_us} us late: {step_n} N");
    }
}

/// While samples are missing the force is held, and then zero: the way over the gap counts with both.
#[test]
fn a_gap_counts_with_the_zero_it_was() {
    bench!(bench, config());
    let held = bench.press();
    for _ in 0..6 {
        bench.without_sample();
    }
    let back = bench.at([0.0, 0.0, -6e-3]);
    let counted_j = back.hand_work_j - held.hand_work_j;
    // 7 ms: three ticks hold the force, the fourth finds zero, which leaves with the fifth.
    let expected_j = -1e-3 * held.hand_force_n[2] * 5.0 / 7.0;
    assert!((counted_j / expected_j - 1.0).abs() < 0.02, "{counted_j} J, not {expected_j}");
}

/// A repeated, an older or a very late sample is no sample.
#[test]
fn old_samples_are_no_samples() {
    type Age = fn(u64, u64) -> u64;
    let ages: [(&str, Age); 3] = [
        ("repeated", |pressed_us, _| pressed_us),
        ("older", |pressed_us, tick| pressed_us - 500 - tick),
        ("from before", |_, _| 0),
    ];
    for (name, age) in ages {
        bench!(bench, config());
        bench.press();
        let pressed_us = bench.now_us;
        for tick in 1..=10 {
            bench.now_us += 1000;
            let sample = sample(age(pressed_us, tick), [0.0, 0.0, -5e-3]);
            let command = bench.controller.tick(&mut bench.state, bench.now_us, Some(&sample));
            assert_eq!(command.hand_force_n == [0.0; 3], tick > 3, "{name}, tick {tick}");
        }
        assert_eq!(bench.state.phase(), Phase::SafeZero(Fault::Stale), "{name}");
    }
    // Newer than the last one but on its way for as long as the fault limit.
    bench!(bench, config());
    bench.press();
    bench.now_us += 20_000;
    let late = sample(bench.now_us - 10_000, [0.0, 0.0, -5e-3]);
    assert_faults(bench.controller.tick(&mut bench.state, bench.now_us, Some(&late)), Fault::Stale);
}

/// A short gap is survived, and the force comes back by the slew limit.
#[test]
fn after_a_short_gap_the_force_returns_slowly() {
    let mut config = config();
    config.limits.max_slew_n_per_s = 100.0;
    bench!(bench, config);
    let steady = bench.press();
    for _ in 0..6 {
        bench.without_sample();
    }
    let mut force_n = 0.0;
    for _ in 0..100 {
        let now_n = vec3::norm(bench.at([0.0, 0.0, -5e-3]).hand_force_n);
        assert!(now_n - force_n <= 0.1 * 1.000_01 + 1e-6, "{force_n} -> {now_n}");
        force_n = now_n;
    }
    assert_eq!(force_n, vec3::norm(steady.hand_force_n));
}

/// Armed, but the device never speaks.
#[test]
fn silence_after_arming_is_stale() {
    bench!(bench, config());
    for _ in 0..10 {
        assert_eq!(bench.without_sample().phase, Phase::Active);
    }
    assert_faults(bench.without_sample(), Fault::Stale);
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
    // 201 ticks since arming; the first of them is time zero.
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
    let direction = vec3::normalize_or_zero(vec3::neg(command.reaction_n));
    assert!(common::distance(direction, vec3::normalize_or_zero(command.hand_force_n)) < 1e-6);
}

#[test]
fn the_controller_refuses_what_it_cannot_render() {
    let blob = organ_blob();
    let organ = Organ::<2>::read(blob.bytes()).expect("good");
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
}

/// One step of a session that nobody should have.
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

    /// Whatever comes in: the force is finite and within the limit, its slew too unless it goes to zero, faults are zero,
    /// and a second controller given the same steps answers the same, bit for bit.
    #[test]
    fn limits_hold_whatever_comes_in(
        steps in prop::collection::vec(step(), 1..400),
        method in prop::sample::select(vec![Method::Trilinear, Method::Tricubic, Method::Hybrid]),
        max_force_n in prop_oneof![Just(8.0_f32), 0.01_f32..20.0],
        max_slew_n_per_s in prop_oneof![Just(1000.0_f32), 1.0_f32..5000.0],
    ) {
        let blob = organ_blob();
        let organ = Organ::<2>::read(blob.bytes()).expect("good");
        let mut config = config();
        config.method = method;
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
                    (elapsed_us, Some(Sample { t_us, position_m: hip_m, buttons }))
                }
                Step::Sample { elapsed_us, age_us, position_m, buttons } => {
                    let t_us = (now_us + elapsed_us).saturating_add_signed(-age_us);
                    (elapsed_us, Some(Sample { t_us, position_m, buttons }))
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
                let change_n = f64::from(common::distance(force_n, last_n));
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

/// The random session above is worth something only if it touches, faults and clamps.
#[test]
fn a_random_walk_meets_every_state() {
    bench!(bench, {
        let mut config = config();
        config.limits.max_force_n = 0.6;
        config
    });
    let mut random = common::Random(21);
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
