//! A sphere that touches the organ live: first touch, press, slide and release at the speed of a hand.

use nalgebra::Vector3;
use palpate_core::{
    AlignedBytes, Command, Config, Controller, JetMemory, Organ, Orientation, Phase, Sample, State,
    TouchSurface,
};
use palpate_precompute::live::{Axis, Hand, LiveSolver, Partner, Published, Touch, Truth};
use palpate_precompute::scene::{ResolvedScene, Scene};
use palpate_precompute::spec::Tolerance;
use palpate_tests::documents;

/// The tool moves so far in a tick of 1 ms: 100 mm/s.
const STEP_M: f64 = 1e-4;
/// Ticks that a step of the solver takes.
const TICKS_A_STEP: usize = 10;

/// The small organ under a sphere of 10 mm.
pub(super) fn scene() -> ResolvedScene {
    scene_with("shape = \"sphere\"\nradius_m = 0.01\n")
}

/// The small organ under a tool with these keys.
pub(super) fn scene_with(tool: &str) -> ResolvedScene {
    let folder = tempfile::tempdir().expect("a folder");
    let assets = documents::root().join("assets");
    let text = std::fs::read_to_string(assets.join("liver-small.toml")).expect("a bundled scene");
    let (before, after) = (text.find("[[active]]").expect("it has"), text.find("[device]").expect("it has"));
    let mesh = assets.join("liver-small.msh");
    let text = text[..before].replace("\"liver-small.msh\"", &format!("{:?}", mesh.to_str().expect("UTF-8")))
        + "[tool]\n"
        + tool
        + &text[after..];
    let path = folder.path().join("sphere.toml");
    std::fs::write(&path, text).expect("a folder for it");
    Scene::load(&path).expect("it is sound").resolve().expect("it can be solved")
}

/// Down to 8 mm, 25 mm along the skin, and up again.
pub(super) fn way(scene: &ResolvedScene) -> Vec<Vector3<f64>> {
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

/// What one tool felt: its solver, and touch and command of each tick.
pub(super) type Felt = (LiveSolver, Vec<(Touch, Command)>);

/// The ticks of the controllers of one or two tools, each on its way, with a solver for each that takes ten ticks for a step.
/// Every tool is the partner of the other one.
pub(super) fn feel(scene: &ResolvedScene, friction: f32, ways: &[Vec<Vector3<f64>>]) -> Vec<Felt> {
    let mut config = Config::live();
    config.contact.friction = friction;
    feel_with(scene, config, ways, |_| Orientation::IDENTITY)
}

/// The same with other settings of the controllers and the orientation of the grip in each tick.
pub(super) fn feel_with(
    scene: &ResolvedScene,
    config: Config,
    ways: &[Vec<Vector3<f64>>],
    grip: impl Fn(usize) -> Orientation,
) -> Vec<Felt> {
    let new = |_| (LiveSolver::new(scene).expect("it can be touched"), Vec::new());
    let mut all: Vec<Felt> = ways.iter().map(new).collect();
    let bytes = AlignedBytes::from(&all[0].0.organ(scene).expect("an organ").0[..]);
    let organ: Box<Organ<'_>> = Organ::read_boxed(&bytes).expect("good");
    let start_m = Vector3::from(all[0].0.skin().contacts[0].rest_m);
    let mut words = vec![0; TouchSurface::words(&organ)];
    let controller = Controller::new(&organ, config).expect("an organ to be touched");
    let controller = controller.on_surface(TouchSurface::new(&organ, &mut words));
    let loops = ways.iter().map(|_| (Box::<JetMemory<1, 256>>::default(), State::new()));
    let mut loops: Vec<_> = loops.collect();
    for (_, state) in &mut loops {
        state.arm();
    }
    for tick in 0..ways[0].len() {
        let is_engaged = |(_, felt): &Felt| felt.last().is_some_and(|(_, command)| command.engaged.is_some());
        let engaged: Vec<bool> = all.iter().map(is_engaged).collect();
        let presses =
            |(_, felt): &Felt| felt.last().is_some_and(|(_, command)| reaction_n(command).norm() > 1e-3);
        let pressing: Vec<bool> = all.iter().map(presses).collect();
        for (of, ((memory, state), (solver, felt))) in loops.iter_mut().zip(&mut all).enumerate() {
            let centre_m = ways[of][tick];
            let velocity = if tick == 0 { Vector3::zeros() } else { (centre_m - ways[of][tick - 1]) * 1e3 };
            let control_m = (centre_m - start_m).into();
            let touch = Touch { contacts: [(0, 1.0), (0, 0.0), (0, 0.0)], control_m };
            let other = (0..ways.len()).find(|other| *other != of);
            if tick % TICKS_A_STEP == 0 {
                solver.step(&Hand {
                    hip_m: centre_m.into(),
                    velocity_m_s: velocity.into(),
                    touch: engaged[of].then_some(touch),
                    partner: other.filter(|other| pressing[*other]).map(|other| Partner {
                        position_m: ways[other][tick].into(),
                        velocity_m_s: (1e3 * (ways[other][tick] - ways[other][tick.max(1) - 1])).into(),
                    }),
                    axis: scene.tool.half_axis_m().map(|half_m| {
                        let half_m = half_m.map(|x| x as f32);
                        let [before, now] = [tick.max(1) - 1, tick]
                            .map(|tick| Vector3::from(grip(tick).turn(half_m).map(f64::from)));
                        Axis { half_m: now.into(), velocity_m_s: (1e3 * (now - before)).into() }
                    }),
                });
                solver.took(1e-3 * TICKS_A_STEP as f64);
                while let Some(published) = solver.published() {
                    memory.insert(&published.jet(0));
                }
            }
            let beside_m = other.filter(|other| pressing[*other]).map(|other| ways[other][tick] - start_m);
            memory.partner(beside_m.map(|at_m| at_m.map(|x| x as f32).into()));
            let t_us = 1_000 * tick as u64;
            let position_m = centre_m.map(|x| x as f32).into();
            let sample = Sample { t_us, position_m, orientation: grip(tick), ..Sample::default() };
            let command = controller.tick_on(state, t_us, Some(&sample), &mut **memory);
            assert_eq!(command.phase, Phase::Active, "{command:?}");
            felt.push((touch, command));
        }
    }
    all
}

/// Numbers of positions, and of those with an imperceptible error, and the largest error, N, of every fifth tick. With a partner
/// those count in which both press.
pub(super) fn compare(of: &Felt, partner: Option<(&Felt, &[Vector3<f64>])>) -> (u32, u32, f64) {
    let (solver, felt) = of;
    println!("{:?}", solver.totals());
    let mut truth = Truth::new(solver);
    let (mut count, mut good, mut worst) = (0, 0, 0.0f64);
    for (tick, (touch, command)) in felt.iter().enumerate().step_by(5) {
        truth.face(partner.map(|(_, way)| way[tick].into()));
        let wanted_n = Vector3::from(truth.force_n(touch).expect("it converges"));
        let error_n = (reaction_n(command) - wanted_n).norm();
        let tolerance_n = Tolerance::IMPERCEPTIBLE.of_size(wanted_n.norm());
        if partner.is_some_and(|(of, _)| wanted_n.norm() == 0.0 || reaction_n(&of.1[tick].1).norm() == 0.0) {
            continue;
        }
        count += 1;
        good += u32::from(error_n < tolerance_n);
        worst = worst.max(error_n);
    }
    println!("{good} of {count} not felt, worst {worst:.3} N");
    (count, good, worst)
}

pub(super) fn reaction_n(command: &Command) -> Vector3<f64> {
    Vector3::from(command.reaction_n.map(f64::from))
}

/// A hand that lifts and comes down elsewhere finds the force there solved: no way leads there through the body.
#[test]
fn a_sphere_comes_to_any_other_place() {
    let scene = scene();
    let mut solver = LiveSolver::new(&scene).expect("it can be touched");
    let start_m = Vector3::from(solver.skin().contacts[0].rest_m);
    let surface = palpate_precompute::mesh::Surface::of(&scene.mesh);
    let nodes = 0..scene.mesh.nodes_m.len() as u32;
    let free = nodes.filter(|node| scene.mesh.nodes_m[*node as usize][0] > 0.04);
    let of_skin: Vec<_> = free.filter_map(|node| Some((node, surface.normal(node)?))).collect();
    // In an order that leaps across the body.
    for n in 0..40 {
        let (node, normal) = of_skin[(n * 131) % of_skin.len()];
        let (place_m, normal) = (Vector3::from(scene.mesh.nodes_m[node as usize]), Vector3::from(normal));
        let at = |clearance_m: f64| place_m + (0.01 + clearance_m) * normal;
        let velocity_m_s = (-0.06 * normal).into();
        for clearance_m in [15e-3, 10e-3, 5e-3] {
            solver.step(&Hand { hip_m: at(clearance_m).into(), velocity_m_s, ..Hand::default() });
        }
        let first_m = at(0.0) - start_m;
        let away_m = |jet: &Published| jet.distance_m(first_m.into());
        let known = solver.jets(0).filter(|jet| jet.trust.jet.force_n != [0.0; 3]);
        let nearest_m = known.map(|jet| away_m(&jet)).fold(f64::INFINITY, f64::min);
        assert!(nearest_m < 1e-3, "node {node}: {nearest_m} m");
    }
}

#[test]
fn a_sphere_is_not_felt_to_lag() {
    let scene = scene();
    let felt = feel(&scene, 0.0, &[way(&scene)]);
    let (count, good, _) = compare(&felt[0], None);
    assert!(f64::from(good) >= 0.98 * f64::from(count));
}

/// A press, a slide and a release with friction: the slide ends at mu |h|, and the hand loses energy.
#[test]
fn a_sphere_feels_the_friction_of_coulomb() {
    let scene = scene();
    let (way, mu) = (way(&scene), 0.3);
    let [smooth, rough] =
        [0.0, mu].map(|friction| feel(&scene, friction as f32, std::slice::from_ref(&way)).remove(0).1);
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

/// The node of the skin at this distance from the fixed end, and its normal.
fn of_fixed_end(scene: &ResolvedScene, from_end_m: f64) -> (Vector3<f64>, Vector3<f64>) {
    let surface = palpate_precompute::mesh::Surface::of(&scene.mesh);
    let end_m = scene.mesh.nodes_m.iter().map(|node| node[0]).fold(f64::INFINITY, f64::min);
    let off_m = |node: &u32| (scene.mesh.nodes_m[*node as usize][0] - end_m - from_end_m).abs();
    let nodes = scene.fixed.iter().copied().filter_map(|node| Some((node, surface.normal(node)?)));
    let (node, normal) = nodes.min_by(|(a, _), (b, _)| off_m(a).total_cmp(&off_m(b))).expect("it is held");
    (scene.mesh.nodes_m[node as usize].into(), normal.into())
}

/// Free, and nearer than a touch begins: at rest on the skin, or inside.
#[test]
fn a_tool_that_overlaps_the_body_and_is_free_is_told() {
    let scene = scene();
    let solver = LiveSolver::new(&scene).expect("it can be touched");
    let node = 199;
    let surface = palpate_precompute::mesh::Surface::of(&scene.mesh);
    let normal = Vector3::from(surface.normal(node).expect("on the skin"));
    let at = |height_m: f64| Vector3::from(scene.mesh.nodes_m[node as usize]) + height_m * normal;
    let touch = Touch { contacts: [(0, 1.0), (0, 0.0), (0, 0.0)], control_m: [0.0; 3] };
    for (height_m, touch, is_told) in
        [(0.013, None, false), (0.009, None, true), (-0.01, None, true), (0.009, Some(touch), false)]
    {
        let hand = Hand { hip_m: at(height_m).into(), touch, ..Hand::default() };
        assert_eq!(solver.overlaps_unfelt(&hand), is_told, "{height_m} m");
    }
}

/// The deeper a hand presses on the fixed part, the more it feels, up to the largest force. Where it pushes the axis through,
/// the force fades, and there is none until the tool has left; afterwards it feels the same.
#[test]
fn the_fixed_part_is_a_wall_for_the_hand() {
    let sphere = "shape = \"sphere\"\nradius_m = 0.01\n";
    // With its side on the end of the body.
    let capsule = "shape = \"capsule\"\nradius_m = 0.01\nlength_m = 0.02\naxis = [0.0, 1.0, 0.0]\n";
    let small = "shape = \"sphere\"\nradius_m = 0.003\n";
    // The radius, the depth, mm, that it bears, the force there for the hand, and the most on the body, N.
    for (tool, radius_mm, from_end_m, max_stiffness_n_m, [deep_mm, deep_n, body_n]) in [
        (sphere, 10, 0.0, 3_000.0, [10.0, 7.9, 30.0]),
        (sphere, 10, 0.01, 3_000.0, [10.0, 7.9, 30.0]),
        (sphere, 10, 0.016, 3_000.0, [10.0, 7.9, 30.0]),
        (sphere, 10, 0.0, 700.0, [10.0, 4.0, 30.0]),
        (small, 3, 0.0, 3_000.0, [2.5, 4.0, 10.0]),
        (capsule, 10, 0.0, 3_000.0, [10.0, 7.9, 80.0]),
    ] {
        let scene = scene_with(tool);
        let mut config = Config::live();
        config.limits.max_stiffness_n_m = max_stiffness_n_m;
        let (place_m, normal) = of_fixed_end(&scene, from_end_m);
        let at = |depth_m: f64| place_m + (1e-3 * f64::from(radius_mm) - depth_m) * normal;
        // At 50 mm/s, to 18 mm and back, then to 4 mm; the tick of a depth on the first way, mm.
        let depths = (0..760).chain((0..760).rev()).chain(0..480);
        let tick = |depth_mm: f64| (20.0 * (depth_mm + 20.0)) as usize;
        let way: Vec<_> = depths.map(|n| at(5e-5 * f64::from(n) - 0.02)).collect();
        let felt = feel_with(&scene, config, &[way], |_| Orientation::IDENTITY).remove(0).1;
        let hand = |(_, command): &(Touch, Command)| Vector3::from(command.hand_force_n.map(f64::from));
        let hand_n: Vec<f64> = felt.iter().map(|tick| hand(tick).norm()).collect();
        let (touched, deep) = (tick(0.4 * deep_mm), tick(deep_mm));
        let is_outward =
            felt[touched..deep].iter().all(|tick| hand(tick).dot(&normal) > 0.5 * hand(tick).norm());
        // Where the force of the body does not fall: a new jet may correct it.
        let of_body_n: Vec<f64> = felt.iter().map(|(_, command)| reaction_n(command).norm()).collect();
        let pressing = (1..deep).filter(|n| of_body_n[*n] >= of_body_n[n - 1]);
        let falls_n = pressing.map(|n| hand_n[n - 1] - hand_n[n]).fold(0.0, f64::max);
        let most_n = of_body_n.iter().copied().fold(0.0, f64::max);
        let [first_n, again_n] = [hand_n[479], hand_n[1_999]];
        // 30 ms after the axis has gone through, and until it is out again.
        let inside = tick(f64::from(radius_mm) + 3.5)..1_520 - tick(f64::from(radius_mm) - 0.5);
        let is_free = hand_n[inside].iter().all(|n| *n == 0.0);
        let step_n = felt.windows(2).map(|pair| (hand(&pair[1]) - hand(&pair[0])).norm()).fold(0.0, f64::max);
        println!(
            "R {radius_mm} mm, {from_end_m} m: falls by {falls_n:.3} N a tick, body {most_n:.1} N, {first_n:.2} N then {again_n:.2} N, \
             {:.2} N deep, largest step {step_n:.3} N",
            hand_n[deep]
        );
        assert!(falls_n < 5e-3 && is_outward && hand_n[deep] > deep_n && most_n < body_n);
        assert!(is_free && step_n < 0.3, "{is_free} {step_n}");
        if max_stiffness_n_m > 2_500.0 && radius_mm == 10 {
            assert!((first_n - again_n).abs() < 0.1 * first_n && first_n > 5.0, "{first_n} {again_n}");
        }
    }
}
