//! The pressurised thick incompressible sphere compared with its closed form.
//!
//! An incompressible shell A <= R <= B that expands radially has r^3 = R^3 + a^3 - A^3. With lambda = r / R
//! the stretches are (lambda^-2, lambda, lambda). Mooney-Rivlin gives
//!
//! sigma_t - sigma_r = 2 C10 (lambda^2 - lambda^-4) + 2 C01 (lambda^4 - lambda^-2),
//!
//! and equilibrium, d sigma_r / dr = 2 (sigma_t - sigma_r) / r with a free outside, gives the inner pressure
//! P = int_a^b 2 (sigma_t - sigma_r) / r dr (Green and Zerna 1968, section 3.10). For the exact solution it
//! is the dead radial load P (a / A)^2 per undeformed area. The model has this load, and must have the inner
//! radius a. It is an eighth of the sphere with symmetry conditions on its planes.

use nalgebra::Vector3;
use palpate_precompute::fem::{Body, Model, Order, PressurePair, solve_body_force};
use palpate_precompute::mesh::TetMesh;
use palpate_tests::mooney_rivlin;

const INNER_M: f64 = 0.01;
const OUTER_M: f64 = 0.02;
/// Deformed inner radius: 30 % stretch at the inside.
const INFLATED_M: f64 = 0.013;

/// An eighth of a shell: `n` edges along each side of the octant, `n` layers. The nodes of a layer are those
/// of a triangular grid, projected onto their sphere.
fn octant(n: usize) -> (TetMesh, Vec<[u32; 3]>) {
    let mut nodes_m = Vec::new();
    let mut index = std::collections::HashMap::new();
    for layer in 0..=n {
        let radius = INNER_M + (OUTER_M - INNER_M) * layer as f64 / n as f64;
        for i in 0..=n {
            for j in 0..=n - i {
                let direction = Vector3::new(i as f64, j as f64, (n - i - j) as f64).normalize();
                index.insert((layer, i, j), nodes_m.len() as u32);
                nodes_m.push((direction * radius).into());
            }
        }
    }
    let mut tets = Vec::new();
    let mut inside = Vec::new();
    for i in 0..n {
        for j in 0..n - i {
            let mut triangles = vec![[(i, j), (i + 1, j), (i, j + 1)]];
            if i + j + 2 <= n {
                triangles.push([(i + 1, j), (i + 1, j + 1), (i, j + 1)]);
            }
            for mut corners in triangles {
                // The order of a face's corners is the same from both sides, so that neighbouring prisms
                // split it alike.
                corners.sort_by_key(|&(i, j)| index[&(0, i, j)]);
                for layer in 0..n {
                    let at = |level: usize, corner: usize| {
                        let (i, j) = corners[corner];
                        index[&(level, i, j)]
                    };
                    let [a, b, c] = [0, 1, 2].map(|corner| at(layer, corner));
                    let [d, e, f] = [0, 1, 2].map(|corner| at(layer + 1, corner));
                    if layer == 0 {
                        inside.push([a, b, c]);
                    }
                    for mut tet in [[a, b, c, f], [a, b, e, f], [a, d, e, f]] {
                        let x = tet.map(|node: u32| Vector3::<f64>::from(nodes_m[node as usize]));
                        if (x[1] - x[0]).cross(&(x[2] - x[0])).dot(&(x[3] - x[0])) < 0.0 {
                            tet.swap(0, 1);
                        }
                        tets.push(tet);
                    }
                }
            }
        }
    }
    (TetMesh::new(nodes_m, tets).expect("the octant is a valid mesh"), inside)
}

/// Inner pressure that expands the shell to the inner radius `INFLATED_M`, by Simpson's rule.
fn exact_pressure_pa() -> f64 {
    let (c10, c01) = (1300.0, 1280.0);
    let cubes = INFLATED_M.powi(3) - INNER_M.powi(3);
    let outer = (OUTER_M.powi(3) + cubes).cbrt();
    let slope = |r: f64| {
        let l = r / (r.powi(3) - cubes).cbrt();
        2.0 / r * (2.0 * c10 * (l.powi(2) - l.powi(-4)) + 2.0 * c01 * (l.powi(4) - l.powi(-2)))
    };
    let steps = 2000;
    let h = (outer - INFLATED_M) / f64::from(steps);
    let sum: f64 = (0..=steps)
        .map(|k| {
            let weight = if k == 0 || k == steps { 1.0 } else { 2.0 + 2.0 * f64::from(k % 2) };
            weight * slope(INFLATED_M + f64::from(k) * h)
        })
        .sum();
    sum * h / 3.0
}

/// Relative error of the mean deformed radius of the inner vertices.
fn error(n: usize, order: Order, pressure_pair: PressurePair) -> f64 {
    let (mesh, inside) = octant(n);
    let on = |x: &[f64; 3]| x.map(|c| c.abs() < 1e-12);
    let rollers = (0u32..).zip(&mesh.nodes_m).map(|(node, x)| (node, on(x))).collect();
    let model = Model { order, pressure_pair, rollers, ..Model::uniform(mooney_rivlin(), &[]) };
    let mut body = Body::new(&mesh, &model).expect("every element has volume");
    // The flat triangles have less area than the sphere, and must carry its load.
    let flat_m2: f64 = inside
        .iter()
        .map(|t| {
            let x = t.map(|node| Vector3::from(mesh.nodes_m[node as usize]));
            0.5 * (x[1] - x[0]).cross(&(x[2] - x[0])).norm()
        })
        .sum();
    let sphere_m2 = 0.5 * std::f64::consts::PI * INNER_M.powi(2);
    let traction_pa = exact_pressure_pa() * (INFLATED_M / INNER_M).powi(2) * sphere_m2 / flat_m2;
    for triangle in &inside {
        let x = triangle.map(|node| Vector3::from(mesh.nodes_m[node as usize]));
        let area = 0.5 * (x[1] - x[0]).cross(&(x[2] - x[0])).norm();
        // Linear: a third on each corner. Quadratic: a third on each mid-edge node, none on the corners.
        let loaded: Vec<u32> = match order {
            Order::Linear => triangle.to_vec(),
            Order::Quadratic => [(0, 1), (1, 2), (2, 0)]
                .map(|(a, b)| {
                    let middle = (x[a] + x[b]) * 0.5;
                    let near = |m: &[f64; 3]| (Vector3::from(*m) - middle).norm() < 1e-12;
                    let found = body.nodes_m[mesh.nodes_m.len()..].iter().position(near);
                    (found.expect("every edge has its node") + mesh.nodes_m.len()) as u32
                })
                .to_vec(),
        };
        for node in loaded {
            let outward = Vector3::from(body.nodes_m[node as usize]).normalize();
            for axis in 0..3 {
                body.external_force_n[3 * node as usize + axis] += traction_pa * area / 3.0 * outward[axis];
            }
        }
    }
    let body = solve_body_force(body).expect("the shell converges");
    let mut vertices: Vec<u32> = inside.concat();
    vertices.sort_unstable();
    vertices.dedup();
    let mean = vertices.iter().map(|&n| Vector3::from(body.rest_position_m(n)).norm()).sum::<f64>()
        / vertices.len() as f64;
    (mean - INNER_M) / (INFLATED_M - INNER_M) - 1.0
}

#[test]
fn the_inflated_sphere_has_the_radius_of_the_closed_form() {
    println!("inner pressure {:.3} Pa expands {INNER_M} m to {INFLATED_M} m", exact_pressure_pa());
    for (name, order, pair, sizes, allowed, least_order) in [
        ("P2/P1", Order::Quadratic, PressurePair::Plain, [4, 6, 9], 0.005, 1.6),
        // Softening by the projection and stiffening by the linear displacements partly cancel.
        ("P1/P1 stabilised", Order::Linear, PressurePair::Stabilised, [4, 8, 12], 0.002, 1.3),
    ] {
        let errors = sizes.map(|n| error(n, order, pair));
        println!(
            "{name:18} error of the expansion {:+.2e} {:+.2e} {:+.2e} with {sizes:?} layers",
            errors[0], errors[1], errors[2]
        );
        // Straight edges cut the sphere's corners, an error of second order for any element.
        let observed = (errors[1] / errors[2]).abs().ln() / (sizes[2] as f64 / sizes[1] as f64).ln();
        println!("{name:18} observed order {observed:.2}");
        assert!(errors[2].abs() < allowed && observed > least_order, "{name}");
    }
}
