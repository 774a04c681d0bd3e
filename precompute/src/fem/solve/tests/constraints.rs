//! Elimination compared with multipliers, balance of reactions, and rigid patches.

use std::sync::Arc;

use nalgebra::{Rotation3, Vector3};

use crate::fem::body::{Body, Model};
use crate::fem::boundary::{Constraints, Handle, Pose};
use crate::fem::element::{EDGES, Order};
use crate::fem::material::{livers, mooney_rivlin};
use crate::fem::solve::{Configuration, Problem, Solver, solve_body_force};
use crate::mesh::TetMesh;
use crate::mesh::testing::{box_mesh, nodes_where};

/// A beam of 80 x 40 x 40 mm.
fn beam() -> TetMesh {
    box_mesh([4, 2, 2], 0.02)
}

fn problem(model: &Model, handle: &Handle, constraints: Constraints) -> Arc<Problem> {
    let body = Arc::new(Body::new(&beam(), model).expect("every element has volume"));
    Arc::new(Problem::with(body, Some(handle.clone().into()), constraints))
}

fn fixed() -> Vec<u32> {
    nodes_where(&beam(), |x| x[0] == 0.0)
}

fn top() -> u32 {
    nodes_where(&beam(), |x| (x[0] - 0.06).abs() < 0.01 && (x[1] - 0.02).abs() < 0.01 && x[2] == 0.04)[0]
}

/// A patch of the top face around its middle.
fn tip() -> Handle {
    Handle::patch(top(), &nodes_where(&beam(), |x| x[2] > 0.039 && (x[0] - 0.06).abs() < 0.01))
}

fn reach(solver: &mut Solver, pose: &Pose) -> Configuration {
    let rest = solver.rest().expect("the beam is fixed");
    solver.advance_to(&rest.seed, pose).expect("the beam converges")
}

#[test]
fn multipliers_and_elimination_agree() {
    let mut worst = 0.0f64;
    for handle in [Handle::node(top()), tip()] {
        for (order, law) in
            livers().into_iter().map(|law| (Order::Linear, law)).chain([(Order::Quadratic, mooney_rivlin())])
        {
            let model = Model { order, ..Model::uniform(law.clone(), &fixed()) };
            let mut pose = Pose::translation([0.005, 0.006, -0.009]);
            if handle.nodes.len() > 1 {
                pose.rotation_rad = [0.1, -0.05, 0.2];
            }
            let [a, b] = [Constraints::Elimination, Constraints::Multipliers].map(|constraints| {
                let mut solver = Solver::new(problem(&model, &handle, constraints));
                // S is as accurate as its state, so the tolerance is stricter than usual.
                solver.newton.tolerance = 1e-11;
                reach(&mut solver, &pose)
            });
            let relative = |x: Vector3<f64>, y: Vector3<f64>| (x - y).norm() / x.norm().max(1e-9);
            let apart = [
                relative(a.jet().force_n.into(), b.jet().force_n.into()),
                (a.jet().energy_j / b.jet().energy_j - 1.0).abs(),
                (a.jet().stiffness_n_m - b.jet().stiffness_n_m).norm() / a.jet().stiffness_n_m.norm(),
                (Vector3::from(a.torque_n_m) - Vector3::from(b.torque_n_m)).norm()
                    / (0.02 * a.jet().force_n[2].abs()),
                a.seed
                    .state
                    .iter()
                    .zip(&b.seed.state)
                    .take(3 * 45)
                    .map(|(x, y)| (x - y).abs())
                    .fold(0.0, f64::max)
                    / 0.01,
            ]
            .into_iter()
            .fold(0.0, f64::max);
            assert!(apart < 1e-10, "{} {order:?}: {apart:e}", law.name());
            worst = worst.max(apart);
        }
    }
    println!("elimination and multipliers, worst relative difference {worst:.1e}");
}

#[test]
fn reaction_is_minus_the_sum_of_the_fixed_reactions() {
    let mut worst = 0.0f64;
    for law in livers() {
        for handle in [Handle::node(top()), tip()] {
            let model = Model::uniform(law.clone(), &fixed());
            let mut solver = Solver::new(problem(&model, &handle, Constraints::Elimination));
            let c = reach(&mut solver, &Pose::translation([0.005, 0.006, -0.01]));
            for axis in 0..3 {
                let held: f64 = fixed().iter().map(|&n| solver.nodal_force_n()[3 * n as usize + axis]).sum();
                worst =
                    worst.max((held + c.jet().force_n[axis]).abs() / Vector3::from(c.jet().force_n).norm());
            }
        }
    }
    println!("reaction plus fixed reactions, worst relative {worst:.1e}");
    assert!(worst < 1e-10);
}

/// For a rotation of the patch, dW is the moment times the rotation. Force and moment balance over the body.
#[test]
fn the_moment_of_a_patch_is_the_derivative_of_the_energy_by_its_rotation() {
    let plain = Model::uniform(mooney_rivlin(), &fixed());
    moment_of_a_patch("P1/P1", &plain);
    moment_of_a_patch("P2/P1", &Model { order: Order::Quadratic, ..plain.clone() });
    // Under gravity the patch rotates about its centre at rest, and not about its centre in the mesh.
    moment_of_a_patch("P1/P1 under gravity", &Model { body_force_n_m3: [0.0, 0.0, -3.0e4], ..plain });
}

fn moment_of_a_patch(name: &str, model: &Model) {
    let body = Body::new(&beam(), model).expect("every element has volume");
    let body = Arc::new(solve_body_force(body).expect("the rest state converges"));
    let mut solver = Solver::new(Arc::new(Problem::with(body, Some(tip().into()), Constraints::Elimination)));
    let pose = Pose { displacement_m: [0.003, 0.002, -0.006], rotation_rad: [0.08, -0.12, 0.2] };
    let here = reach(&mut solver, &pose);
    let size = Vector3::from(here.torque_n_m).norm();
    let mut worst = 0.0f64;
    for axis in 0..3 {
        let step = 1e-3;
        let energy = |solver: &mut Solver, by: f64| {
            // An additional rotation about a fixed axis through the centre.
            let mut turn = Vector3::zeros();
            turn[axis] = by;
            let total = Rotation3::from_scaled_axis(turn)
                * Rotation3::from_scaled_axis(Vector3::from(pose.rotation_rad));
            let there = Pose { rotation_rad: total.scaled_axis().into(), ..pose };
            solver.advance_to(&here.seed, &there).expect("the beam converges").jet().energy_j
        };
        let slope = (8.0 * (energy(&mut solver, step) - energy(&mut solver, -step))
            - (energy(&mut solver, 2.0 * step) - energy(&mut solver, -2.0 * step)))
            / (12.0 * step);
        worst = worst.max((slope - here.torque_n_m[axis]).abs() / size);
    }
    println!("moment against dW/d(rotation), {name}: worst relative {worst:.1e}");
    assert!(worst < 1e-8, "{name}");
    assert_moves_rigidly(&solver.problem().body.clone(), &here, &pose);
    if model.body_force_n_m3 != [0.0; 3] {
        return;
    }
    // Moments of tool and fixation about the origin cancel. The nodal forces are those of the present pose.
    let again = reach(&mut solver, &pose);
    let body = &solver.problem().body;
    let mut sum = Vector3::zeros();
    for node in 0..body.nodes_m.len() {
        let at = |v: &[f64]| Vector3::new(v[3 * node], v[3 * node + 1], v[3 * node + 2]);
        let place = Vector3::from(body.nodes_m[node]) + at(&again.seed.state);
        sum += place.cross(&at(solver.nodal_force_n()));
    }
    assert!(sum.norm() < 1e-9 * size, "{sum}");
}

/// Checks that every node of the patch, including mid-edge nodes, moves with the rigid body.
fn assert_moves_rigidly(body: &Body, here: &Configuration, pose: &Pose) {
    let vertices = tip().nodes;
    let held = |n: u32| vertices.binary_search(&n).is_ok();
    let between: Vec<u32> = (0..body.elements.len())
        .flat_map(|e| {
            let nodes = body.nodes_of(e);
            let ends = EDGES.iter().zip(nodes.get(4..).unwrap_or(&[]));
            ends.filter(|([a, b], _)| held(nodes[*a]) && held(nodes[*b])).map(|(_, &n)| n).collect::<Vec<_>>()
        })
        .collect();
    assert_eq!(between.is_empty(), body.order == Order::Linear);
    let at_rest = |n: u32| Vector3::from(body.rest_position_m(n));
    let turn = Rotation3::from_scaled_axis(Vector3::from(pose.rotation_rad));
    for &node in vertices.iter().chain(&between) {
        let base = 3 * node as usize;
        let moved = Vector3::from_column_slice(&here.seed.state[base..base + 3]);
        let now = Vector3::from(body.nodes_m[node as usize]) + moved;
        let centre = at_rest(top()) + Vector3::from(pose.displacement_m);
        let rigid = centre + turn * (at_rest(node) - at_rest(top()));
        assert!((now - rigid).norm() < 1e-12, "node {node}: {now} expected {rigid}");
    }
}

/// The nodal body force does the exact work on every field of the element: u_z = x^2 with quadratic elements.
#[test]
fn a_body_force_does_exact_work_on_every_field_of_the_element() {
    let mesh = beam();
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for x in &mesh.nodes_m {
        for axis in 0..3 {
            (low[axis], high[axis]) = (low[axis].min(x[axis]), high[axis].max(x[axis]));
        }
    }
    let area = (high[1] - low[1]) * (high[2] - low[2]);
    let moment =
        |power: i32| (high[0].powi(power + 1) - low[0].powi(power + 1)) / f64::from(power + 1) * area;
    for (order, powers) in [(Order::Linear, 0..=1), (Order::Quadratic, 0..=2)] {
        let force = 1.0e4;
        let model =
            Model { order, body_force_n_m3: [0.0, 0.0, force], ..Model::uniform(mooney_rivlin(), &fixed()) };
        let body = Body::new(&mesh, &model).expect("every element has volume");
        for power in powers {
            let work: f64 = (0..body.nodes_m.len())
                .map(|n| body.external_force_n[3 * n + 2] * body.nodes_m[n][0].powi(power))
                .sum();
            let exact = force * moment(power);
            assert!((work / exact - 1.0).abs() < 1e-12, "{order:?}, x^{power}: {work}, expected {exact}");
        }
    }
}

/// The stress jumps at the border of two incompressible materials, so each has its own pressure there.
#[test]
fn materials_do_not_share_a_pressure() {
    let mesh = beam();
    let region_of_tet: Vec<u16> = (0..mesh.tets.len()).map(|tet| u16::from(tet >= 60)).collect();
    let regions = vec![mooney_rivlin().into(), mooney_rivlin().into()];
    let model =
        Model { regions, region_of_tet: region_of_tet.clone(), ..Model::uniform(mooney_rivlin(), &fixed()) };
    let body = Body::new(&mesh, &model).expect("every element has volume");
    let mut border = 0;
    for vertex in 0..mesh.nodes_m.len() as u32 {
        let mut touching: Vec<u16> = (0..mesh.tets.len())
            .filter(|&t| mesh.tets[t].contains(&vertex))
            .map(|t| region_of_tet[t])
            .collect();
        touching.sort_unstable();
        touching.dedup();
        let mut sites: Vec<u16> =
            body.pressure_sites.iter().filter(|(v, _)| *v == vertex).map(|(_, r)| *r).collect();
        sites.sort_unstable();
        assert_eq!(sites, touching, "vertex {vertex}");
        border += usize::from(touching.len() == 2);
    }
    assert!(border > 4, "the two materials must share vertices");
    for (element, region) in body.elements.iter().zip(&region_of_tet) {
        assert!(element.pressures.iter().all(|&p| body.pressure_sites[p as usize].1 == *region));
    }
}
