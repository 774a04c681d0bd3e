//! Where a path enters the surface: the lists of triangles compared with a search over all triangles.

use crate::common::ball::{RADIUS_M, ball};
use crate::common::{Random, Recipe, sphere};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Command, Config, Controller, Method, Organ, Sample, State, TouchSurface};

/// A controller for paths of any length and speed.
fn controller<'o>(organ: &'o Organ<'o>, memory: &'o mut Vec<u32>) -> Controller<'o, 'o> {
    let mut config = Config::new(Method::Trilinear);
    (config.limits.max_speed_m_s, config.limits.max_position_m) = (1e9, 1e9);
    config.limits.max_stiffness_n_m = f32::INFINITY;
    config.contact.capture_radius_m = 1.0;
    memory.resize(TouchSurface::words(organ), 0);
    let surface = TouchSurface::new(organ, memory);
    assert!(surface.is_some());
    Controller::new(organ, config).expect("packed").on_surface(surface)
}

/// The point where the path between two samples enters the body, and the command of that tick.
fn crossing(controller: &Controller<'_, '_>, from_m: Vec3, to_m: Vec3) -> Option<(Vec3, Command)> {
    let mut state = State::new();
    state.arm();
    let mut command = None;
    for (t_us, position_m) in [(0, from_m), (1_000, to_m)] {
        let sample = Sample { t_us, position_m, ..Sample::default() };
        command = Some(controller.tick(&mut state, t_us, Some(&sample)));
    }
    let command = command.filter(|command| command.engaged.is_some())?;
    Some((vec3::sub(to_m, command.displacement_m), command))
}

/// The point of the surface that the weights of a command define.
fn foot(organ: &Organ<'_>, command: &Command) -> Vec3 {
    command.weights.iter().fold(vec3::ZERO, |sum, share| {
        let at = organ.spaces[usize::from(share.space)].active.rest_position_m;
        vec3::add(sum, vec3::scale(at, share.weight))
    })
}

/// Each triangle is in all lists of the cells it touches: every path from outside is found, through
/// triangles, edges and vertices.
#[test]
fn every_entry_is_found_and_no_exit() {
    let blob = ball(|_| 1.0, 162);
    let organ = <Organ<'_>>::read(&blob).expect("good");
    let mut memory = Vec::new();
    let controller = controller(&organ, &mut memory);
    let (vertices, triangles) = sphere(RADIUS_M, 2);
    let corner = |i: u32| vertices[i as usize];
    let mut aims = vertices.clone();
    for &[a, b, c] in &triangles {
        let edge = vec3::scale(vec3::add(corner(a), corner(b)), 0.5);
        let third = vec3::scale(vec3::add(vec3::add(corner(a), corner(b)), corner(c)), 1.0 / 3.0);
        aims.extend([edge, third]);
    }
    for aim in aims {
        let (outside, inside) = (vec3::scale(aim, 1.01), vec3::scale(aim, 0.995));
        let (at_m, command) = crossing(&controller, outside, inside).unwrap_or_else(|| panic!("{aim:?}"));
        assert!(vec3::distance(at_m, aim) < 1e-6, "{at_m:?} for {aim:?}");
        assert!(vec3::distance(foot(&organ, &command), aim) < 1e-5, "{command:?} for {aim:?}");
        assert!(crossing(&controller, inside, outside).is_none());
        assert!(crossing(&controller, inside, vec3::scale(aim, 0.99)).is_none());
    }
    // A path of any length, as after a gap in the samples, enters at its first crossing.
    for aim in &vertices {
        let found = crossing(&controller, vec3::scale(*aim, 1.7), vec3::scale(*aim, -3.0));
        let (at_m, _) = found.expect("a path through the whole ball");
        assert!(vec3::distance(at_m, *aim) < 1e-5, "{at_m:?} for {aim:?}");
    }
    assert!(crossing(&controller, [0.1, 0.1, 0.1], [0.101, 0.1, 0.1]).is_none(), "beside the body");
}

/// Random paths against the sphere that the triangles approximate.
#[test]
fn the_cells_contain_every_triangle() {
    let blob = ball(|_| 1.0, 162);
    let organ = <Organ<'_>>::read(&blob).expect("good");
    let mut memory = Vec::new();
    let controller = controller(&organ, &mut memory);
    let mut random = Random(7);
    let mut hits = 0;
    for _ in 0..20_000 {
        let outward = vec3::normalize_or_zero(random.point(1.0));
        let from = vec3::scale(outward, RADIUS_M * (0.97 + 0.05 * random.next().abs()));
        let to = vec3::add(from, random.point(0.002));
        let inside = |p: Vec3| vec3::norm(p) < 0.995 * RADIUS_M * 0.98;
        let is_found = crossing(&controller, from, to).is_some();
        hits += usize::from(is_found);
        if vec3::norm(from) > RADIUS_M && inside(to) {
            assert!(is_found, "{from:?} {to:?}");
        }
        if vec3::norm(to) > RADIUS_M || inside(from) {
            assert!(!is_found, "{from:?} {to:?}");
        }
    }
    assert!(hits > 1_000, "{hits}");
}

/// A path through a ball inside another one enters at the outer surface, whatever the order of the triangles.
#[test]
fn a_long_path_enters_at_its_first_surface() {
    let (outer, triangles) = sphere(RADIUS_M, 4);
    let inner = outer.iter().map(|vertex| vec3::scale(*vertex, 0.97));
    let vertices: Vec<Vec3> = inner.chain(outer.iter().copied()).collect();
    let shifted = |triangle: &[u32; 3]| triangle.map(|vertex| vertex + outer.len() as u32);
    for outer_first in [true, false] {
        let (one, other) = (triangles.iter().copied(), triangles.iter().map(shifted));
        let triangles: Vec<[u32; 3]> =
            if outer_first { other.chain(one).collect() } else { one.chain(other).collect() };
        assert!(triangles.len() > 10_000);
        let body = Some((vertices.clone(), triangles));
        let recipe = Recipe {
            nodes: vec![outer[0]],
            body,
            // Isotropic, so that the model pulls no tool on its path into the body.
            force: |d| d.map(|x| 400.0 * f64::from(x)),
            ghost: |d| d.map(|x| 400.0 * f64::from(x)),
            rbf: false,
            hermite: false,
            displacement: false,
            ..Recipe::default()
        };
        let blob = recipe.blob();
        let organ = <Organ<'_>>::read(&blob).expect("good");
        let mut memory = Vec::new();
        let controller = controller(&organ, &mut memory);
        let mut random = Random(11);
        for _ in 0..500 {
            let from = vec3::scale(vec3::normalize_or_zero(random.point(1.0)), 1.6 * RADIUS_M);
            let to = vec3::add(vec3::scale(from, -1.0), random.point(0.3 * RADIUS_M));
            let (at_m, _) = crossing(&controller, from, to).expect("through both");
            let radius_m = vec3::norm(at_m);
            assert!((0.99..1.001).contains(&(radius_m / RADIUS_M)), "{at_m:?}, {radius_m} m from the centre");
            assert!(vec3::dot(at_m, from) > 0.0, "on the near side: {at_m:?}");
        }
    }
}

/// The memory is bounded even if every triangle spans the body: 200,000 of them would need 26 GB in fine
/// cells.
#[test]
fn the_memory_is_bounded_for_any_triangles() {
    let corners = |n: u32| [3 * n, 3 * n + 1, 3 * n + 2];
    let vertices = (0..1_000).flat_map(|n| {
        let x = 1e-6 * n as f32;
        [[x, -0.1, -0.1], [0.1, 0.1, x], [-0.1, 0.1, 0.1]]
    });
    let body = Some((vertices.collect(), (0..1_000).map(corners).collect()));
    let recipe = Recipe { nodes: vec![[0.0; 3]], body, rbf: false, displacement: false, ..Recipe::default() };
    let blob = recipe.blob();
    let organ = <Organ<'_>>::read(&blob).expect("good");
    let words = TouchSurface::words(&organ);
    assert!(words < 100 * 1_000, "{words} words for 1,000 triangles");
    let mut memory = vec![0; words];
    assert!(TouchSurface::new(&organ, &mut memory[1..]).is_none(), "one word too few");
    assert!(TouchSurface::new(&organ, &mut memory).is_some());
}
