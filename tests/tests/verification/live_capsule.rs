//! A capsule that touches the organ live while the grip turns it: force and moment against full solutions.

use nalgebra::Vector3;
use palpate_core::{Config, Orientation, vec3};
use palpate_precompute::live::Truth;
use palpate_precompute::spec::Tolerance;

use super::live_sphere::{feel_with, reaction_n, scene_with, way};

/// Largest angle of the grip, rad, and the ticks of one turn to and fro.
const TILT_RAD: f32 = 0.35;
const PERIOD: f32 = 900.0;
/// A moment is off by what cannot be felt, if the force were off by that at this distance from the centre, m.
const ARM_M: f64 = 0.01;

/// Lies along the skin, and rocks while it presses and slides.
#[test]
fn a_capsule_that_is_turned_is_not_felt_to_lag() {
    let scene = scene_with("shape = \"capsule\"\nradius_m = 0.01\nlength_m = 0.02\naxis = [1.0, 0.0, 0.0]\n");
    // At half the speed of the sphere: 50 mm/s.
    let way: Vec<_> = way(&scene).into_iter().flat_map(|at| [at, at]).collect();
    let grip = |tick: usize| {
        let angle_rad = TILT_RAD * (core::f32::consts::TAU * tick as f32 / PERIOD).sin();
        Orientation::of_vector([0.0, angle_rad, 0.5 * angle_rad])
    };
    let mut config = Config::live();
    config.contact.friction = 0.0;
    let felt = feel_with(&scene, config, &[way], grip);
    let (solver, ticks) = &felt[0];
    println!("{:?}", solver.totals());
    let half_m = scene.tool.half_axis_m().expect("a capsule").map(|x| x as f32);
    let mut truth = Truth::new(solver);
    let (mut count, mut good, mut turned, mut worst_n, mut worst_n_m) = (0, 0, 0, 0.0f64, 0.0f64);
    let (mut largest_n_m, mut step_n) = (0.0f64, 0.0f64);
    for (tick, (touch, command)) in ticks.iter().enumerate().step_by(5) {
        truth.face(Some(grip(tick).turn(half_m).map(f64::from)));
        let wanted_n = Vector3::from(truth.force_n(touch).expect("it converges"));
        let wanted_n_m = Vector3::from(truth.moment_n_m());
        let error_n = (reaction_n(command) - wanted_n).norm();
        let error_n_m = (Vector3::from(command.reaction_n_m.map(f64::from)) - wanted_n_m).norm();
        let tolerance_n = Tolerance::IMPERCEPTIBLE.of_size(wanted_n.norm());
        count += 1;
        good += u32::from(error_n < tolerance_n);
        turned += u32::from(error_n_m < ARM_M * tolerance_n);
        (worst_n, worst_n_m) = (worst_n.max(error_n), worst_n_m.max(error_n_m));
        largest_n_m = largest_n_m.max(wanted_n_m.norm());
    }
    for pair in ticks.windows(2) {
        let [before, now] = [&pair[0].1, &pair[1].1].map(|command| command.reaction_n);
        step_n = step_n.max(f64::from(vec3::distance(before, now)));
    }
    println!(
        "{good} of {count} forces and {turned} moments not felt, worst {worst_n:.3} N and {:.2} of {:.2} mN m; largest step \
         {step_n:.3} N",
        1e3 * worst_n_m,
        1e3 * largest_n_m
    );
    assert!(largest_n_m > 2e-3, "the body turns it by {largest_n_m} N m");
    assert!(f64::from(good) >= 0.95 * f64::from(count) && f64::from(turned) >= 0.9 * f64::from(count));
}
