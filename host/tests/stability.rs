//! The closed loop of hand, device and controller is stable with the stiffness cap, and is not without.

#[path = "common/closed_loop.rs"]
mod closed_loop;
#[path = "common/synthetic.rs"]
mod synthetic;

use closed_loop::{Cap, Held, Knock, MOST_GIVEN_J, RELAXED, frictionless, hold, palpate};
use palpate_core::stiffness::stable_n_m;
use palpate_core::{
    Config, Controller, Method, Organ, PassivityConfig, Phase, Sample, Space, State, Vec3, vec3,
};
use palpate_host::device::hand::HandConfig;
use palpate_host::device::profile::Profile;

/// A light hand on a device with hardly any friction, that leans 8 mm into the organ's first node.
struct Hand {
    position_m: f32,
    speed_m_s: f32,
    target_m: f32,
}

const MASS_KG: f32 = 0.15;
const ARM_N_M: f32 = 200.0;
/// All the damping there is, hand and device.
const DAMPING_NS_M: f32 = 1.2;
const CYCLE_S: f32 = 1e-3;
/// The link to the device and back takes a whole cycle.
const DELAY_S: f32 = 1e-3;
/// Encoder step of a Falcon.
const COUNT_M: f32 = 54e-6;

impl Hand {
    /// A cycle under a force along the normal.
    fn step(&mut self, force_n: f32) {
        const SUBSTEPS: usize = 20;
        let dt_s = CYCLE_S / SUBSTEPS as f32;
        for _ in 0..SUBSTEPS {
            let arm_n = ARM_N_M * (self.target_m - self.position_m) - DAMPING_NS_M * self.speed_m_s;
            self.speed_m_s += dt_s / MASS_KG * (arm_n + force_n);
            self.position_m += dt_s * self.speed_m_s;
        }
    }
}

/// Peak to peak of the hand's height over the last second of six, and the share that the forces were scaled by.
fn shaking_m(organ: &Organ<'_>, cap_n_m: f32, workspace_scale: f32, guard: PassivityConfig) -> (f32, f32) {
    let space: &Space<'_> = &organ.spaces[0];
    let mut config = Config::new(Method::Trilinear);
    config.passivity = PassivityConfig { workspace_scale, ..guard };
    config.limits.max_stiffness_n_m = cap_n_m / workspace_scale;
    // The limits that would hide what the stiffness does.
    config.limits.max_force_n = 1e3;
    config.limits.max_slew_n_per_s = 1e6;
    config.limits.max_speed_m_s = 1e3;
    config.contact.release_height_m = 0.02;
    config.contact.release_tension_n = 1e3;
    let controller = Controller::new(organ, config).expect("has the method");
    let mut state = State::new();
    state.arm();
    let mut hand = Hand { position_m: 0.002, speed_m_s: 0.0, target_m: -0.008 };
    let (mut on_its_way_n, mut force_n, mut low_m, mut high_m) = (0.0, 0.0, f32::MAX, f32::MIN);
    for tick in 1..=6_000_u64 {
        hand.step(force_n);
        let seen_m = (hand.position_m / COUNT_M).round() * COUNT_M * workspace_scale;
        let position_m: Vec3 = vec3::add(space.rest_position_m, vec3::scale(space.outward_normal, seen_m));
        let sample = Sample { t_us: tick * 1000, position_m, buttons: 0 };
        let command = controller.tick(&mut state, tick * 1000, Some(&sample));
        force_n = on_its_way_n;
        on_its_way_n = vec3::dot(command.hand_force_n, space.outward_normal);
        if tick > 5_000 {
            (low_m, high_m) = (low_m.min(hand.position_m), high_m.max(hand.position_m));
        }
    }
    (high_m - low_m, controller.force_share())
}

/// No guard on energy.
const UNGUARDED: PassivityConfig = PassivityConfig {
    margin_j: 0.0,
    max_damping_n_s_m: 0.0,
    fault_j: f32::INFINITY,
    workspace_scale: 1.0,
    force_delay_us: 0,
    position_step_m: COUNT_M,
};

/// Where the cap is wrong by a factor, because the device's damping is not what its profile says, the guard holds the hand.
#[test]
fn the_guard_on_energy_stills_what_the_cap_lets_through() {
    let shape = synthetic::Shape { stiffness_n_m: 1_500.0, hardening_m: 0.1, ..synthetic::Shape::default() };
    let blob = synthetic::organ(&shape);
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
    let (free_m, _) = shaking_m(&organ, 1e9, 1.0, UNGUARDED);
    let (guarded_m, _) = shaking_m(&organ, 1e9, 1.0, PassivityConfig::default());
    println!("peak to peak: {:.3} mm without a guard, {:.3} mm with it", 1e3 * free_m, 1e3 * guarded_m);
    assert!(free_m > 0.02 && guarded_m < 4.0 * COUNT_M, "{free_m} m, {guarded_m} m");
}

#[test]
fn a_stiff_organ_shakes_without_the_cap_and_not_with_it() {
    let shape = synthetic::Shape { stiffness_n_m: 1_500.0, hardening_m: 0.1, ..synthetic::Shape::default() };
    let blob = synthetic::organ(&shape);
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
    let cap_n_m = stable_n_m(DAMPING_NS_M, 0.0, CYCLE_S, DELAY_S);
    assert!((700.0..900.0).contains(&cap_n_m), "{cap_n_m} N/m");

    let (capped_m, share) = shaking_m(&organ, cap_n_m, 1.0, UNGUARDED);
    let (free_m, whole) = shaking_m(&organ, 1e9, 1.0, UNGUARDED);
    println!(
        "peak to peak: {:.3} mm with the cap ({share:.2} of the force), {:.3} mm without",
        1e3 * capped_m,
        1e3 * free_m
    );
    assert!(share < 0.6 && whole == 1.0);
    assert!(capped_m < 4.0 * COUNT_M, "{capped_m} m with the cap");
    assert!(free_m > 20.0 * COUNT_M, "{free_m} m without: this test could not fail");

    // The same organ three times as large to the hand: it is the device's stiffness that counts.
    let soft = synthetic::organ(&synthetic::Shape {
        stiffness_n_m: 500.0,
        hardening_m: 0.1,
        ..synthetic::Shape::default()
    });
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&soft)).expect("a sound blob");
    let (small_m, share) = shaking_m(&organ, cap_n_m, 1.0, UNGUARDED);
    assert!(small_m < 4.0 * COUNT_M && share == 1.0, "500 N/m need no cap: {small_m} m, {share}");
    let (scaled_m, share) = shaking_m(&organ, cap_n_m, 3.0, UNGUARDED);
    assert!(scaled_m < 4.0 * COUNT_M && share < 0.6, "{scaled_m} m, {share}");
    let (free_m, _) = shaking_m(&organ, 1e9, 3.0, UNGUARDED);
    assert!(free_m > 20.0 * COUNT_M, "{free_m} m");
}

/// What is scaled down lets the hand deeper, where the body is stiffer: the cap holds there too, wherever the force limit lets the hand.
#[test]
fn the_cap_holds_where_the_softer_force_lets_the_hand() {
    let blob = include_bytes!("../../firmware-like-core/golden/organ-514.blob");
    let mut words = vec![0_u64; blob.len().div_ceil(8)];
    bytemuck::cast_slice_mut(&mut words)[..blob.len()].copy_from_slice(blob);
    let organ: Organ<'_> = Organ::read(&bytemuck::cast_slice(&words)[..blob.len()]).expect("a sound blob");
    let space = &organ.spaces[0];
    let mut config = Config::new(Method::Energy);
    (config.limits.max_force_n, config.limits.max_stiffness_n_m) = (3.0, 250.0);
    let controller = Controller::new(&organ, config).expect("packed");
    let share = controller.force_share();
    let (mut felt_n_m, mut in_limit_n_m) = (0.0_f32, 0.0_f32);
    for slot in 0..space.flags.len() {
        let clear = palpate_core::flags::SOLVED | palpate_core::flags::SMOOTH;
        if space.flags[slot] & clear != clear {
            continue;
        }
        let found = space.estimate(Method::Energy, space.lattice.displacement_m(space.lattice.ijk(slot)));
        let found = found.expect("packed");
        let (size_n, stiffness_n_m) = (
            vec3::norm(found.force_n),
            palpate_core::stiffness::largest_singular_value(&found.stiffness_n_m),
        );
        if share * size_n <= 3.0 {
            felt_n_m = felt_n_m.max(share * stiffness_n_m);
        }
        if size_n <= 3.0 {
            in_limit_n_m = in_limit_n_m.max(stiffness_n_m);
        }
    }
    println!("felt up to {felt_n_m} N/m with {share}; {in_limit_n_m} N/m within the force limit");
    assert!(felt_n_m <= 250.0 * 1.001 && felt_n_m > 200.0, "{felt_n_m}");
    assert!(
        share < 0.98 * 250.0 / in_limit_n_m,
        "the band beyond the limit is not stiffer: this test could not fail"
    );
}

/// Every bundled table is as stiff as its slopes say: the cap is found where a force really changes that fast.
#[test]
fn the_stiffest_place_is_that_of_the_forces() {
    let blob = include_bytes!("../../firmware-like-core/golden/organ-514.blob");
    let mut words = vec![0_u64; blob.len().div_ceil(8)];
    bytemuck::cast_slice_mut(&mut words)[..blob.len()].copy_from_slice(blob);
    let organ: Organ<'_> = Organ::read(&bytemuck::cast_slice(&words)[..blob.len()]).expect("a sound blob");
    let of = |method| Controller::new(&organ, Config::new(method)).expect("packed").stiffest_n_m();
    let found = Method::OF_LATTICE.map(of);
    println!("stiffest, N/m: {found:?}");
    let energy = of(Method::Energy);
    for (method, stiffest_n_m) in Method::OF_LATTICE.into_iter().zip(found) {
        // Tri-linear slopes jump at grid points, where they are asked; radial ones are asked at fewer.
        assert!(
            (0.5..1.6).contains(&(stiffest_n_m / energy)),
            "{method:?}: {stiffest_n_m} beside {energy} N/m"
        );
    }
    // By differences of the force, along the axes.
    let space = &organ.spaces[0];
    let mut steepest = 0.0_f32;
    for slot in 0..space.flags.len() {
        let ijk = space.lattice.ijk(slot);
        let clear = palpate_core::flags::SOLVED | palpate_core::flags::SMOOTH;
        if !space.lattice.contains(ijk) || space.flags[slot] & clear != clear {
            continue;
        }
        let at_m = space.lattice.displacement_m(ijk);
        for axis in 0..3 {
            let mut beside_m = at_m;
            beside_m[axis] += 1e-4;
            let force = |d| space.force(Method::Energy, d).expect("packed").force_n;
            steepest = steepest.max(vec3::distance(force(beside_m), force(at_m)) / 1e-4);
        }
    }
    assert!(steepest > 0.5 * energy && steepest < 1.1 * energy, "{steepest} N/m along axes, {energy} in all");
}

/// An organ that is almost as stiff at every displacement.
fn with_organ(stiffness_n_m: f32, then: impl FnOnce(&Organ<'_>)) {
    let shape = synthetic::Shape { stiffness_n_m, hardening_m: 0.1, ..synthetic::Shape::default() };
    let blob = synthetic::organ(&shape);
    then(&Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob"));
}

/// 8 mm deep at the first node, knocked against once.
fn held(organ: &Organ<'_>, hand: HandConfig, profile: &Profile, cap: Cap) -> Held {
    hold(organ, Method::Trilinear, 0, 0.008, (hand, profile), cap, Knock::Once)
}

fn quantum_m(profile: &Profile) -> f32 {
    profile.mechanism.encoder_quantum_m.expect("every bundled profile states it")
}

#[test]
fn a_hand_at_rest_does_not_shake_on_any_bundled_device_however_stiff_the_organ() {
    with_organ(2_500.0, |organ| {
        for name in Profile::names() {
            let smooth = frictionless(&Profile::bundled(name).expect("bundled"));
            let with = held(organ, RELAXED, &smooth, Cap::On);
            println!(
                "{name:11} {:5.0} N/m at the hand, cap {:4.0}: {:6.2} um with the cap, {:+.0e} J in a second",
                with.stiffest_n_m,
                smooth.cap().n_m,
                1e6 * with.peak_to_peak_m,
                with.hold_j
            );
            assert!(with.share < 0.6 && with.phase == Phase::Active, "{name}: {with:?}");
            // Less than one step of the encoder, and no more energy than such a step is worth at that force.
            assert!(with.peak_to_peak_m < quantum_m(&smooth), "{name}: {with:?}");
            assert!(with.hold_j < f64::from(quantum_m(&smooth) * with.peak_n), "{name}: {with:?}");
        }
    });
}

/// The formulas at work: the device's own damping is enough, whoever holds it.
#[test]
fn where_damping_is_stated_the_cap_stands_without_a_hand_and_without_friction() {
    with_organ(2_500.0, |organ| {
        let profile = Profile::bundled("simulated").expect("bundled");
        let smooth = frictionless(&profile);
        assert_eq!(smooth.cap(), profile.cap(), "its friction does not limit it");
        let with = held(organ, HandConfig::LIGHT, &smooth, Cap::On);
        let without = held(organ, HandConfig::LIGHT, &smooth, Cap::Off);
        println!(
            "simulated, two fingers: {:.3} mm with the cap, {:.3} mm without",
            1e3 * with.peak_to_peak_m,
            1e3 * without.peak_to_peak_m
        );
        assert!(with.phase == Phase::Active && with.peak_to_peak_m < quantum_m(&smooth), "{with:?}");
        assert!(without.peak_to_peak_m > 20.0 * quantum_m(&smooth), "{without:?}: this test could not fail");
    });
}

#[test]
fn a_minute_of_random_palpation_on_every_bundled_device_is_safe_and_stable() {
    with_organ(600.0, |organ| {
        for (seed, name) in (1..).zip(Profile::names()) {
            let profile = Profile::bundled(name).expect("bundled");
            let usual = HandConfig::default();
            let found = palpate(organ, Method::Trilinear, (usual, &profile), (seed, 60.0), Cap::On);
            println!(
                "{name:11} {} touches, {:.2} N at most, {:+.1e} J at most in a touch",
                found.contacts, found.peak_n, found.most_given_j
            );
            assert_eq!(found.phase, Phase::Active, "{name}: {found:?}");
            assert!(found.contacts >= 10 && found.engaged_ticks > 10_000, "{name}: {found:?}");
            assert!(found.peak_n <= profile.max_force_n, "{name}: {found:?}");
            assert!(found.most_given_j < MOST_GIVEN_J, "{name}: {found:?}");
        }
    });
}

/// The guard counts what the motors gave: forces by when they were at the motors, positions by when they were taken. What is left are the
/// steps of the encoder, the halves of steps of the integration, and tremor.
#[test]
fn the_guard_counts_what_the_motors_gave() {
    let shape = synthetic::Shape { stiffness_n_m: 300.0, patch: 40, ..synthetic::Shape::default() };
    let blob = synthetic::organ(&shape);
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
    for (seed, name) in (1..).zip(Profile::names()) {
        let profile = Profile::bundled(name).expect("bundled");
        let hand = HandConfig { tremor_m: 0.0, ..HandConfig::default() };
        let found = palpate(&organ, Method::Trilinear, (hand, &profile), (seed, 60.0), Cap::On);
        println!(
            "{name:11} {} touches, {} ticks blended, {} of {} damped; most from the motors {:+.2} mJ, of the device {:+.2} mJ; the guard is \
             off by {:.3} mJ",
            found.contacts,
            found.blended_ticks,
            found.damped_ticks,
            found.engaged_ticks,
            1e3 * found.most_from_motors_j,
            1e3 * found.most_given_j,
            1e3 * found.guard_off_j
        );
        assert!(found.phase == Phase::Active && found.contacts >= 10, "{name}: {found:?}");
        assert!(found.blended_ticks > 1_000, "{name}: {found:?}");
        let step_j = f64::from(found.peak_n * quantum_m(&profile));
        assert!(found.guard_off_j < 3.0 * step_j, "{name}: {found:?}, a step is worth {step_j}");
    }
}

/// What the one above would see of a loop that is not stable.
#[test]
fn random_palpation_without_the_cap_is_found_out() {
    with_organ(4_000.0, |organ| {
        let profile = Profile::bundled("omega").expect("bundled");
        let found = palpate(organ, Method::Trilinear, (HandConfig::LIGHT, &profile), (3, 60.0), Cap::Off);
        println!("without the cap: {found:?}");
        assert!(found.phase != Phase::Active || found.most_given_j > 4.0 * MOST_GIVEN_J, "{found:?}");
    });
}

#[test]
fn a_seed_gives_the_same_bits_on_a_simulated_device() {
    with_organ(300.0, |organ| {
        let profile = Profile::bundled("falcon").expect("bundled");
        let run = |seed| {
            palpate(organ, Method::Trilinear, (HandConfig::default(), &profile), (seed, 20.0), Cap::On)
        };
        assert_eq!(run(5), run(5));
        assert_ne!(run(5).position_bits, run(6).position_bits);
    });
}
