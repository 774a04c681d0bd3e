//! Stability of bodies that are solved without a factor, compared with those that have one.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use crate::fem::body::{Body, Model};
use crate::fem::boundary::{Constraints, Contact, Handle, Pose};
use crate::fem::element::Order;
use crate::fem::material::{Lame, Material, NeoHookean, mooney_rivlin};
use crate::fem::pad::{Fingertip, Pad, PadProfile};
use crate::fem::solve::{Configuration, Problem, Solver};
use crate::mesh::TetMesh;
use crate::mesh::testing::nodes_where;
use crate::pipeline::Analysis;

/// The same problem with factors and, as one of a large body, without.
fn both(body: &Arc<Body>, contact: &Contact) -> [Arc<Problem>; 2] {
    [f64::INFINITY, 0.0].map(|large_flops| {
        let mut free = Problem::with(body.clone(), None, Constraints::Elimination);
        free.newton.large_flops = large_flops;
        Arc::new(free.at(contact.clone()))
    })
}

fn neo_hookean() -> Material {
    Material::NeoHookean(NeoHookean { lame: Lame::from_young_poisson(15480.0, 0.45) })
}

/// Straight columns of 10 x 10 mm, compressed at their end. That of 1.2 m is held at the middle, stays straight and becomes
/// unstable; its small stiffnesses beside large ones have the wrong sign in a factor of single precision.
#[test]
fn the_unstable_modes_without_a_factor_are_those_of_a_factor() {
    // The long one has two modes of each kind, across both of its sides.
    for (law, order, shape, edge_m, step_m, modes) in [
        (neo_hookean(), Order::Linear, [10, 1, 1], 0.01, 2e-3, &[0, 1][..]),
        (mooney_rivlin(), Order::Quadratic, [10, 1, 1], 0.01, 2e-3, &[0]),
        (mooney_rivlin(), Order::Quadratic, [240, 2, 2], 0.005, 1.7e-5, &[0, 2]),
    ] {
        let mesh = TetMesh::cuboid(shape, edge_m);
        let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
        let at_m = [shape[0] as f64 * edge_m, 0.01 - edge_m, 0.01 - edge_m];
        let end = nodes_where(&mesh, |x| (0..3).all(|k| (x[k] - at_m[k]).abs() < 1e-6))[0];
        let body = Arc::new(
            Body::new(&mesh, &Model { order, ..Model::uniform(law.clone(), &fixed) }).expect("a body"),
        );
        let [exact, large] = both(&body, &Handle::node(end).into());
        let (mut exact, mut large) = (Solver::new(exact), Solver::new(large));
        let mut here = exact.rest().expect("the column is fixed");
        let mut seen = BTreeSet::new();
        for step in 1..=10 {
            let Ok(next) = exact.advance(&here.seed, [-step_m * f64::from(step), 0.0, 0.0]) else { break };
            here = next;
            assert_eq!(large.unstable_modes_at(&here.seed), here.unstable_modes, "{} at {step}", law.name());
            seen.insert(here.unstable_modes);
        }
        assert_eq!(seen, modes.iter().copied().map(Some).collect(), "{} {shape:?}", law.name());
    }
}

/// A strip of 100 x 10 x 2 mm, clamped at both ends and bent up by 10 mm, under a soft fingertip.
fn arch() -> [Arc<Problem>; 2] {
    let mut mesh = TetMesh::cuboid([20, 2, 1], 0.005);
    for [x, _, z] in &mut mesh.nodes_m {
        let s = *x / 0.1;
        *z = 0.4 * *z + 0.04 * s * (1.0 - s);
    }
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0 || x[0] > 0.0999);
    let body = Arc::new(Body::new(&mesh, &Model::uniform(neo_hookean(), &fixed)).expect("a body"));
    let tip = Fingertip { radius_m: 0.012, stiffness_pa_m: 1e3, profile: PadProfile::Quartic };
    let top_m = [0.045, 0.005, 0.002 + 0.04 * 0.45 * 0.55];
    let pad = Pad::new(&body, tip, top_m).expect("it touches");
    both(&body, &pad.into())
}

/// The bundled strip, compressed by 10 mm, buckles. Moved across, it snaps to the other side where its branch ends.
#[test]
fn a_strip_snaps_through_without_factors_as_with_them() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/scenes/buckling-strip.toml");
    let strip = Analysis::load(Path::new(path)).expect("it is bundled");
    let (_, tip) = strip.active(None).expect("it has one active node");
    let [with, without] = both(&strip.body, &Handle::node(tip.node).into()).map(|problem| {
        let mut solver = Solver::new(problem);
        let mut way: Vec<Configuration> = vec![solver.rest().expect("the strip is clamped")];
        let compressed = (1..=10).map(|mm| [-1e-3 * f64::from(mm), 0.0, 0.0]);
        let across = (1..=3).map(|n| [-0.01, 0.0, -7.5e-3 * f64::from(n)]);
        for target_m in compressed.chain(across) {
            let next = solver.advance(&way[way.len() - 1].seed, target_m);
            way.push(next.unwrap_or_else(|failure| panic!("at {target_m:?}: {failure}")));
        }
        way
    });
    assert!(with.iter().any(|c| c.switched), "it snaps through");
    for (with, without) in with.iter().zip(&without) {
        let (a, b) = (with.jet(), without.jet());
        let force = (0..3).map(|i| (a.force_n[i] - b.force_n[i]).abs()).fold(0.0, f64::max);
        assert!(force < 1e-4 && with.switched == without.switched, "{force:e} N at {:?}", a.control_m);
    }
}

/// The full Newton steps of a snap-through to a pose of the same branch.
#[test]
fn a_snap_through_without_factors_is_accepted_if_it_is_stable() {
    let found = arch().map(|problem| {
        let mut solver = Solver::new(problem);
        let rest = solver.rest().expect("the arch is clamped").seed;
        let mut guess = rest.state.clone();
        solver
            .snap_through(&rest, &Pose::translation([0.0, 0.0, -0.002]), &mut guess)
            .map(|c| c.jet().force_n)
    });
    let [Some(with), Some(without)] = found else { panic!("{found:?}") };
    assert!((0..3).all(|i| (with[i] - without[i]).abs() < 1e-7), "{with:?} {without:?}");
}
