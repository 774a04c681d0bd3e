//! Homogeneous deformations: patch test, rigid motions, closed forms of simple states, small strains.

use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};

use super::{Assembled, Pattern, subtract_product};
use crate::fem::body::{Body, Model};
use crate::fem::boundary::{Constraints, DofMap};
use crate::fem::element::Order;
use crate::fem::kinematics::Kinematics;
use crate::fem::material::{Material, livers, mooney_rivlin};
use crate::mesh::testing::box_mesh;

const C10_PA: f64 = 1300.0;
const C01_PA: f64 = 1280.0;
/// Size of the box, m.
const SIZE_M: [f64; 3] = [0.06, 0.04, 0.04];

/// The box of 60 x 40 x 40 mm without constraints.
fn free_box(material: Material, order: Order) -> Body {
    let mesh = box_mesh([3, 2, 2], 0.02);
    let model = Model { order, ..Model::uniform(material, &[]) };
    Body::new(&mesh, &model).expect("every element has volume")
}

/// Forces, energy and tangent of x -> F x with a uniform pressure.
fn homogeneous(body: &Body, gradient: &Matrix3<f64>, pressure_pa: f64) -> (Assembled, Pattern) {
    let dofs = DofMap::new(body, None, Constraints::Elimination);
    let pattern = Pattern::new(body, &dofs);
    let mut state = vec![0.0; body.state_len()];
    for (node, x) in body.nodes_m.iter().enumerate() {
        let u = gradient * Vector3::from(*x) - Vector3::from(*x);
        state[3 * node..3 * node + 3].copy_from_slice(u.as_slice());
    }
    let rest_pa = body.regions[0].material.rest_pressure_pa().unwrap_or(0.0);
    state[body.displacement_len()..].fill(pressure_pa - rest_pa);
    let mut assembled = Assembled::new(body, &pattern);
    assembled.assemble(body, &pattern, &state);
    (assembled, pattern)
}

/// Total nodal force on the face at the far end of `axis`.
fn face_force(body: &Body, result: &Assembled, axis: usize) -> Vector3<f64> {
    let on_face =
        (0..body.nodes_m.len() as u32).filter(|&n| body.nodes_m[n as usize][axis] > SIZE_M[axis] - 1e-9);
    Vector3::from(result.force_on(&on_face.collect::<Vec<_>>()))
}

fn area(axis: usize) -> f64 {
    SIZE_M[(axis + 1) % 3] * SIZE_M[(axis + 2) % 3]
}

#[test]
fn the_patch_test_holds_for_inner_nodes_and_faces() {
    let gradient = Matrix3::new(1.2, 0.1, -0.05, 0.02, 0.9, 0.15, -0.1, 0.07, 1.05);
    let mut worst = 0.0f64;
    for law in livers() {
        let [linear, quadratic] = [Order::Linear, Order::Quadratic].map(|order| free_box(law.clone(), order));
        let mixed = quadratic.quadratic_near([0.0; 3], 0.03);
        assert!((1..mixed.elements.len()).contains(&mixed.linear) && !mixed.followers.is_empty());
        for body in [linear, quadratic, mixed] {
            let order = body.order;
            let (result, _) = homogeneous(&body, &gradient, 5000.0);
            let largest = result.nodal_force_n.iter().fold(0.0f64, |m, f| m.max(f.abs()));
            let inside = |x: &[f64; 3]| (0..3).all(|a| x[a] > 1e-9 && x[a] < SIZE_M[a] - 1e-9);
            let mut inner = 0;
            for node in (0..body.nodes_m.len()).filter(|&n| inside(&body.nodes_m[n])) {
                inner += 1;
                for axis in 0..3 {
                    worst = worst.max(result.nodal_force_n[3 * node + axis].abs() / largest);
                }
            }
            assert!(inner >= 2, "the box has inner nodes");
            // Divergence theorem: the sum of f (x) X is the volume times P.
            let mut moment = Matrix3::zeros();
            for (node, x) in body.nodes_m.iter().enumerate() {
                let force = Vector3::from(result.force_on(&[node as u32]));
                moment += force * Vector3::from(*x).transpose();
            }
            let k = Kinematics::of(&(gradient - Matrix3::identity()));
            let rest_pa = law.rest_pressure_pa().unwrap_or(0.0);
            let q_pa = if body.has_pressure() { 5000.0 - rest_pa } else { 0.0 };
            let (_, stress) = law.stress(&k, q_pa);
            let volume: f64 = SIZE_M.iter().product();
            let error = (moment - stress * volume).norm() / (stress.norm() * volume);
            assert!(error < 1e-12, "{} {order:?}: {error:e}", law.name());
        }
    }
    println!("patch test, worst inner force over the largest nodal force {worst:.1e}");
    assert!(worst < 1e-12);
}

/// A free body has six rigid motions, and no other deformation without energy, except for one pressure field.
#[test]
fn the_tangent_of_a_free_body_has_six_zero_eigenvalues() {
    let mesh = box_mesh([1, 1, 1], 0.02);
    for law in livers().into_iter().filter(|law| law.rest_pressure_pa().is_none()) {
        for order in [Order::Linear, Order::Quadratic] {
            let model = Model { order, ..Model::uniform(law.clone(), &[]) };
            let body = Body::new(&mesh, &model).expect("every element has volume");
            let (result, pattern) = homogeneous(&body, &Matrix3::identity(), 0.0);
            let n = pattern.unknowns();
            let mut dense = DMatrix::zeros(n, n);
            for column in 0..n {
                for at in pattern.column_starts[column]..pattern.column_starts[column + 1] {
                    let row = pattern.rows[at];
                    dense[(row, column)] = result.tangent[at];
                    dense[(column, row)] = result.tangent[at];
                }
            }
            let mut eigenvalues: Vec<f64> = dense.symmetric_eigenvalues().iter().copied().collect();
            eigenvalues.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
            let largest = eigenvalues[n - 1].abs();
            println!(
                "{:20} {order:?}: sixth and seventh eigenvalue over the largest {:.1e} {:.1e}",
                law.name(),
                eigenvalues[5].abs() / largest,
                eigenvalues[6] / largest
            );
            assert!(eigenvalues[5].abs() < 1e-13 * largest && eigenvalues[6] > 1e-5 * largest);
        }
    }
}

#[test]
fn a_rigid_motion_needs_no_energy_and_the_energy_is_objective() {
    let turn = *Rotation3::from_euler_angles(0.4, 1.3, -0.8).matrix();
    let stretch = Matrix3::new(1.1, 0.2, 0.0, 0.0, 0.95, -0.1, 0.05, 0.0, 1.02);
    for law in livers().into_iter().filter(|law| !matches!(law, Material::LinearElastic(_))) {
        for order in [Order::Linear, Order::Quadratic] {
            let body = free_box(law.clone(), order);
            let rest_pa = law.rest_pressure_pa().unwrap_or(0.0);
            let [rigid, still, turned] =
                [turn, stretch, turn * stretch].map(|f| homogeneous(&body, &f, rest_pa).0);
            let scale = still.nodal_force_n.iter().fold(0.0f64, |m, f| m.max(f.abs()));
            assert!(rigid.nodal_force_n.iter().all(|f| f.abs() < 1e-11 * scale), "{}", law.name());
            assert!(rigid.energy_j.abs() < 1e-11 * still.energy_j.abs(), "{}", law.name());
            assert!(
                (turned.energy_j - still.energy_j).abs() < 1e-11 * still.energy_j.abs(),
                "{}",
                law.name()
            );
        }
    }
}

/// Incompressible bar, F = diag(l, l^-1/2, l^-1/2), with free sides: nominal stress 2 (l - l^-2)(C10 + C01 /
/// l), pressure 2 [C10 / l + C01 (l + l^-2)] (Treloar 1975).
#[test]
fn uniaxial_mooney_rivlin_matches_its_closed_form() {
    for order in [Order::Linear, Order::Quadratic] {
        let mut worst = 0.0f64;
        for l in [0.6, 0.9, 1.0, 1.3, 2.0f64] {
            let body = free_box(mooney_rivlin(), order);
            let side = 1.0 / l.sqrt();
            let pressure = 2.0 * (C10_PA / l + C01_PA * (l + l.powi(-2)));
            let (result, _) =
                homogeneous(&body, &Matrix3::from_diagonal(&Vector3::new(l, side, side)), pressure);
            let want = 2.0 * (l - l.powi(-2)) * (C10_PA + C01_PA / l) * area(0);
            let [pull, lateral] = [face_force(&body, &result, 0).x, face_force(&body, &result, 1).y];
            worst = worst.max((pull - want).abs().max(lateral.abs()) / (C10_PA * area(0)));
            let density = C10_PA * (l * l + 2.0 / l - 3.0) + C01_PA * (2.0 * l + l.powi(-2) - 3.0);
            let energy = density * SIZE_M.iter().product::<f64>();
            assert!((result.energy_j - energy).abs() < 1e-12 * (energy.abs() + 1e-3), "l = {l}");
        }
        println!("uniaxial Mooney-Rivlin, {order:?}: worst force error {worst:.1e} of C10 A");
        assert!(worst < 1e-12);
    }
}

/// F = diag(l, l, l^-2) with free faces along z: nominal stress 2 (l - l^-5)(C10 + C01 l^2) in the plane,
/// pressure 2 [C10 l^-4 + 2 C01 l^-2].
#[test]
fn equibiaxial_mooney_rivlin_matches_its_closed_form() {
    let mut worst = 0.0f64;
    for l in [0.8, 1.0, 1.2, 1.6f64] {
        let body = free_box(mooney_rivlin(), Order::Linear);
        let pressure = 2.0 * (C10_PA * l.powi(-4) + 2.0 * C01_PA * l.powi(-2));
        let (result, _) =
            homogeneous(&body, &Matrix3::from_diagonal(&Vector3::new(l, l, l.powi(-2))), pressure);
        let want = 2.0 * (l - l.powi(-5)) * (C10_PA + C01_PA * l * l);
        let found = [0, 1, 2].map(|axis| face_force(&body, &result, axis)[axis] / area(axis));
        for (found, want) in found.into_iter().zip([want, want, 0.0]) {
            worst = worst.max((found - want).abs() / C10_PA);
        }
    }
    println!("equibiaxial Mooney-Rivlin: worst nominal stress error {worst:.1e} of C10");
    assert!(worst < 1e-12);
}

/// Simple shear x = X + k Y: shear stress 2 (C10 + C01) k. With sigma_zz = 0, p = 2 (C10 + C01 (2 + k^2)),
/// the normal stresses are sigma_xx = 2 C10 k^2 and sigma_yy = -2 C01 k^2 (Rivlin 1948; the Poynting effect).
#[test]
fn simple_shear_of_mooney_rivlin_matches_its_closed_form() {
    let mut worst = 0.0f64;
    for k in [-0.7, 0.1, 0.5, 1.0] {
        let body = free_box(mooney_rivlin(), Order::Linear);
        let mut gradient = Matrix3::identity();
        gradient[(0, 1)] = k;
        let pressure = 2.0 * (C10_PA + C01_PA * (2.0 + k * k));
        let (result, _) = homogeneous(&body, &gradient, pressure);
        // Cauchy stress sigma = P F^T / J, with V P = sum of f (x) X, because faces share the nodes of their
        // edges.
        let mut nominal = Matrix3::zeros();
        for (node, x) in body.nodes_m.iter().enumerate() {
            nominal += Vector3::from(result.force_on(&[node as u32])) * Vector3::from(*x).transpose();
        }
        nominal /= SIZE_M.iter().product::<f64>();
        let stress = nominal * gradient.transpose();
        let shear = 2.0 * (C10_PA + C01_PA) * k;
        let want =
            Matrix3::new(2.0 * C10_PA * k * k, shear, 0.0, shear, -2.0 * C01_PA * k * k, 0.0, 0.0, 0.0, 0.0);
        worst = worst.max((stress - want).norm() / C10_PA);
    }
    println!("simple shear of Mooney-Rivlin: worst Cauchy stress error {worst:.1e} of C10");
    assert!(worst < 1e-12);
}

#[test]
fn small_strains_obey_hookes_law() {
    let strain = 1e-6;
    // Mooney-Rivlin: E = 6 (C10 + C01), the paper's 15.48 kPa.
    let l = 1.0 + strain;
    let body = free_box(mooney_rivlin(), Order::Linear);
    let pressure = 2.0 * (C10_PA / l + C01_PA * (l + l.powi(-2)));
    let side = l.sqrt().recip();
    let (result, _) = homogeneous(&body, &Matrix3::from_diagonal(&Vector3::new(l, side, side)), pressure);
    let young = face_force(&body, &result, 0).x / area(0) / strain;
    println!("Mooney-Rivlin: E = {young:.4} Pa, 6 (C10 + C01) = {}", 6.0 * (C10_PA + C01_PA));
    assert!((young / (6.0 * (C10_PA + C01_PA)) - 1.0).abs() < 3e-6);
    // Every law: shear modulus in simple shear. The compressible ones: lambda + 2 mu in confined extension.
    for law in livers() {
        let body = free_box(law.clone(), Order::Linear);
        let rest_pa = law.rest_pressure_pa().unwrap_or(0.0);
        let mut shear = Matrix3::identity();
        shear[(0, 1)] = strain;
        let mu = face_force(&body, &homogeneous(&body, &shear, rest_pa).0, 1).x / area(1) / strain;
        // The fibres of the anisotropic law are slack at this strain.
        assert!((mu / law.shear_modulus_pa() - 1.0).abs() < 1e-5, "{}: mu = {mu}", law.name());
        if law.rest_pressure_pa().is_none() {
            let [lambda_pa, mu_pa] = law.numbers()[..] else { panic!("Lame's constants") };
            let confined = Matrix3::from_diagonal(&Vector3::new(1.0 + strain, 1.0, 1.0));
            let modulus = face_force(&body, &homogeneous(&body, &confined, 0.0).0, 0).x / area(0) / strain;
            assert!((modulus / (lambda_pa + 2.0 * mu_pa) - 1.0).abs() < 1e-5, "{}: {modulus}", law.name());
        }
    }
}

#[test]
fn the_entries_of_some_equations_multiply_what_is_zero_elsewhere_and_their_own_rows() {
    let body = free_box(mooney_rivlin(), Order::Quadratic);
    let stretch = Matrix3::new(1.2, 0.1, 0.0, 0.0, 0.9, 0.2, 0.0, 0.0, 1.0);
    let (assembled, pattern) = homogeneous(&body, &stretch, 500.0);
    let (n, values) = (pattern.unknowns(), &assembled.tangent);
    let some: Vec<usize> = (0..n).filter(|equation| equation % 7 < 2).collect();
    let entries = pattern.entries_of(&some);
    assert!((1..pattern.entries()).contains(&entries.len()));
    let x: Vec<f64> = (0..2 * n).map(|i| libm::sin(1.7 * i as f64)).collect();
    let is_some = |place: usize| some.binary_search(&(place % n)).is_ok();
    let only: Vec<f64> = x.iter().enumerate().map(|(i, x)| if is_some(i) { *x } else { 0.0 }).collect();
    for (x, all_rows) in [(&only, true), (&x, false)] {
        let (mut product, mut left) = (vec![0.0; 2 * n], vec![0.0; 2 * n]);
        pattern.multiply_columns(values, x, &mut product);
        subtract_product(&entries, values, x, &mut left, n);
        let scale = product.iter().fold(0.0f64, |most, value| most.max(value.abs()));
        for place in (0..2 * n).filter(|&place| all_rows || is_some(place)) {
            assert!((product[place] + left[place]).abs() < 1e-13 * scale, "row {place}");
        }
    }
}
