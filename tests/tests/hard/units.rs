//! Scaled bodies: the solver must be independent of the units.

use palpate_precompute::fem::material::{Material, Value};
use palpate_precompute::fem::{Body, Handle, Model, Order, PressurePair, Solver};
use palpate_tests::{beam, livers, nearest_node, nodes_where};

use super::meshes::scaled;
use super::table::{Case, Cost, row};
use super::walk::{problem, relative_error};

/// The law with all moduli scaled by `factor`.
fn stiffer(law: &Material, factor: f64) -> Material {
    let scaled = law.parameters().into_iter().map(|(key, value)| match value {
        Value::Number(number) if key.ends_with("_pa") => (key, (number * factor).into()),
        _ => (key, value),
    });
    let scaled: Vec<_> = scaled.collect();
    Material::from_parameters(law.name(), &scaled).expect("a positive factor makes the same law, stiffer")
}

#[test]
fn forces_scale_with_size_and_stiffness_over_twelve_decades() {
    let plain = PressurePair::Plain;
    let mut cases: Vec<(Material, Order, PressurePair)> =
        livers().into_iter().map(|law| (law, Order::Linear, plain)).collect();
    cases.push((palpate_tests::mooney_rivlin(), Order::Quadratic, plain));
    cases.push((palpate_tests::mooney_rivlin(), Order::Linear, PressurePair::Stabilised));
    for (law, order, pair) in cases {
        let solve = |size: f64, stiffness: f64| {
            let mesh = scaled(&beam(), size);
            let fixed = nodes_where(&mesh, |x| x[0] == 0.0);
            let mut model = Model::uniform(stiffer(&law, stiffness), &fixed);
            (model.order, model.pressure_pair) = (order, pair);
            let body = std::sync::Arc::new(Body::new(&mesh, &model).expect("every element has volume"));
            assert_eq!(body.check_pressures(None), Ok(()), "size {size:e}");
            let node = nearest_node(&mesh, [0.06, 0.02, 0.04].map(|c| c * size));
            let mut solver = Solver::new(problem(&body, Handle::node(node)));
            let rest = solver.rest().expect("the beam is fixed");
            let d = [0.004, -0.003, -0.01].map(|c| c * size);
            (solver.advance(&rest.seed, d).expect("the beam converges"), solver.problem().unknowns())
        };
        let (here, equations) = solve(1.0, 1.0);
        let (mut worst, mut iterations) = (0.0f64, [u32::MAX, 0]);
        for (size, stiffness) in [(1e-6, 1.0), (1e6, 1.0), (1.0, 1e-6), (1.0, 1e6), (1e-6, 1e6), (1e6, 1e-6)]
        {
            let (there, _) = solve(size, stiffness);
            let force = there.jet().force_n.map(|f| f / (size * size * stiffness));
            let energy = there.jet().energy_j / (size * size * size * stiffness);
            let error =
                relative_error(force, here.jet().force_n).max((energy / here.jet().energy_j - 1.0).abs());
            assert!(
                error < 1e-9,
                "{} {order:?}, size {size:e}, stiffness {stiffness:e}: {error:e}",
                law.name()
            );
            worst = worst.max(error);
            iterations = [iterations[0].min(there.iterations), iterations[1].max(there.iterations)];
        }
        let tried = format!("{}, {order:?}, {pair:?}: size, stiffness and both x 1e-6, 1e6", law.name());
        let [min, max] = iterations;
        let result = format!("force and energy error {worst:.0e}; {min} to {max} iterations");
        row(Case::Units, &tried, Cost::of(equations, &here), &result, "scale");
        assert!(max <= here.iterations + 1, "{}: {max} against {}", law.name(), here.iterations);
    }
}
