//! Stiffness contrast of one to a million.

use palpate_precompute::fem::material::{Lame, Material, MooneyRivlin, StVenantKirchhoff};
use palpate_precompute::fem::{Configuration, Handle, Model, Solver};
use palpate_tests::{box_mesh, nearest_node, nodes_where};

use super::table::{Case, Cost, row};
use super::walk::{body, norm, problem, relative_error, state, walk};

const CONTRAST: f64 = 1e6;

fn laws(factor: f64) -> [Material; 2] {
    let Lame { lambda_pa, mu_pa } = Lame::from_young_poisson(15480.0, 0.45);
    [
        Material::StVenantKirchhoff(StVenantKirchhoff {
            lame: Lame { lambda_pa: factor * lambda_pa, mu_pa: factor * mu_pa },
        }),
        Material::MooneyRivlin(MooneyRivlin { c10_pa: factor * 1300.0, c01_pa: factor * 1280.0 }),
    ]
}

/// The left half of the beam is stiff, or fixed at all its nodes, or of the same material.
fn solver(right: Material, left_law: Option<Material>, hold_left: bool) -> Solver {
    let mesh = box_mesh([8, 4, 4], 0.01);
    // The lattice planes are irregular inside, so the halves are chosen by element and not by coordinate.
    let left: Vec<bool> = (0..mesh.tets.len()).map(|t| t < mesh.tets.len() / 2).collect();
    let mut held = vec![false; mesh.nodes_m.len()];
    for (tet, _) in mesh.tets.iter().zip(&left).filter(|(_, left)| **left) {
        for &node in tet {
            held[node as usize] = true;
        }
    }
    let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
    let all_left: Vec<u32> = (0..held.len() as u32).filter(|&n| held[n as usize]).collect();
    let mut model = Model::uniform(right, if hold_left { &all_left } else { &fixed });
    if let Some(law) = left_law {
        model.regions.push(law.into());
        model.region_of_tet = left.iter().map(|&left| u16::from(left)).collect();
    }
    let body = body(&mesh, &model);
    let handle = Handle::node(nearest_node(&mesh, [0.08, 0.02, 0.04]));
    Solver::new(problem(&body, handle))
}

fn pull(right: Material, left: Option<Material>, hold_left: bool) -> (Configuration, usize) {
    let mut solver = solver(right, left, hold_left);
    let rest = solver.rest().expect("the beam is fixed");
    let c = solver.advance(&rest.seed, [0.002, 0.003, -0.012]).expect("the beam converges");
    (c, solver.problem().unknowns())
}

#[test]
fn a_stiff_half_acts_like_a_fixed_one() {
    for (soft, stiff) in laws(1.0).into_iter().zip(laws(CONTRAST)) {
        let (wall, equations) = pull(soft.clone(), None, true);
        let name = soft.name();
        row(
            Case::Contrast,
            &format!("{name}, left half fixed"),
            Cost::of(equations, &wall),
            &state(&wall),
            "the limit",
        );
        let (c, equations) = pull(soft.clone(), Some(stiff.clone()), false);
        let error = relative_error(c.jet().force_n, wall.jet().force_n);
        let verdict = format!("force {error:.0e} from the fixed half");
        row(
            Case::Contrast,
            &format!("{name}, left half 1e6 stiffer"),
            Cost::of(equations, &c),
            &state(&c),
            &verdict,
        );
        // The force error is the compliance of the stiff half: the inverse contrast, times a ratio of
        // lengths.
        assert!(error < 100.0 / CONTRAST, "{name}: {error:e}");
        assert!(error > 1e-3 / CONTRAST, "{name}: the stiff half is not in the model");
        let (uniform, _) = pull(soft.clone(), None, false);
        assert!(
            relative_error(uniform.jet().force_n, wall.jet().force_n) > 0.05,
            "{name}: the case is not sensitive"
        );
        // The reverse case: the active node is on a block that is almost rigid.
        let mut block = solver(stiff, Some(soft), false);
        let path_result = walk(&mut block, [0.002, 0.003, -0.012], 1e-3, 12).expect("the beam is fixed");
        let tried = format!("{name}, right half 1e6 stiffer, 12 x 1 mm");
        let work = path_result.work_j / path_result.last.jet().energy_j - 1.0;
        let verdict = format!("{}; work/energy - 1 = {work:.0e}", path_result.verdict());
        row(Case::Contrast, &tried, path_result.cost, &path_result.result(), &verdict);
        assert!(path_result.failure.is_some() || path_result.reached_m > 0.0119);
        assert!(
            path_result.reached_m > 0.0009,
            "{name}: failed in the first millimetre, {:?}",
            path_result.failure
        );
        // The block rotates as a rigid body. The soft half deforms and determines the force.
        let ratio = norm(path_result.last.jet().force_n) / norm(uniform.jet().force_n);
        assert!(ratio < 10.0, "{name}: {ratio} times the force of the soft beam");
        assert!(work.abs() < 1e-2, "{name}: {work:e}");
    }
}
