//! Compression until elements collapse.

use palpate_precompute::fem::material::{Lame, Material, NeoHookean};
use palpate_precompute::fem::{FailureReason, Handle, Model, Solver};
use palpate_tests::{box_mesh, mooney_rivlin, nearest_node, nodes_where, st_venant_kirchhoff};

use super::table::{Case, row};
use super::walk::{Walk, body, organ, problem, walk};

/// A cube of 40 mm, fixed at its bottom; a plate or a point compresses it in steps of 1 mm to nine tenths of
/// its height.
fn press(material: Material, plate: bool, reject_inverted: bool) -> Walk {
    let mesh = box_mesh([4, 4, 4], 0.01);
    let foot = nodes_where(&mesh, |x| x[2] == 0.0);
    let lid = nodes_where(&mesh, |x| (x[2] - 0.04).abs() < 1e-9);
    let centre = nearest_node(&mesh, [0.02, 0.02, 0.04]);
    let handle = if plate { Handle::patch(centre, &lid) } else { Handle::node(centre) };
    let body = body(&mesh, &Model::uniform(material.clone(), &foot));
    let mut solver = Solver::new(problem(&body, handle));
    solver.newton.reject_inverted = reject_inverted;
    let path_result = walk(&mut solver, [0.0, 0.0, -1.0], 1e-3, 36).expect("the cube is fixed");
    let under = if plate { "plate" } else { "point" };
    let kept = if reject_inverted { ", inverted refused" } else { "" };
    let tried = format!("{}, 40 mm cube under a {under}{kept}", material.name());
    let mm = |m: Option<f64>| m.map_or("never".into(), |m| format!("at {:.0} mm", 1e3 * m));
    let verdict = format!("{}; first inverted {}", path_result.verdict(), mm(path_result.inverted_at_m));
    row(Case::Compression, &tried, path_result.cost, &path_result.result(), &verdict);
    path_result
}

fn neo_hookean() -> Material {
    Material::NeoHookean(NeoHookean { lame: Lame::from_young_poisson(15480.0, 0.45) })
}

#[test]
fn a_collapse_has_a_reason_and_a_barrier_delays_it() {
    for plate in [true, false] {
        let collapsed = press(st_venant_kirchhoff(), plate, true);
        let failure = collapsed.failure.expect("St. Venant-Kirchhoff collapses");
        assert!(collapsed.last.inverted == 0 && collapsed.last.min_jacobian > 0.0);
        let known = [FailureReason::Inverted, FailureReason::LineSearch, FailureReason::MaxIterations];
        assert!(known.contains(&failure.reason), "{failure}");
        // Accepted states with inverted elements are flagged.
        let kept = press(st_venant_kirchhoff(), plate, false);
        assert!(kept.failure.is_some() || kept.inverted_at_m.is_some(), "{kept:?}");
        assert!(kept.reached_m >= collapsed.reached_m);

        let barrier = press(neo_hookean(), plate, false);
        assert!(
            barrier.inverted_at_m.is_none() && barrier.last.min_jacobian > 0.0,
            "the barrier law must not invert"
        );
        assert!(barrier.reached_m > collapsed.reached_m, "the barrier law must converge further");
        press(mooney_rivlin(), plate, false);
    }
}

/// Presses into the organ at each active node until the solver fails.
#[test]
fn pressing_into_the_organ_ends_with_a_reason_or_flags() {
    let scene = organ();
    let skin = palpate_precompute::mesh::Surface::of(&scene.mesh);
    for active in &scene.active {
        let inward = skin.normal(active.node).expect("active nodes are on the surface").map(|c| -c);
        for material in [st_venant_kirchhoff(), neo_hookean(), mooney_rivlin()] {
            let mut scene = scene.clone();
            scene.materials[0].material = material.clone();
            let body = body(&scene.mesh, &scene.model());
            let mut solver = Solver::new(problem(&body, Handle::node(active.node)));
            solver.newton.reject_inverted = true;
            let path_result = walk(&mut solver, inward, 2e-3, 50).expect("the organ is fixed");
            let tried = format!("{}, into {}, 100 mm, inverted refused", material.name(), active.name);
            row(Case::Compression, &tried, path_result.cost, &path_result.result(), &path_result.verdict());
            assert!(
                path_result.failure.is_some() || path_result.reached_m > 0.0999,
                "ended without a reason"
            );
            assert!(path_result.inverted_at_m.is_none(), "inverted states were to be refused");
            assert!(
                path_result.reached_m > 0.01,
                "the first centimetre must converge: {:?}",
                path_result.failure
            );
        }
    }
}
