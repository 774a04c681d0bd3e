//! A fingertip presses and does not pull: its contact ends where the hand leaves the skin, and no closed path
//! over the skin gives energy to the hand. The blob is one of contact points on the bundled organ.

use std::path::Path;
use std::sync::OnceLock;

use palpate_core::{
    Config, Controller, Method, Organ, Phase, Sample, Space, State, TouchSurface, Vec3, vec3,
};
use palpate_host::BlobFile;
use palpate_precompute::fem::{Fingertip, PadProfile};
use palpate_precompute::mesh::{Surface, TetMesh};
use palpate_precompute::num::distance;
use palpate_precompute::scene::{ActiveNode, Scene};
use palpate_precompute::spec::{SpaceGrid, Tool};
use palpate_tests::coarse_blob::coarse_blob;

/// Radius of the patch round A1 that contact points cover, m.
const PATCH_M: f64 = 0.026;
/// Depth of the tool, m.
const DEPTH_M: f32 = 0.008;
/// Height from which it comes, and to which it leaves, m.
const ABOVE_M: f32 = 0.004;
/// Step of the hand in a tick of 1 ms, m.
const STEP_M: f32 = 1e-4;

/// Contact points at the nodes of a patch of the organ, and the triangles between them.
fn fingertip_blob() -> BlobFile {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    let mut scene = Scene::load(&assets).expect("sound").resolve().expect("sound");
    let mesh: &TetMesh = &scene.mesh;
    let place_m = |node: u32| mesh.nodes_m[node as usize];
    let centre_m = place_m(scene.active[0].node);
    let surface = Surface::of(mesh);
    let nodes: Vec<u32> =
        surface.nodes.iter().copied().filter(|node| distance(place_m(*node), centre_m) < PATCH_M).collect();
    let point = |node: &u32| ActiveNode {
        contact: surface.nearest(mesh, place_m(*node)),
        ..ActiveNode::node(format!("P{node}"), *node)
    };
    let active = nodes.iter().map(point).collect();
    let index = |node: u32| Some(nodes.iter().position(|of| *of == node)? as u32);
    let corners = |&[a, b, c]: &[u32; 3]| Some([index(a)?, index(b)?, index(c)?]);
    let triangles = surface.triangles.iter().filter_map(corners).collect();
    (scene.active, scene.contact_triangles) = (active, triangles);
    scene.tool =
        Tool::Fingertip(Fingertip { radius_m: 0.015, stiffness_pa_m: 2e6, profile: PadProfile::Quartic });
    coarse_blob(&scene, SpaceGrid::new(0.01, 0.02).expect("valid"), &[Method::Energy, Method::Hermite])
}

/// One tick of the hand.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Tick {
    hip_m: Vec3,
    reaction_n: Vec3,
    hand_force_n: Vec3,
    engaged: Option<u16>,
    /// Tension h . n along the normal between the contact points, N.
    tension_n: f32,
}

/// The hand on straight lines through these points; it is armed and never faults.
fn hand(controller: &Controller<'_, '_>, state: &mut State, now_ms: &mut u64, through: &[Vec3]) -> Vec<Tick> {
    let mut ticks = Vec::new();
    for ends in through.windows(2) {
        let steps = (vec3::distance(ends[0], ends[1]) / STEP_M).ceil().max(1.0) as usize;
        for step in 1..=steps {
            let way_m = vec3::scale(vec3::sub(ends[1], ends[0]), step as f32 / steps as f32);
            *now_ms += 1;
            let sample =
                Sample { t_us: 1_000 * *now_ms, position_m: vec3::add(ends[0], way_m), ..Sample::default() };
            let command = controller.tick(state, sample.t_us, Some(&sample));
            assert_eq!(command.phase, Phase::Active, "{command:?}");
            let normals = command.weights.iter().filter(|node| node.weight > 0.0).map(|node| {
                let space = &controller.organ().spaces[usize::from(node.space)];
                vec3::scale(space.active.outward_normal, node.weight)
            });
            let normal = vec3::normalize_or_zero(normals.fold(vec3::ZERO, vec3::add));
            ticks.push(Tick {
                hip_m: sample.position_m,
                reaction_n: command.reaction_n,
                hand_force_n: command.hand_force_n,
                engaged: command.engaged,
                tension_n: vec3::dot(command.reaction_n, normal),
            });
        }
    }
    ticks
}

/// Work on the body along the path, J.
fn work_j(ticks: &[Tick]) -> f64 {
    let of = |pair: &[Tick]| {
        let mean_n = vec3::scale(vec3::add(pair[0].reaction_n, pair[1].reaction_n), 0.5);
        f64::from(vec3::dot(mean_n, vec3::sub(pair[1].hip_m, pair[0].hip_m)))
    };
    ticks.windows(2).map(of).sum()
}

fn at(space: &Space<'_>, height_m: f32) -> Vec3 {
    vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, height_m))
}

/// Settings without the ramp of arming and without limits of the device.
fn config(method: Method, friction: f32) -> Config {
    let mut config = Config::new(method);
    config.limits.ramp_s = 0.0;
    config.limits.max_stiffness_n_m = f32::INFINITY;
    config.contact.friction = friction;
    config
}

fn armed() -> State {
    let mut state = State::new();
    state.arm();
    state
}

/// Runs a test on the blob, which is made once.
fn on_the_organ(test: impl FnOnce(&Organ<'_>, TouchSurface<'_>)) {
    static BLOB: OnceLock<BlobFile> = OnceLock::new();
    let organ: Organ<'_> = Organ::read(BLOB.get_or_init(fingertip_blob).bytes()).expect("a valid blob");
    let triangles = organ.contact.triangles.len();
    assert!(organ.tool.fingertip().is_some() && triangles > 8, "{triangles} triangles of contact points");
    let mut memory = vec![0; TouchSurface::words(&organ)];
    test(&organ, TouchSurface::new(&organ, &mut memory).expect("contact points"));
}

#[test]
fn a_fingertip_that_leaves_the_skin_lets_go_and_touches_again() {
    on_the_organ(straight_away);
}

#[test]
fn a_fingertip_that_is_drawn_aside_lets_go_where_the_skin_would_pull() {
    on_the_organ(aside);
}

#[test]
fn a_closed_path_of_press_slide_pull_and_return_gives_no_energy_to_the_hand() {
    on_the_organ(closed_paths);
}

/// Straight out of the skin and in again, at every contact point: the second touch is the first.
fn straight_away(organ: &Organ<'_>, surface: TouchSurface<'_>) {
    for friction in [0.3, f32::INFINITY] {
        let controller = Controller::new(organ, config(Method::Energy, friction))
            .expect("packed")
            .on_surface(Some(surface));
        let (mut touched, fade) = (0, 60);
        for space in &organ.spaces {
            let (mut state, mut now_ms) = (armed(), 0);
            let way = [at(space, ABOVE_M), at(space, -DEPTH_M), at(space, ABOVE_M)];
            let first = hand(&controller, &mut state, &mut now_ms, &way);
            let deepest = first.iter().map(|tick| -tick.tension_n).fold(0.0, f32::max);
            if deepest < 0.1 {
                // The rim of the patch: the path crosses no triangle of contact points.
                continue;
            }
            touched += 1;
            let name = space.active.name.as_str();
            let largest_n = first.iter().map(|tick| tick.tension_n).fold(0.0, f32::max);
            assert!(
                largest_n <= controller.config().contact.release_tension_n,
                "{name}: pulls {largest_n} N"
            );
            let last = first.last().expect("ticks");
            assert_eq!((last.engaged, last.reaction_n), (None, vec3::ZERO), "{name}");
            let rest = hand(&controller, &mut state, &mut now_ms, &vec![at(space, ABOVE_M); fade]);
            assert_eq!(rest.last().expect("ticks").hand_force_n, vec3::ZERO, "{name}: the fade has ended");
            let second = hand(&controller, &mut state, &mut now_ms, &way);
            let forces =
                |ticks: &[Tick]| ticks.iter().map(|tick| (tick.engaged, tick.reaction_n)).collect::<Vec<_>>();
            assert_eq!(forces(&first), forces(&second), "{name}: the second touch");
        }
        assert!(2 * touched > organ.spaces.len(), "{touched} of {}", organ.spaces.len());
    }
}

/// A finger that sticks and is drawn aside and up: the tension is at most that of release, where a tool that
/// is never released is pulled much more.
fn aside(organ: &Organ<'_>, surface: TouchSurface<'_>) {
    let largest = |releases: bool| {
        let mut config = config(Method::Energy, f32::INFINITY);
        if !releases {
            (config.contact.release_tension_n, config.contact.release_height_m) = (f32::MAX, 1.0);
        }
        let controller = Controller::new(organ, config).expect("packed").on_surface(Some(surface));
        let (mut tension_n, mut ended_free, mut count) = (0.0_f32, 0, 0);
        for space in &organ.spaces {
            for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
                let (mut state, mut now_ms) = (armed(), 0);
                let normal = space.active.outward_normal;
                let first = vec3::normalize_or_zero(vec3::cross(normal, [0.3, 0.9, 0.2]));
                let second = vec3::cross(normal, first);
                let away_m = vec3::add(vec3::scale(first, 0.012 * x), vec3::scale(second, 0.012 * y));
                let top_m = vec3::add(at(space, 0.012), away_m);
                let way = [at(space, ABOVE_M), at(space, -0.002), top_m];
                let ticks = hand(&controller, &mut state, &mut now_ms, &way);
                if ticks.iter().all(|tick| tick.engaged.is_none()) {
                    continue;
                }
                count += 1;
                ended_free += usize::from(ticks.last().expect("ticks").reaction_n == vec3::ZERO);
                tension_n = ticks.iter().map(|tick| tick.tension_n).fold(tension_n, f32::max);
            }
        }
        (tension_n, ended_free, count)
    };
    let (released, held) = (largest(true), largest(false));
    println!("largest tension: {} N; never released {} N", released.0, held.0);
    assert!(released.0 <= 0.2 && released.1 == released.2 && released.2 > 20, "{released:?}");
    assert!(held.0 > 0.5 && held.1 == 0, "{held:?}");
}

/// Press, slide, pull and return through the air. The cubics have the same forces at the configurations and no
/// energy, so their slip follows the force alone and gives energy to the hand on some path.
fn closed_paths(organ: &Organ<'_>, surface: TouchSurface<'_>) {
    let mut least_j = [f64::MAX; 2];
    for friction in [0.0, 0.05, 0.3, f32::INFINITY] {
        for (least_j, method) in least_j.iter_mut().zip([Method::Energy, Method::Hermite]) {
            let config = config(method, friction);
            let controller = Controller::new(organ, config).expect("packed").on_surface(Some(surface));
            let mut works_j: Vec<f64> = Vec::new();
            for (i, from) in organ.spaces.iter().enumerate() {
                // Short slides dissipate little, so they show best what is given back.
                for (by, share) in [(1, 0.05), (2, 0.1), (5, 0.1), (3, 0.2), (4, 0.5), (5, 1.0)] {
                    let to = &organ.spaces[(i + by) % organ.spaces.len()];
                    works_j.extend(closed_path(&controller, from, to, share));
                }
            }
            let (low_j, high_j) = works_j
                .iter()
                .fold((f64::MAX, 0.0_f64), |(low, high), work| (low.min(*work), high.max(*work)));
            println!(
                "friction {friction}, {method:?}: {} paths, work on the body {:.4} to {:.2} mJ",
                works_j.len(),
                1e3 * low_j,
                1e3 * high_j
            );
            assert!(works_j.len() > 50);
            *least_j = least_j.min(low_j);
        }
    }
    let [with_j, without_j] = least_j;
    assert!(with_j > -2e-6, "the hand receives {with_j} J");
    assert!(without_j < -1e-4, "the paths are too easy: {without_j}");
}

/// Work on the body, J; `None` if the path crosses no triangle of contact points.
fn closed_path(controller: &Controller<'_, '_>, from: &Space<'_>, to: &Space<'_>, share: f32) -> Option<f64> {
    let part = |height_m: f32| {
        let [start_m, end_m] = [from, to].map(|space| at(space, height_m));
        vec3::add(start_m, vec3::scale(vec3::sub(end_m, start_m), share))
    };
    let way = [
        at(from, ABOVE_M),
        at(from, -DEPTH_M),
        part(-DEPTH_M),
        part(3.0 * ABOVE_M),
        at(from, 3.0 * ABOVE_M),
        at(from, ABOVE_M),
    ];
    let ticks = hand(controller, &mut armed(), &mut 0, &way);
    assert_eq!(ticks.last().expect("ticks").reaction_n, vec3::ZERO, "the path is closed");
    ticks.iter().any(|tick| tick.engaged.is_some()).then(|| work_j(&ticks))
}
