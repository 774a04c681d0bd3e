//! nu towards 1/2 with and without a pressure: linear elements lock, quadratic ones do not.

use palpate_precompute::fem::material::{Lame, Material, MooneyRivlin, NeoHookean, StVenantKirchhoff};
use palpate_precompute::fem::{Handle, Model, Order, PressurePair, Solver};
use palpate_tests::{box_mesh, nearest_node, nodes_where};

use super::table::{Case, Cost, row};
use super::walk::{body, norm, problem, relative_error, state};

/// Shear modulus, the same for every Poisson ratio.
const MU_PA: f64 = 5160.0;
/// Displacement of the beam's end, small enough for all laws to agree.
const DOWN_M: f64 = 0.001;

/// The beam of 80 x 40 x 40 mm with a rigid right end. A point load would give a mesh-dependent force with
/// any element.
fn bend(
    material: Material,
    order: Order,
    pair: PressurePair,
    tried: &str,
    limit: Option<[f64; 3]>,
) -> [f64; 3] {
    let mesh = box_mesh([8, 4, 4], 0.01);
    let mut model = Model::uniform(material, &nodes_where(&mesh, |x| x[0] == 0.0));
    (model.order, model.pressure_pair) = (order, pair);
    let body = body(&mesh, &model);
    // The nodes of the body, because the rigid end includes mid-edge nodes.
    let at_end = (0u32..).zip(&body.nodes_m).filter(|(_, x)| (x[0] - 0.08).abs() < 1e-9);
    let grip: Vec<u32> = at_end.map(|(n, _)| n).collect();
    let handle = Handle::patch(nearest_node(&mesh, [0.08, 0.02, 0.02]), &grip);
    let mut solver = Solver::new(problem(&body, handle));
    let rest = solver.rest().expect("the beam is fixed");
    let bent = solver.advance(&rest.seed, [0.0, 0.0, -DOWN_M]).expect("the bending converges");
    assert_eq!((bent.inverted, bent.unstable_modes), (0, Some(0)), "{tried}");
    let against = limit.map_or("the limit".into(), |f| {
        format!("force {:+.1} %", 100.0 * (norm(bent.jet().force_n) / norm(f) - 1.0))
    });
    let cost = Cost::of(solver.problem().unknowns(), &bent);
    row(Case::NearlyIncompressible, tried, cost, &state(&bent), &against);
    bent.jet().force_n
}

#[test]
fn linear_elements_lock_and_quadratic_ones_do_not() {
    let plain = PressurePair::Plain;
    let lame = |nu: f64| Lame::from_young_poisson(2.0 * MU_PA * (1.0 + nu), nu);
    let incompressible = Material::MooneyRivlin(MooneyRivlin { c10_pa: 0.5 * MU_PA, c01_pa: 0.0 });
    let limit =
        bend(incompressible.clone(), Order::Quadratic, plain, "incompressible neo-Hookean, P2/P1", None);
    let p1 =
        bend(incompressible.clone(), Order::Linear, plain, "incompressible neo-Hookean, P1/P1", Some(limit));
    let stabilised = PressurePair::Stabilised;
    let name = "incompressible neo-Hookean, P1/P1 stabilised";
    let cured = bend(incompressible, Order::Linear, stabilised, name, Some(limit));
    for (name, force) in [("plain", p1), ("stabilised", cured)] {
        let excess = norm(force) / norm(limit) - 1.0;
        assert!((0.0..0.5).contains(&excess), "P1/P1 {name} must not lock: {excess:+.3}");
    }
    type Law = fn(Lame) -> Material;
    let laws: [(&str, Law); 2] = [
        ("StVK", |lame| Material::StVenantKirchhoff(StVenantKirchhoff { lame })),
        ("neo-Hookean", |lame| Material::NeoHookean(NeoHookean { lame })),
    ];
    for (name, law) in laws {
        let forces = [0.49, 0.499, 0.4999].map(|nu| {
            [(Order::Linear, "P1"), (Order::Quadratic, "P2")].map(|(order, element)| {
                let tried = format!("{name}, nu = {nu}, {element}");
                bend(law(lame(nu)), order, plain, &tried, Some(limit))
            })
        });
        let excess = forces.map(|pair| pair.map(|f| norm(f) / norm(limit) - 1.0));
        for step in excess.windows(2) {
            assert!(step[1][0] > step[0][0] + 0.1, "{name}: P1 locks with nu: {excess:?}");
        }
        assert!(excess[2][0] > 1.0, "{name}: P1 at nu = .4999 must lock: {excess:?}");
        let free = excess.iter().all(|e| e[1].abs() < 0.1);
        assert!(free, "{name}: P2 must stay near the limit: {excess:?}");
        assert!(
            relative_error(forces[0][1], limit) < 0.04,
            "{name}: P2 at nu = .49 must be near the limit: {excess:?}"
        );
    }
}
