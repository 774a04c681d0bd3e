//! A sphere that touches the organ live: first touch, press, slide and release at the speed of a hand.

use nalgebra::Vector3;
use palpate_core::{Field, JetMemory, NodeWeight};
use palpate_precompute::fem::{CoatedSphere, Layer};
use palpate_precompute::live::{Hand, LiveSolver, Step, Touch, Truth};
use palpate_precompute::scene::Scene;
use palpate_precompute::spec::Tolerance;
use palpate_tests::documents;

/// The tool moves so far in a tick of 1 ms: 100 mm/s.
const STEP_M: f64 = 1e-4;
/// Ticks that a step of the solver takes.
const TICKS_A_STEP: usize = 10;

/// The small organ under a sphere of 10 mm.
fn scene(folder: &std::path::Path) -> Scene {
    let assets = documents::root().join("assets");
    let text = std::fs::read_to_string(assets.join("liver-small.toml")).expect("a bundled scene");
    let (before, after) = (text.find("[[active]]").expect("it has"), text.find("[device]").expect("it has"));
    let mesh = assets.join("liver-small.msh");
    let text = text[..before].replace("\"liver-small.msh\"", &format!("{:?}", mesh.to_str().expect("UTF-8")))
        + "[tool]\nshape = \"sphere\"\nradius_m = 0.01\n"
        + &text[after..];
    let path = folder.join("sphere.toml");
    std::fs::write(&path, text).expect("a folder for it");
    Scene::load(&path).expect("it is sound")
}

/// Down to 8 mm, 25 mm along the skin, and up again.
fn way(place_m: Vector3<f64>, normal: Vector3<f64>) -> Vec<Vector3<f64>> {
    let along = normal.cross(&Vector3::z()).normalize();
    let corners = [
        place_m + 0.03 * normal,
        place_m + 0.002 * normal,
        place_m + 0.002 * normal + 0.025 * along,
        place_m + 0.03 * normal + 0.025 * along,
    ];
    let mut way = Vec::new();
    for pair in corners.windows(2) {
        let steps = ((pair[1] - pair[0]).norm() / STEP_M) as usize;
        way.extend((0..steps).map(|n| pair[0] + n as f64 / steps as f64 * (pair[1] - pair[0])));
    }
    way
}

#[test]
fn a_sphere_is_not_felt_to_lag() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = scene(folder.path()).resolve().expect("it can be solved");
    let mut solver = LiveSolver::new(&scene).expect("it can be touched");
    let start_m = Vector3::from(solver.skin().contacts[0].rest_m);
    let body = scene.body().expect("it can be solved");
    let sphere = CoatedSphere::new(&body, 0.01, Layer::of(0.01), start_m.into());
    let surface = palpate_precompute::mesh::Surface::of(&scene.mesh);
    let node = 199;
    let place_m = Vector3::from(scene.mesh.nodes_m[node as usize]);
    let normal = Vector3::from(surface.normal(node).expect("on the skin"));
    let mut memory = Box::<JetMemory<1, 256>>::default();
    let mut weights = [NodeWeight::default(); 3];
    weights[0] = NodeWeight { space: 0, weight: 1.0 };
    let way = way(place_m, normal);
    let mut felt = Vec::new();
    let mut is_engaged = false;
    let mut steps = 0;
    for (tick, centre_m) in way.iter().enumerate() {
        let velocity = if tick == 0 { Vector3::zeros() } else { (centre_m - way[tick - 1]) * 1e3 };
        let control_m: [f64; 3] = (centre_m - start_m).into();
        let touch = Touch { contacts: [(0, 1.0), (0, 0.0), (0, 0.0)], control_m };
        let hand = Hand {
            hip_m: (*centre_m).into(),
            velocity_m_s: velocity.into(),
            touch: is_engaged.then_some(touch),
        };
        if tick % TICKS_A_STEP == 0 {
            let step = solver.step(&hand);
            steps += u32::from(step != Step::Idle);
            solver.took(1e-3 * TICKS_A_STEP as f64);
            while let Some(published) = solver.published() {
                memory.insert(&published.jet(0));
            }
        }
        let now_us = 1_000 * tick as u64;
        let displacement_m = control_m.map(|x| x as f32);
        let at = palpate_core::Touch { now_us, weights, displacement_m, hip_m: displacement_m };
        is_engaged |= sphere.clearance_m(&body, control_m) <= 0.0;
        let mut felt_n = Vector3::zeros();
        if is_engaged {
            let force = memory.force(&at).expect("it always answers");
            felt_n = Vector3::from(force.force_n.map(f64::from));
            is_engaged = sphere.clearance_m(&body, control_m) <= 0.0 || force.force_n != [0.0; 3];
        } else {
            memory.released(now_us);
        }
        felt.push((touch, felt_n));
    }
    println!("{steps} steps, {:?}", solver.totals());
    let mut truth = Truth::new(&solver);
    let (mut count, mut good, mut worst) = (0, 0, 0.0f64);
    for (touch, felt_n) in felt.iter().step_by(5) {
        let wanted_n = Vector3::from(truth.force_n(touch).expect("it converges"));
        let error_n = (felt_n - wanted_n).norm();
        let tolerance_n = Tolerance::IMPERCEPTIBLE.of_size(wanted_n.norm());
        count += 1;
        good += u32::from(error_n < tolerance_n);
        worst = worst.max(error_n);
    }
    println!("{good} of {count} not felt, worst {worst:.3} N");
    assert!(f64::from(good) >= 0.98 * f64::from(count));
}
