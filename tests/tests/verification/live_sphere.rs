//! A sphere that touches the organ live: first touch, press, slide and release at the speed of a hand.

use nalgebra::Vector3;
use palpate_core::{
    AlignedBytes, Command, Config, Controller, JetMemory, Organ, Phase, Sample, State, TouchSurface,
};
use palpate_precompute::live::{Hand, LiveSolver, Touch, Truth};
use palpate_precompute::scene::{ResolvedScene, Scene};
use palpate_precompute::spec::Tolerance;
use palpate_tests::documents;

/// The tool moves so far in a tick of 1 ms: 100 mm/s.
const STEP_M: f64 = 1e-4;
/// Ticks that a step of the solver takes.
const TICKS_A_STEP: usize = 10;

/// The small organ under a sphere of 10 mm.
fn scene() -> ResolvedScene {
    let folder = tempfile::tempdir().expect("a folder");
    let assets = documents::root().join("assets");
    let text = std::fs::read_to_string(assets.join("liver-small.toml")).expect("a bundled scene");
    let (before, after) = (text.find("[[active]]").expect("it has"), text.find("[device]").expect("it has"));
    let mesh = assets.join("liver-small.msh");
    let text = text[..before].replace("\"liver-small.msh\"", &format!("{:?}", mesh.to_str().expect("UTF-8")))
        + "[tool]\nshape = \"sphere\"\nradius_m = 0.01\n"
        + &text[after..];
    let path = folder.path().join("sphere.toml");
    std::fs::write(&path, text).expect("a folder for it");
    Scene::load(&path).expect("it is sound").resolve().expect("it can be solved")
}

/// Down to 8 mm, 25 mm along the skin, and up again.
fn way(scene: &ResolvedScene) -> Vec<Vector3<f64>> {
    let node = 199;
    let place_m = Vector3::from(scene.mesh.nodes_m[node as usize]);
    let surface = palpate_precompute::mesh::Surface::of(&scene.mesh);
    let normal = Vector3::from(surface.normal(node).expect("on the skin"));
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

/// The ticks of the controller on a way, with a solver that takes ten of them for a step.
fn feel(scene: &ResolvedScene, friction: f32, way: &[Vector3<f64>]) -> (LiveSolver, Vec<(Touch, Command)>) {
    let mut solver = LiveSolver::new(scene).expect("it can be touched");
    let bytes = AlignedBytes::from(&solver.organ(scene).expect("an organ").0[..]);
    let organ: Box<Organ<'_>> = Organ::read_boxed(&bytes).expect("good");
    let start_m = Vector3::from(solver.skin().contacts[0].rest_m);
    let mut words = vec![0; TouchSurface::words(&organ)];
    let mut config = Config::live();
    config.contact.friction = friction;
    let controller = Controller::new(&organ, config).expect("an organ to be touched");
    let controller = controller.on_surface(TouchSurface::new(&organ, &mut words));
    let mut memory = Box::<JetMemory<1, 256>>::default();
    let (mut state, mut felt) = (State::new(), Vec::<(Touch, Command)>::new());
    state.arm();
    for (tick, centre_m) in way.iter().enumerate() {
        let velocity = if tick == 0 { Vector3::zeros() } else { (centre_m - way[tick - 1]) * 1e3 };
        let touch =
            Touch { contacts: [(0, 1.0), (0, 0.0), (0, 0.0)], control_m: (centre_m - start_m).into() };
        if tick % TICKS_A_STEP == 0 {
            let is_engaged = felt.last().is_some_and(|(_, command)| command.engaged.is_some());
            let hip_m = (*centre_m).into();
            solver.step(&Hand { hip_m, velocity_m_s: velocity.into(), touch: is_engaged.then_some(touch) });
            solver.took(1e-3 * TICKS_A_STEP as f64);
            while let Some(published) = solver.published() {
                memory.insert(&published.jet(0));
            }
        }
        let t_us = 1_000 * tick as u64;
        let sample = Sample { t_us, position_m: centre_m.map(|x| x as f32).into(), buttons: 0 };
        let command = controller.tick_on(&mut state, t_us, Some(&sample), &mut *memory);
        assert_eq!(command.phase, Phase::Active, "{command:?}");
        felt.push((touch, command));
    }
    (solver, felt)
}

fn reaction_n(command: &Command) -> Vector3<f64> {
    Vector3::from(command.reaction_n.map(f64::from))
}

#[test]
fn a_sphere_is_not_felt_to_lag() {
    let scene = scene();
    let (solver, felt) = feel(&scene, 0.0, &way(&scene));
    println!("{:?}", solver.totals());
    let mut truth = Truth::new(&solver);
    let (mut count, mut good, mut worst) = (0, 0, 0.0f64);
    for (touch, command) in felt.iter().step_by(5) {
        let wanted_n = Vector3::from(truth.force_n(touch).expect("it converges"));
        let error_n = (reaction_n(command) - wanted_n).norm();
        let tolerance_n = Tolerance::IMPERCEPTIBLE.of_size(wanted_n.norm());
        count += 1;
        good += u32::from(error_n < tolerance_n);
        worst = worst.max(error_n);
    }
    println!("{good} of {count} not felt, worst {worst:.3} N");
    assert!(f64::from(good) >= 0.98 * f64::from(count));
}

/// A press, a slide and a release with friction: the slide ends at mu |h|, and the hand loses energy.
#[test]
fn a_sphere_feels_the_friction_of_coulomb() {
    let scene = scene();
    let (way, mu) = (way(&scene), 0.3);
    let [smooth, rough] = [0.0, mu].map(|friction| feel(&scene, friction as f32, &way).1);
    let mut share = Vec::new();
    for ((_, smooth), (_, rough)) in smooth.iter().zip(&rough) {
        let (smooth_n, rough_n) = (reaction_n(smooth), reaction_n(rough));
        let along_n = (rough_n - smooth_n).norm();
        assert!(along_n <= (mu + 1e-3) * smooth_n.norm() + 1e-3, "{along_n} N at {} N", smooth_n.norm());
        share.push(if smooth_n.norm() > 0.1 { along_n / smooth_n.norm() } else { 0.0 });
    }
    // The slide takes the ticks 280 to 530.
    let slips = share[360..530].iter().filter(|share| **share > 0.95 * mu).count();
    println!(
        "{slips} of 170 ticks of the slide at mu |h|, greatest share {:.3}",
        share.iter().copied().fold(0.0, f64::max)
    );
    assert!(slips >= 160, "{share:?}");
    let work_j = |felt: &[(Touch, Command)]| {
        let steps = way.windows(2).zip(felt.windows(2));
        steps
            .map(|(way, felt)| {
                0.5 * (reaction_n(&felt[0].1) + reaction_n(&felt[1].1)).dot(&(way[1] - way[0]))
            })
            .sum::<f64>()
    };
    let (smooth_j, rough_j) = (work_j(&smooth), work_j(&rough));
    let greatest_n = smooth.iter().map(|(_, command)| reaction_n(command).norm()).fold(0.0, f64::max);
    println!("{smooth_j:.2e} J without friction, {rough_j:.2e} J with it, up to {greatest_n:.2} N");
    assert!(rough_j - smooth_j > 0.4 * mu * greatest_n * 0.025, "{smooth_j} {rough_j} J");
}
