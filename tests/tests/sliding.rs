//! Strokes over a patch of active nodes of the bundled liver: the change of the force per tick is small for
//! any motion of the tool.

use std::path::Path;
use std::time::Instant;

use palpate_core::{Config, Controller, Method, Organ, Phase, Sample, State, TouchSurface, Vec3, vec3};
use palpate_host::session::TouchStatistics;
use palpate_host::{BlobFile, TickRecord};
use palpate_precompute::mesh::Surface;
use palpate_precompute::scene::{ActiveNode, Scene};
use palpate_precompute::spec::SpaceGrid;
use palpate_tests::coarse_blob::coarse_blob;

/// Radius of the patch around A1, m.
const PATCH_M: f64 = 0.026;
/// Depth of the tool, m.
const DEPTH_M: f32 = 0.008;
/// Speed of the tool, m/s.
const SPEED_M_S: f32 = 0.1;

/// Result of a stroke.
struct Stroke {
    figures: TouchStatistics,
    /// Force in the first tick in contact, maximum, N.
    first_n: f32,
    work_j: f64,
    /// Duration of every tick, ns.
    tick_ns: Vec<u64>,
}

/// Moves along straight lines through these points at constant speed, with one sample per millisecond.
fn stroke(controller: &Controller<'_, '_>, through: &[Vec3], buttons: impl Fn(usize) -> u32) -> Stroke {
    let mut state = State::new();
    state.arm();
    let (figures, tick_ns) = (TouchStatistics::default(), Vec::new());
    let mut stroke = Stroke { figures, first_n: 0.0, work_j: 0.0, tick_ns };
    let (mut tick, mut before) = (0_u64, (vec3::ZERO, through[0]));
    let mut was_engaged = false;
    for (leg, ends) in through.windows(2).enumerate() {
        let steps = (vec3::distance(ends[0], ends[1]) / (SPEED_M_S * 1e-3)).ceil().max(1.0) as usize;
        for step in 1..=steps {
            let way = vec3::scale(vec3::sub(ends[1], ends[0]), step as f32 / steps as f32);
            let position_m = vec3::add(ends[0], way);
            tick += 1;
            let sample =
                Sample { t_us: tick * 1_000, position_m, buttons: buttons(leg), ..Sample::default() };
            let began = Instant::now();
            let command = controller.tick(&mut state, tick * 1_000, Some(&sample));
            stroke.tick_ns.push(began.elapsed().as_nanos() as u64);
            assert_eq!(command.phase, Phase::Active, "{command:?}");
            stroke.figures.add(&TickRecord { tick, ..TickRecord::of(&command) });
            if command.engaged.is_some() && !was_engaged {
                stroke.first_n = stroke.first_n.max(vec3::norm(command.reaction_n));
            }
            was_engaged = command.engaged.is_some();
            stroke.work_j += f64::from(vec3::dot(before.0, vec3::sub(position_m, before.1)));
            before = (command.hand_force_n, position_m);
        }
    }
    stroke
}

#[test]
fn strokes_over_the_liver_have_no_force_jumps() {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    let mut scene = Scene::load(&assets).expect("sound").resolve().expect("sound");
    let centre = scene.mesh.nodes_m[scene.active[0].node as usize];
    let surface = Surface::of(&scene.mesh);
    let near = |node: &&u32| {
        let apart = (0..3).map(|i| (scene.mesh.nodes_m[**node as usize][i] - centre[i]).powi(2)).sum::<f64>();
        apart.sqrt() < PATCH_M
    };
    scene.active =
        (surface.nodes.iter().filter(near)).map(|&node| ActiveNode::node(format!("P{node}"), node)).collect();
    let file = coarse_blob(&scene, SpaceGrid::new(0.01, 0.02).expect("valid"), &[Method::Energy]);
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    let touch_surface = TouchSurface::new(&organ, &mut memory).expect("the surface is packed");

    println!("{} active nodes", organ.spaces.len());
    println!("stroke            step mN  first mN  peak N  contacts  work mJ  added mJ");
    for (name, friction) in [("slide", 0.3), ("slide, slippery", 0.05), ("stick", f32::INFINITY)] {
        let mut config = Config::new(Method::Energy);
        config.limits.ramp_s = 0.0;
        config.contact.friction = friction;
        let controller = Controller::new(&organ, config).expect("packed").on_surface(Some(touch_surface));
        let (mut worst, mut first_n, mut work_j, mut contacts) =
            (TouchStatistics::default(), 0.0_f32, 0.0, 0);
        let mut max_given_j = f64::MIN;
        for (i, from) in organ.spaces.iter().enumerate() {
            let to = &organ.spaces[(i + 3) % organ.spaces.len()];
            let at = |space: &palpate_core::Space<'_>, height_m: f32| {
                vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, height_m))
            };
            // Enters at one node, slides under load to another, and leaves there.
            let way = [at(from, 0.004), at(from, -DEPTH_M), at(to, -DEPTH_M), at(to, 0.004)];
            let found = stroke(&controller, &way, |_| 0);
            worst.largest_step_n = worst.largest_step_n.max(found.figures.largest_step_n);
            worst.peak_hand_force_n = worst.peak_hand_force_n.max(found.figures.peak_hand_force_n);
            contacts += found.figures.contacts;
            first_n = first_n.max(found.first_n);
            work_j += found.work_j;
            max_given_j = max_given_j.max(found.work_j);
        }
        println!(
            "{name:16} {:8.1} {:9.1} {:7.2} {contacts:9} {:8.2} {:9.3}",
            1e3 * worst.largest_step_n,
            1e3 * first_n,
            worst.peak_hand_force_n,
            1e3 * work_j,
            1e3 * max_given_j
        );
        // 0.1 mm per tick at the largest stiffness of the liver, and the fade of a release.
        assert!(worst.peak_hand_force_n > 1.0 && worst.largest_step_n < 0.3, "{name}: {worst:?}");
        // The tool is at most 0.1 mm deep in its first tick below the surface.
        assert!(first_n < 0.15, "{name}: {first_n} N");
        assert!(contacts as usize >= organ.spaces.len() / 2, "{name}: {contacts}");
        assert!(work_j < 0.0 && max_given_j < 5e-3, "{name}: {work_j} J, {max_given_j} J");
    }
}

/// A stroke from every node of a whole organ to a node at a distance of 2 to 4 cm: `PALPATE_BLOB=organ.blob
/// cargo test --release -p palpate-tests sliding -- --ignored --nocapture`.
#[test]
#[ignore = "needs a blob with many nodes in PALPATE_BLOB; run by hand after a change of packing, for the strokes over a whole organ"]
fn strokes_over_a_whole_organ_have_no_force_jumps() {
    let path = std::env::var_os("PALPATE_BLOB").expect("PALPATE_BLOB names a blob");
    let file = BlobFile::of(&std::fs::read(path).expect("the blob is readable"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    let touch_surface = TouchSurface::new(&organ, &mut memory).expect("the surface is packed");
    println!("{} active nodes", organ.spaces.len());
    let mut config = Config::new(Method::Energy);
    config.limits.ramp_s = 0.0;
    let controller = Controller::new(&organ, config).expect("packed").on_surface(Some(touch_surface));
    let at = |space: &palpate_core::Space<'_>, height_m: f32| {
        vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, height_m))
    };
    let mut found = Vec::new();
    for from in &organ.spaces {
        let apart = |to: &palpate_core::Space<'_>| {
            vec3::distance(from.active.rest_position_m, to.active.rest_position_m)
        };
        let same_side = |to: &palpate_core::Space<'_>| {
            vec3::dot(from.active.outward_normal, to.active.outward_normal) > 0.5
        };
        let near = organ.spaces.iter().find(|to| (0.02..0.04).contains(&apart(to)) && same_side(to));
        let Some(to) = near else { continue };
        let way = [at(from, 0.004), at(from, -DEPTH_M), at(to, -DEPTH_M), at(to, 0.004)];
        found.push((from.active.name.as_str(), to.active.name.as_str(), stroke(&controller, &way, |_| 0)));
    }
    found.sort_by(|a, b| b.2.figures.largest_step_n.total_cmp(&a.2.figures.largest_step_n));
    for (from, to, stroke) in found.iter().take(5) {
        let TouchStatistics { largest_step_n, peak_hand_force_n, .. } = stroke.figures;
        println!("{from} to {to}: step {:.1} mN, peak {peak_hand_force_n:.2} N", 1e3 * largest_step_n);
    }
    let given_j = found.iter().map(|(.., stroke)| stroke.work_j).fold(f64::MIN, f64::max);
    let mut ns: Vec<u64> = found.iter().flat_map(|(.., stroke)| stroke.tick_ns.iter().copied()).collect();
    ns.sort_unstable();
    let late = ns.iter().filter(|&&ns| ns > 1_000_000).count();
    println!(
        "{} strokes, {} ticks: median {} ns, 99.9 % {} ns, {late} above 1 ms; largest work added {:.3} mJ",
        found.len(),
        ns.len(),
        ns[ns.len() / 2],
        ns[ns.len() * 999 / 1000],
        1e3 * given_j
    );
    assert!(found.len() > organ.spaces.len() / 2, "{} strokes", found.len());
    // 0.1 mm per tick at up to 10 N/mm, which a loop of 1 kHz can render stably.
    let (from, to, worst) = &found[0];
    assert!(worst.figures.largest_step_n < 1.0, "{from} to {to}: {:?}", worst.figures);
    assert!(ns[ns.len() * 999 / 1000] < 100_000, "{} ns", ns[ns.len() * 999 / 1000]);
}
