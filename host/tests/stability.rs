//! The closed loop of hand, device and controller is stable with the stiffness cap, and is not without.

#[path = "common/synthetic.rs"]
mod synthetic;

use palpate_core::stiffness::stable_n_m;
use palpate_core::{Config, Controller, Method, Organ, Sample, Space, State, Vec3, vec3};

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
fn shaking_m(organ: &Organ<'_>, cap_n_m: f32, workspace_scale: f32) -> (f32, f32) {
    let space: &Space<'_> = &organ.spaces[0];
    let mut config = Config::new(Method::Trilinear);
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

#[test]
fn a_stiff_organ_shakes_without_the_cap_and_not_with_it() {
    let shape = synthetic::Shape { stiffness_n_m: 1_500.0, hardening_m: 0.1, ..synthetic::Shape::default() };
    let blob = synthetic::organ(&shape);
    let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
    let cap_n_m = stable_n_m(DAMPING_NS_M, 0.0, CYCLE_S, DELAY_S);
    assert!((700.0..900.0).contains(&cap_n_m), "{cap_n_m} N/m");

    let (capped_m, share) = shaking_m(&organ, cap_n_m, 1.0);
    let (free_m, whole) = shaking_m(&organ, 1e9, 1.0);
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
    let (small_m, share) = shaking_m(&organ, cap_n_m, 1.0);
    assert!(small_m < 4.0 * COUNT_M && share == 1.0, "500 N/m need no cap: {small_m} m, {share}");
    let (scaled_m, share) = shaking_m(&organ, cap_n_m, 3.0);
    assert!(scaled_m < 4.0 * COUNT_M && share < 0.6, "{scaled_m} m, {share}");
    let (free_m, _) = shaking_m(&organ, 1e9, 3.0);
    assert!(free_m > 20.0 * COUNT_M, "{free_m} m");
}

/// Every bundled table is as stiff as its slopes say: the cap is found where a force really changes that fast.
#[test]
fn the_stiffest_place_is_that_of_the_forces() {
    let blob = include_bytes!("../../firmware-like-core/golden/organ-514.blob");
    let mut words = vec![0_u64; blob.len().div_ceil(8)];
    bytemuck::cast_slice_mut(&mut words)[..blob.len()].copy_from_slice(blob);
    let organ: Organ<'_> = Organ::read(&bytemuck::cast_slice(&words)[..blob.len()]).expect("a sound blob");
    let of = |method| Controller::new(&organ, Config::new(method)).expect("packed").stiffest_n_m();
    let found = Method::ALL.map(of);
    println!("stiffest, N/m: {found:?}");
    let energy = of(Method::Energy);
    for (method, stiffest_n_m) in Method::ALL.into_iter().zip(found) {
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
