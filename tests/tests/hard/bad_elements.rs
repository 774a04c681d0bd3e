//! Slivers and large ratios of element size, compared with exact solutions.

use palpate_precompute::fem::material::{Lame, Material, NeoHookean, StVenantKirchhoff};
use palpate_precompute::fem::{Configuration, Handle, Model, Order, Solver};
use palpate_precompute::mesh::{MeshReport, TetMesh};
use palpate_tests::{mooney_rivlin, nearest_node, nodes_where};

use super::meshes::{box_of_five, nested_cubes};
use super::table::{Case, Cost, row};
use super::walk::{body, problem, relative_error, state};

fn lame() -> Lame {
    Lame::from_young_poisson(15480.0, 0.45)
}

/// Confined compression of a box to the stretch l of its height: F = diag(1, 1, l) on any mesh. The force on
/// the lid is its area times P33.
///
/// StVK: P33 = l (lambda + 2 mu) (l^2 - 1) / 2.   Neo-Hookean: P33 = mu (l - 1/l) + lambda ln(l) / l.
fn confined(mesh: &TetMesh, material: Material, order: Order) -> (Configuration, usize, f64) {
    const STRETCH: f64 = 0.95;
    let (low, high) = mesh.bounding_box_m();
    let tiny = 1e-9 * high[2];
    let on = |c: f64, side: f64| (c - side).abs() < tiny;
    let mut model = Model::uniform(material.clone(), &nodes_where(mesh, |x| on(x[2], low[2])));
    model.order = order;
    let sides = (0u32..).zip(&mesh.nodes_m).map(|(n, x)| {
        (n, std::array::from_fn(|axis| axis < 2 && (on(x[axis], low[axis]) || on(x[axis], high[axis]))))
    });
    model.rollers = sides.collect();
    let lid = nodes_where(mesh, |x| on(x[2], high[2]));
    let mut body = palpate_precompute::fem::Body::new(mesh, &model).expect("every element has volume");
    // The prescribed nodes include the mid-edge nodes of the lid.
    let plate: Vec<u32> =
        (0u32..).zip(&body.nodes_m).filter(|(_, x)| on(x[2], high[2])).map(|(n, _)| n).collect();
    for &node in &plate {
        body.fixed[node as usize] = [false; 3];
    }
    let mut solver = Solver::new(problem(&std::sync::Arc::new(body), Handle::patch(lid[0], &plate)));
    let rest = solver.rest().expect("the box is fixed");
    let height = high[2] - low[2];
    let c = solver
        .advance(&rest.seed, [0.0, 0.0, (STRETCH - 1.0) * height])
        .expect("a compression of 5 % converges");
    let Lame { lambda_pa, mu_pa } = lame();
    let stress = match material {
        Material::StVenantKirchhoff(_) => {
            STRETCH * (lambda_pa + 2.0 * mu_pa) * 0.5 * (STRETCH * STRETCH - 1.0)
        }
        _ => mu_pa * (STRETCH - 1.0 / STRETCH) + lambda_pa * STRETCH.ln() / STRETCH,
    };
    let exact = stress * (high[0] - low[0]) * (high[1] - low[1]);
    let error = (c.jet().force_n[2] / exact - 1.0).abs();
    (c, solver.problem().unknowns(), error)
}

#[test]
fn confined_compression_is_exact_on_bad_meshes() {
    let slivers = |gap| box_of_five([4, 2, 2], 0.02, Some(gap));
    let meshes = [
        ("regular box", box_of_five([4, 2, 2], 0.02, None), 30.0),
        ("slivers, gap 1/500 edge", slivers(2e-3), 1.0),
        ("slivers, gap 1e-5 edge", slivers(1e-5), 0.01),
        ("sizes 1024:1 in ten shells", nested_cubes(0.1, 2.0, 10), 60.0),
        ("sizes 1000:1 in one shell", nested_cubes(0.1, 1000.0, 1), 60.0),
    ];
    for (name, mesh, dihedral_below_deg) in &meshes {
        let report = MeshReport::of(mesh);
        assert!(report.dihedral_deg.min < *dihedral_below_deg + 30.0, "{name}: {:?}", report.dihedral_deg);
        if name.starts_with("slivers") {
            assert!(report.dihedral_deg.min < *dihedral_below_deg, "{name}: {:?}", report.dihedral_deg);
        }
        if name.starts_with("sizes") {
            assert!(report.edge_m.max / report.edge_m.min > 999.0, "{name}: {:?}", report.edge_m);
        }
        for material in [
            Material::StVenantKirchhoff(StVenantKirchhoff { lame: lame() }),
            Material::NeoHookean(NeoHookean { lame: lame() }),
        ] {
            for order in [Order::Linear, Order::Quadratic] {
                let (c, equations, error) = confined(mesh, material.clone(), order);
                let tried = format!("confined, {}, {order:?}, {name}", material.name());
                let dihedral = report.dihedral_deg.min;
                let verdict = format!("{error:.0e} from exact; dihedral {dihedral:.3} deg");
                row(Case::BadElements, &tried, Cost::of(equations, &c), &state(&c), &verdict);
                assert!(error < 1e-9, "{tried}: {error:e}");
                // At 5 % St. Venant-Kirchhoff is still elliptic, so no mesh may show an unstable mode.
                assert_eq!((c.inverted, c.unstable_modes), (0, Some(0)), "{tried}");
                assert!((c.min_jacobian - 0.95).abs() < 1e-6, "{tried}: not homogeneous, {}", c.min_jacobian);
            }
        }
    }
}

/// A box sheared by its lid, compared with the same box without slivers.
#[test]
fn slivers_change_force_and_iterations_little() {
    for material in [
        Material::StVenantKirchhoff(StVenantKirchhoff { lame: lame() }),
        Material::NeoHookean(NeoHookean { lame: lame() }),
        mooney_rivlin(),
    ] {
        let mut regular: Option<Configuration> = None;
        for gap in [None, Some(2e-3), Some(1e-5)] {
            let mesh = box_of_five([4, 4, 4], 0.02, gap);
            let model = Model::uniform(material.clone(), &nodes_where(&mesh, |x| x[2] == 0.0));
            let body = body(&mesh, &model);
            let lid = nodes_where(&mesh, |x| (x[2] - 0.08).abs() < 1e-9);
            let handle = Handle::patch(nearest_node(&mesh, [0.04, 0.04, 0.08]), &lid);
            let mut solver = Solver::new(problem(&body, handle));
            let rest = solver.rest().expect("the box is fixed");
            let c = solver.advance(&rest.seed, [0.02, 0.0, -0.004]).expect("the box converges");
            let tried = format!("sheared 20 mm, {}, gap {gap:?}", material.name());
            let error = regular.as_ref().map_or(0.0, |r| relative_error(c.jet().force_n, r.jet().force_n));
            let verdict = format!("force {:.1} % from the regular box", 100.0 * error);
            row(Case::BadElements, &tried, Cost::of(solver.problem().unknowns(), &c), &state(&c), &verdict);
            // The effect of the diagonals of one element layer at this element size.
            assert!(error < 0.20, "{tried}: {error}");
            let first = regular.get_or_insert_with(|| c.clone());
            assert!(c.iterations <= first.iterations + 6, "{tried}: {} iterations", c.iterations);
            assert!(c.residual_n < 1e-8, "{tried}: {:e} N", c.residual_n);
        }
    }
}
