//! Manufactured solutions: a chosen displacement, the body force that makes it an equilibrium, and the order
//! of convergence of the error.
//!
//! The body force is -Div P(F*), by fourth-order differences of the law's stress. It is integrated, like the
//! errors, with fourteen points. The boundary of the cube is fixed where u* vanishes, and loaded by its
//! tractions elsewhere. Expected orders: tet4 2 in L2 and 1 in H1, tet10 3 and 2, the pressure of P2/P1 2 in
//! L2. The meshes are irregular and not nested, so the observed orders scatter by about 0.2.

use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;

use crate::fem::body::{Body, Model};
use crate::fem::element::{EDGES, Order, QUADRATIC, shape_gradients};
use crate::fem::kinematics::Kinematics;
use crate::fem::material::{Lame, LinearElastic, Material, NeoHookean, StVenantKirchhoff, mooney_rivlin};
use crate::fem::pressure::PressurePair;
use crate::fem::solve::solve_body_force;
use crate::mesh::TetMesh;
use crate::mesh::testing::{box_mesh, nodes_where};
use crate::num::tensor::Vec3;

/// The chosen fields on the unit cube.
struct Solution {
    displacement: fn(&Vector3<f64>) -> Vector3<f64>,
    /// Excess pressure, Pa.
    pressure: fn(&Vector3<f64>) -> f64,
    /// Whether the faces x = 0 and x = 1 are loaded by their tractions instead of fixed.
    loaded_faces: bool,
}

/// A smooth field with different components, zero on the boundary.
fn bubble(x: &Vector3<f64>) -> Vector3<f64> {
    let [a, b, c] = [x.x, x.y, x.z].map(|t| (PI * t).sin());
    0.06 * Vector3::new(a * b * c, -0.7 * a * a * b * c, 0.5 * a * b * c * c)
}

/// A shear along x that varies over y and z. It preserves volume for any amplitude, and is zero where y or z
/// is 0 or 1.
fn sheared(x: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(0.15 * (PI * x.y).sin().powi(2) * (PI * x.z).sin(), 0.0, 0.0)
}

fn pressure(x: &Vector3<f64>) -> f64 {
    800.0 * (2.0 * x.x).cos() * (1.0 + 0.5 * (PI * x.y).sin() * x.z)
}

/// Fourth-order central difference of a matrix field along an axis.
fn slope<T>(field: impl Fn(&Vector3<f64>) -> T, x: &Vector3<f64>, axis: usize, step: f64) -> T
where
    T: std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
{
    let at = |by: f64| {
        let mut moved = *x;
        moved[axis] += by * step;
        field(&moved)
    };
    (at(1.0) - at(-1.0)) * (8.0 / (12.0 * step)) - (at(2.0) - at(-2.0)) * (1.0 / (12.0 * step))
}

fn displacement_gradient(solution: &Solution, x: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[0, 1, 2].map(|axis| slope(solution.displacement, x, axis, 1e-3)))
}

/// -Div P, N/m^3.
fn body_force(solution: &Solution, law: &Material, x: &Vector3<f64>) -> Vector3<f64> {
    let stress = |x: &Vector3<f64>| {
        let kinematics = Kinematics::of(&displacement_gradient(solution, x));
        let q_pa = if law.rest_pressure_pa().is_some() { (solution.pressure)(x) } else { 0.0 };
        law.stress(&kinematics, q_pa).1
    };
    -(0..3).map(|axis| slope(stress, x, axis, 2e-3).column(axis).into_owned()).sum::<Vector3<f64>>()
}

/// Shape function N_a at barycentric coordinates.
fn shape(order: Order, barycentric: &[f64; 4], a: usize) -> f64 {
    match (order, a) {
        (Order::Linear, _) => barycentric[a],
        (Order::Quadratic, 0..4) => barycentric[a] * (2.0 * barycentric[a] - 1.0),
        (Order::Quadratic, _) => {
            let [i, j] = EDGES[a - 4];
            4.0 * barycentric[i] * barycentric[j]
        }
    }
}

/// Adds the tractions P(F*) N of the faces x = 0 and x = 1, with seven points per triangle (degree 5, Radon).
fn load_faces(body: &mut Body, mesh: &TetMesh, solution: &Solution, law: &Material) {
    let root = 15.0f64.sqrt();
    let mut rule = vec![([1.0 / 3.0; 3], 0.225)];
    for (a, weight) in
        [((6.0 - root) / 21.0, (155.0 - root) / 1200.0), ((6.0 + root) / 21.0, (155.0 + root) / 1200.0)]
    {
        for corner in 0..3 {
            let mut point = [a; 3];
            point[corner] = 1.0 - 2.0 * a;
            rule.push((point, weight));
        }
    }
    for element in 0..mesh.tets.len() {
        let corners = mesh.vertices_m(element).map(Vector3::from);
        for away in 0..4 {
            let face: Vec<usize> = (0..4).filter(|&k| k != away).collect();
            for (at, sign) in [(0.0, -1.0), (1.0, 1.0)] {
                if face.iter().any(|&k| (corners[k].x - at).abs() > 1e-9) {
                    continue;
                }
                let [p, q, r] = [0, 1, 2].map(|i| corners[face[i]]);
                let area = 0.5 * (q - p).cross(&(r - p)).norm();
                for (on_face, weight) in &rule {
                    let mut barycentric = [0.0; 4];
                    for (&k, l) in face.iter().zip(on_face) {
                        barycentric[k] = *l;
                    }
                    let x: Vector3<f64> = barycentric.iter().zip(&corners).map(|(l, c)| c * *l).sum();
                    let kinematics = Kinematics::of(&displacement_gradient(solution, &x));
                    let stress = law.stress(&kinematics, (solution.pressure)(&x)).1;
                    let force: Vector3<f64> = stress.column(0) * (sign * area * weight);
                    for (a, node) in body.nodes_of(element).to_vec().into_iter().enumerate() {
                        for axis in 0..3 {
                            body.external_force_n[3 * node as usize + axis] +=
                                shape(body.order, &barycentric, a) * force[axis];
                        }
                    }
                }
            }
        }
    }
}

/// Splits every tet into four at its centroid, so that each has an inner vertex, as P2/P1 needs. Without the
/// split the pressures of tets in fixed corners are poorly determined, and reduce the order of the pressure
/// to 1 (measured 1.03).
fn split_at_centroids(mesh: &TetMesh) -> TetMesh {
    let mut nodes_m = mesh.nodes_m.clone();
    let mut tets = Vec::new();
    for (index, tet) in mesh.tets.iter().enumerate() {
        let corners = mesh.vertices_m(index);
        nodes_m.push(std::array::from_fn(|axis| corners.iter().map(|c| 0.25 * c[axis]).sum()));
        for vertex in 0..4 {
            let mut part = *tet;
            part[vertex] = nodes_m.len() as u32 - 1;
            tets.push(part);
        }
    }
    TetMesh::new(nodes_m, tets).expect("parts of valid tets are valid")
}

/// Errors of displacement in L2 and H1 and of pressure in L2.
fn errors(solution: &Solution, law: Material, order: Order, pair: PressurePair, cells: usize) -> [f64; 3] {
    let mut mesh = box_mesh([cells; 3], 1.0 / cells as f64);
    if law.rest_pressure_pa().is_some() {
        mesh = split_at_centroids(&mesh);
    }
    let at_end = |c: f64| c == 0.0 || c > 1.0 - 1e-9;
    let on_boundary = |x: [f64; 3]| at_end(x[1]) || at_end(x[2]) || at_end(x[0]) && !solution.loaded_faces;
    let model =
        Model { order, pressure_pair: pair, ..Model::uniform(law.clone(), &nodes_where(&mesh, on_boundary)) };
    let mut body = Body::new(&mesh, &model).expect("every element has volume");
    let place = |element: usize, barycentric: &[f64; 4], mesh: &TetMesh| {
        let corners = mesh.vertices_m(element);
        barycentric.iter().zip(corners).map(|(l, c)| Vector3::from(c) * *l).sum::<Vector3<f64>>()
    };
    for element in 0..body.elements.len() {
        let volume = body.elements[element].tet.volume_m3;
        for point in &QUADRATIC {
            let x = place(element, &point.barycentric, &mesh);
            let force = body_force(solution, &law, &x) * (volume * point.weight);
            for (a, node) in body.nodes_of(element).to_vec().into_iter().enumerate() {
                for axis in 0..3 {
                    body.external_force_n[3 * node as usize + axis] +=
                        shape(order, &point.barycentric, a) * force[axis];
                }
            }
        }
    }
    if solution.loaded_faces {
        load_faces(&mut body, &mesh, solution, &law);
    }
    let body = solve_body_force(body).expect("the manufactured body converges");
    let state = &body.rest_state;
    let mut squares = [0.0; 3];
    for (index, element) in body.elements.iter().enumerate() {
        for point in &QUADRATIC {
            let x = place(index, &point.barycentric, &mesh);
            let weight = element.tet.volume_m3 * point.weight;
            let nodes = body.nodes_of(index);
            let gradients = shape_gradients(&element.tet.gradients.map(Vec3::from), point);
            let (mut u, mut h) = (Vector3::zeros(), Matrix3::zeros());
            for (a, &node) in nodes.iter().enumerate() {
                let base = 3 * node as usize;
                let value = Vector3::new(state[base], state[base + 1], state[base + 2]);
                let gradient: Vector3<f64> = match order {
                    Order::Linear => element.tet.gradients[a],
                    Order::Quadratic => Vector3::from(gradients[a].0),
                };
                u += value * shape(order, &point.barycentric, a);
                h += value * gradient.transpose();
            }
            squares[0] += weight * (u - (solution.displacement)(&x)).norm_squared();
            squares[1] += weight * (h - displacement_gradient(solution, &x)).norm_squared();
            if body.has_pressure() {
                let q: f64 = (0..4)
                    .map(|v| {
                        state[body.displacement_len() + element.pressures[v] as usize] * point.barycentric[v]
                    })
                    .sum();
                squares[2] += weight * (q - (solution.pressure)(&x)).powi(2);
            }
        }
    }
    squares.map(f64::sqrt)
}

/// Prints the errors on every mesh. Asserts the order between the two finest ones, less the scatter of the
/// meshes.
fn study(
    name: &str,
    solution: &Solution,
    law: Material,
    order: Order,
    pair: PressurePair,
    cells: &[usize],
    expected: [f64; 3],
) {
    let mut before: Option<(usize, [f64; 3])> = None;
    for &n in cells {
        let here = errors(solution, law.clone(), order, pair, n);
        let observed = before.map(|(coarser, errors)| {
            let ratio = (n as f64 / coarser as f64).ln();
            [0, 1, 2].map(|k| (errors[k] / here[k]).ln() / ratio)
        });
        let shown = observed.map_or(String::new(), |o| format!("orders {:.2} {:.2} {:.2}", o[0], o[1], o[2]));
        println!("{name:32} {n:>3} cells: L2 {:.2e} H1 {:.2e} p {:.2e}  {shown}", here[0], here[1], here[2]);
        if let Some(observed) = observed.filter(|_| cells.last() == Some(&n)) {
            for (observed, expected) in observed.into_iter().zip(expected) {
                assert!(expected == 0.0 || observed > expected - 0.25, "{name}: {observed}");
            }
        }
        before = Some((n, here));
    }
}

#[test]
fn displacement_elements_converge_at_their_order() {
    let lame = Lame::from_young_poisson(15480.0, 0.3);
    let solution = Solution { displacement: bubble, pressure: |_| 0.0, loaded_faces: false };
    for law in [
        Material::LinearElastic(LinearElastic { lame }),
        Material::StVenantKirchhoff(StVenantKirchhoff { lame }),
        Material::NeoHookean(NeoHookean { lame }),
    ] {
        let name = |element: &str| format!("{} {element}", law.name());
        let plain = PressurePair::Plain;
        study(&name("tet4"), &solution, law.clone(), Order::Linear, plain, &[4, 8, 12, 16], [2.0, 1.0, 0.0]);
        study(&name("tet10"), &solution, law, Order::Quadratic, plain, &[2, 4, 6, 8], [3.0, 2.0, 0.0]);
    }
}

#[test]
fn mixed_elements_converge_at_their_order() {
    let solution = Solution { displacement: sheared, pressure, loaded_faces: true };
    let law = mooney_rivlin();
    let (plain, stabilised) = (PressurePair::Plain, PressurePair::Stabilised);
    study(
        "mooney-rivlin P2/P1",
        &solution,
        law.clone(),
        Order::Quadratic,
        plain,
        &[4, 6, 8, 10],
        [3.0, 2.0, 2.0],
    );
    study(
        "mooney-rivlin P1/P1 stabilised",
        &solution,
        law,
        Order::Linear,
        stabilised,
        &[4, 7, 10, 13],
        [2.0, 1.0, 1.0],
    );
}
