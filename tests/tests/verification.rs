//! Does the mathematics hold: the assembled model against closed forms and against its own differences.

use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3, Vector3};
use palpate_precompute::assembly::{Assembled, Pattern};
use palpate_precompute::body::Body;
use palpate_precompute::boundary::DofMap;
use palpate_precompute::material::Material;
use palpate_precompute::solve::{Configuration, Problem, Solver};
use palpate_tests::{box_mesh, mooney_rivlin, soft_beam, st_venant_kirchhoff};

fn laws() -> [Material; 2] {
    [st_venant_kirchhoff(), mooney_rivlin()]
}

/// Forces, energy and tangent of a homogeneous deformation x -> F x with one pressure everywhere.
fn homogeneous(body: &Body, nodes_m: &[[f64; 3]], gradient: &Matrix3<f64>, pressure_pa: f64) -> Assembled {
    let active = 0;
    let pressures = body.material.rest_pressure_pa().is_some();
    let dofs = DofMap::new(&body.elements, body.node_count, &body.fixed, active, pressures);
    let pattern = Pattern::new(body, &dofs);
    let mut state = body.rest_state();
    for (node, x) in nodes_m.iter().enumerate() {
        let u = gradient * Vector3::from(*x) - Vector3::from(*x);
        state[3 * node..3 * node + 3].copy_from_slice(u.as_slice());
    }
    state[3 * body.node_count..].fill(pressure_pa);
    let mut assembled = Assembled::new(body, &pattern);
    assembled.assemble(body, &pattern, &state);
    assembled
}

/// The box 60 x 40 x 40 mm, nothing fixed.
fn free_box(material: Material) -> (Vec<[f64; 3]>, Body) {
    let mesh = box_mesh([3, 2, 2], 0.02);
    let body = Body::new(&mesh, material, &[]).expect("every element has volume");
    (mesh.nodes_m, body)
}

fn is_inner(x: &[f64; 3]) -> bool {
    let inside = |x: f64, top: f64| x > 1e-9 && x < top - 1e-9;
    inside(x[0], 0.06) && inside(x[1], 0.04) && inside(x[2], 0.04)
}

#[test]
fn patch_test_inner_nodes_are_in_balance_under_any_homogeneous_strain() {
    let gradient = Matrix3::new(1.2, 0.1, -0.05, 0.02, 0.9, 0.15, -0.1, 0.07, 1.05);
    for law in laws() {
        let (nodes, body) = free_box(law);
        let result = homogeneous(&body, &nodes, &gradient, 5000.0);
        let scale = result.nodal_force_n.iter().fold(0.0f64, |m, f| m.max(f.abs()));
        let mut inner = 0;
        for (node, x) in nodes.iter().enumerate().filter(|(_, x)| is_inner(x)) {
            inner += 1;
            for axis in 0..3 {
                let force = result.nodal_force_n[3 * node + axis];
                assert!(force.abs() < 1e-12 * scale, "{} node {node} at {x:?}: {force}", law.name());
            }
        }
        assert_eq!(inner, 2, "the box has two inner nodes");
    }
}

#[test]
fn a_rigid_motion_costs_nothing_and_energy_is_objective() {
    let turn = *Rotation3::from_euler_angles(0.4, 1.3, -0.8).matrix();
    let stretch = Matrix3::new(1.1, 0.2, 0.0, 0.0, 0.95, -0.1, 0.05, 0.0, 1.02);
    for law in laws() {
        let (nodes, body) = free_box(law);
        let rest = law.rest_pressure_pa().unwrap_or(0.0);
        let rigid = homogeneous(&body, &nodes, &turn, rest);
        let still = homogeneous(&body, &nodes, &stretch, rest);
        let turned = homogeneous(&body, &nodes, &(turn * stretch), rest);
        let scale = still.nodal_force_n.iter().fold(0.0f64, |m, f| m.max(f.abs()));
        assert!(rigid.nodal_force_n.iter().all(|f| f.abs() < 1e-12 * scale), "{}", law.name());
        assert!(rigid.energy_j.abs() < 1e-12 * still.energy_j.abs(), "{}", law.name());
        assert!((turned.energy_j - still.energy_j).abs() < 1e-12 * still.energy_j.abs(), "{}", law.name());
    }
}

#[test]
fn uniaxial_mooney_rivlin_follows_its_closed_form() {
    // Incompressible bar: F = diag(l, l^-1/2, l^-1/2), free sides, so p = 2 [ C10 / l + C01 (l + 1 / l^2) ] and the
    // nominal stress is 2 (l - l^-2) (C10 + C01 / l)  [Treloar 1975].
    let (c10, c01) = (1300.0, 1280.0);
    for l in [0.6, 0.9, 1.0, 1.3, 2.0f64] {
        let (nodes, body) = free_box(mooney_rivlin());
        let side = 1.0 / l.sqrt();
        let pressure = 2.0 * (c10 / l + c01 * (l + 1.0 / (l * l)));
        let result =
            homogeneous(&body, &nodes, &Matrix3::from_diagonal(&Vector3::new(l, side, side)), pressure);
        let area = 0.04 * 0.04;
        let pull: f64 = nodes
            .iter()
            .enumerate()
            .filter(|(_, x)| x[0] > 0.06 - 1e-9)
            .map(|(node, _)| result.nodal_force_n[3 * node])
            .sum();
        let want = area * 2.0 * (l - 1.0 / (l * l)) * (c10 + c01 / l);
        assert!((pull - want).abs() < 1e-12 * area * c10, "l = {l}: {pull} N, closed form {want} N");
        let side_force: f64 = nodes
            .iter()
            .enumerate()
            .filter(|(_, x)| x[1] > 0.04 - 1e-9)
            .map(|(node, _)| result.nodal_force_n[3 * node + 1])
            .sum();
        assert!(side_force.abs() < 1e-12 * area * c10, "l = {l}: free sides carry {side_force} N");
        let density = c10 * (l * l + 2.0 / l - 3.0) + c01 * (2.0 * l + 1.0 / (l * l) - 3.0);
        let energy = density * 0.06 * area;
        assert!((result.energy_j - energy).abs() < 1e-12 * (energy.abs() + 1e-3), "l = {l}");
    }
}

#[test]
fn small_strains_obey_hookes_law_with_e_of_six_times_c10_plus_c01() {
    let young = 6.0 * (1300.0 + 1280.0);
    let l = 1.0 + 1e-6;
    let (nodes, body) = free_box(mooney_rivlin());
    let pressure = 2.0 * (1300.0 / l + 1280.0 * (l + 1.0 / (l * l)));
    let side = 1.0 / f64::sqrt(l);
    let result = homogeneous(&body, &nodes, &Matrix3::from_diagonal(&Vector3::new(l, side, side)), pressure);
    let pull: f64 =
        (0..nodes.len()).filter(|&n| nodes[n][0] > 0.06 - 1e-9).map(|n| result.nodal_force_n[3 * n]).sum();
    let strain_stress = young * 1e-6 * 0.04 * 0.04;
    assert!((pull / strain_stress - 1.0).abs() < 3e-6, "{pull} N against {strain_stress} N");
}

fn solve_at(solver: &mut Solver, d: [f64; 3]) -> Configuration {
    let rest = solver.rest().expect("the beam is held");
    let half = solver.advance(&rest.seed, d.map(|x| 0.5 * x)).expect("half way converges");
    solver.advance(&half.seed, d).expect("the beam follows")
}

#[test]
fn force_is_the_gradient_of_energy_and_stiffness_that_of_force() {
    for law in laws() {
        let (_, _, active, body) = soft_beam(law);
        let mut solver = Solver::new(Arc::new(Problem::new(body, active)));
        let d = [0.004, -0.003, -0.008];
        let here = solve_at(&mut solver, d);
        let step = 1e-4;
        for axis in 0..3 {
            let around = [-2.0, -1.0, 1.0, 2.0].map(|by| {
                let mut there = d;
                there[axis] += by * step;
                solver.advance(&here.seed, there).expect("a step of 0.2 mm converges")
            });
            // Central difference of fourth order.
            let slope = |value: &dyn Fn(&Configuration) -> f64| {
                let [a, b, c, d] = around.each_ref().map(value);
                (a - 8.0 * b + 8.0 * c - d) / (12.0 * step)
            };
            let (dw, force) = (slope(&|c| c.energy_j), here.force_n[axis]);
            let size = Vector3::from(here.force_n).norm();
            assert!((dw - force).abs() < 1e-7 * size, "{} h[{axis}]: {force}, dW/dd {dw}", law.name());
            for row in 0..3 {
                let (dh, stiffness) = (slope(&|c| c.force_n[row]), here.stiffness_n_m[(row, axis)]);
                let error = (dh - stiffness).abs() / here.stiffness_n_m.norm();
                assert!(error < 1e-6, "{} S[{row},{axis}]: {stiffness}, dh/dd {dh}", law.name());
            }
            // du/dd, everywhere in the body.
            let error = (0..3 * solver.problem().body.node_count)
                .map(|i| (slope(&|c| c.seed.state[i]) - here.seed.sensitivity[axis][i]).abs())
                .fold(0.0, f64::max);
            assert!(error < 1e-5, "{} du/dd[{axis}] is off by {error}", law.name());
        }
    }
}

#[test]
fn reaction_is_minus_the_sum_of_the_fixed_reactions() {
    for law in laws() {
        let (_, fixed, active, body) = soft_beam(law);
        let mut solver = Solver::new(Arc::new(Problem::new(body, active)));
        let c = solve_at(&mut solver, [0.005, 0.006, -0.01]);
        for axis in 0..3 {
            let held: f64 = fixed.iter().map(|&n| solver.nodal_force_n()[3 * n as usize + axis]).sum();
            assert!((held + c.force_n[axis]).abs() < 1e-10, "{} axis {axis}", law.name());
        }
    }
}

#[test]
fn energy_is_the_work_along_a_path() {
    for law in laws() {
        let (_, _, active, body) = soft_beam(law);
        let mut solver = Solver::new(Arc::new(Problem::new(body, active)));
        let mut here = solver.rest().expect("the beam is held");
        // Gauss-Legendre with five points on the straight path: exact to the tenth order of the step.
        let end = [0.006, 0.004, -0.009];
        let nodes = [0.0469100770306680, 0.2307653449471585, 0.5, 0.7692346550528415, 0.953_089_922_969_332];
        let weights = [
            0.1184634425280945,
            0.2393143352496832,
            0.2844444444444444,
            0.2393143352496832,
            0.1184634425280945,
        ];
        let mut work = 0.0;
        for (t, w) in nodes.into_iter().zip(weights) {
            here = solver.advance(&here.seed, end.map(|x| t * x)).expect("the beam follows");
            work += w * Vector3::from(here.force_n).dot(&Vector3::from(end));
        }
        let energy = solver.advance(&here.seed, end).expect("the beam follows").energy_j;
        assert!((work - energy).abs() < 1e-7 * energy, "{}: work {work} J, energy {energy} J", law.name());
    }
}

#[test]
fn pressure_keeps_the_volume() {
    let (mesh, _, active, body) = soft_beam(mooney_rivlin());
    let mut solver = Solver::new(Arc::new(Problem::new(body, active)));
    let c = solve_at(&mut solver, [0.0, 0.01, 0.012]);
    let rest = mesh.volume_m3();
    // Every pressure node has a free element here, so the constraints add up to the whole volume.
    assert!((c.volume_m3 / rest - 1.0).abs() < 1e-12, "{} of {rest} m^3", c.volume_m3);
    let (_, _, active, body) = soft_beam(st_venant_kirchhoff());
    let mut solver = Solver::new(Arc::new(Problem::new(body, active)));
    let c = solve_at(&mut solver, [0.0, 0.01, 0.012]);
    assert!((c.volume_m3 / rest - 1.0).abs() > 1e-6, "a compressible body does change its volume");
}

#[test]
fn the_same_solve_gives_the_same_bits() {
    let (_, _, active, body) = soft_beam(mooney_rivlin());
    let problem = Arc::new(Problem::new(body.clone(), active));
    let d = [0.003, 0.002, -0.011];
    let first = solve_at(&mut Solver::new(problem.clone()), d);
    let mut used = Solver::new(Arc::new(Problem::new(body, active)));
    let _ = solve_at(&mut used, [-0.002, 0.0, 0.004]);
    let second = solve_at(&mut used, d);
    assert_eq!(first.force_n.map(f64::to_bits), second.force_n.map(f64::to_bits));
    assert_eq!(first.energy_j.to_bits(), second.energy_j.to_bits());
    assert!(first.seed.state.iter().zip(&second.seed.state).all(|(a, b)| a.to_bits() == b.to_bits()));
}
