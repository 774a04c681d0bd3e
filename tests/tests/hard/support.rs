//! Insufficiently constrained bodies: the refusal by the scene, and the behaviour of the solver without that
//! check.

use std::path::Path;

use palpate_precompute::fem::material::Material;
use palpate_precompute::fem::{Configuration, Handle, Model, SolveFailure, Solver};
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::scene::Scene;
use palpate_tests::{beam, mooney_rivlin, nearest_node, nodes_where, st_venant_kirchhoff, write_gmsh22};

use super::meshes::two_pieces;
use super::table::{Case, Cost, row};
use super::walk::{body, norm, problem, relative_error, state};

const DOWN: [f64; 3] = [0.0, 0.002, -0.006];

/// The scene's error for a mesh with these fixed nodes.
fn scene_error(mesh: &TetMesh, fixed: &[u32], active: u32) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    write_gmsh22(mesh, &folder.path().join("a.msh"));
    let text = format!(
        "[mesh]\nfile = \"a.msh\"\n[material]\nlaw = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0\n[fixed]\nnodes = \
         {fixed:?}\n[[active]]\nname = \"A\"\nnode = {active}\n"
    );
    let scene = Scene::parse(&folder.path().join("a.toml"), text).expect("the scene is well-formed");
    scene.resolve().expect_err("planted fault").to_string()
}

fn solve(
    mesh: &TetMesh,
    material: Material,
    fixed: &[u32],
    active: u32,
) -> Result<Configuration, SolveFailure> {
    let body = body(mesh, &Model::uniform(material, fixed));
    let mut solver = Solver::new(problem(&body, Handle::node(active)));
    let rest = solver.rest()?;
    solver.advance(&rest.seed, DOWN)
}

fn report(tried: &str, outcome: &Result<Configuration, SolveFailure>) {
    match outcome {
        Ok(c) => row(Case::Support, tried, Cost::of(0, c), &state(c), "solved"),
        Err(f) => {
            let cost = Cost { iterations: f.iterations, ..Cost::default() };
            row(
                Case::Support,
                tried,
                cost,
                &format!("residual {:.0e} N", f.residual_n),
                &f.reason.to_string(),
            );
        }
    }
}

#[test]
fn two_fixed_nodes_in_line_with_the_tool_are_refused() {
    let mesh = beam();
    let at = |x: [f64; 3]| nearest_node(&mesh, x);
    // Nodes on an edge of the box, which are collinear.
    let line = [at([0.0, 0.0, 0.0]), at([0.04, 0.0, 0.0])];
    let (in_line, off_line) = (at([0.08, 0.0, 0.0]), at([0.06, 0.02, 0.04]));
    let message = scene_error(&mesh, &line, in_line);
    row(Case::Support, "2 fixed nodes, tool in their line: scene", Cost::default(), &message, "refused");
    assert!(message.contains("line") && message.contains("fix at least three nodes"), "{message}");
    for material in [st_venant_kirchhoff(), mooney_rivlin()] {
        let name = material.name();
        let outcome = solve(&mesh, material.clone(), &line, in_line);
        report(&format!("2 fixed nodes, tool in their line: solver, {name}"), &outcome);
        // At rest the body can rotate freely. The tool's motion off the line prevents that, so the solver may
        // converge.
        match outcome {
            Err(failure) => assert!(failure.residual_n.is_finite(), "{failure}"),
            Ok(c) => assert!(c.residual_n < 1e-8 * norm(c.jet().force_n), "{:e} N", c.residual_n),
        }
        // Off the line the tool itself prevents the rotation: three points fix a body.
        let outcome = solve(&mesh, material.clone(), &line, off_line);
        report(&format!("2 fixed nodes, tool off their line: solver, {name}"), &outcome);
        // An unconstrained body follows the tool without a force, or is refused. It must not give a force.
        let none = solve(&mesh, material, &[], off_line);
        report(&format!("nothing fixed: solver, {name}"), &none);
        let resists = none.map_or(0.0, |c| norm(c.jet().force_n));
        assert!(resists < 1e-9, "{name}: {resists:e} N without a support");
    }
}

#[test]
fn a_loose_piece_is_refused_and_a_fixed_one_has_no_effect() {
    let one = beam();
    let mesh = two_pieces(&one, [0.2, 0.0, 0.0]);
    let wall = nodes_where(&one, |x| x[0] == 0.0);
    let active = nearest_node(&one, [0.06, 0.02, 0.04]);
    let message = scene_error(&mesh, &wall, active);
    row(Case::Support, "two pieces, one loose: scene", Cost::default(), &message, "refused");
    assert!(message.contains("separate pieces") && message.contains("no fixed node"), "{message}");
    assert!(Path::new(message.split(':').next().unwrap_or_default()).ends_with("a.toml"), "{message}");
    let n = one.nodes_m.len() as u32;
    let both: Vec<u32> = wall.iter().flat_map(|&node| [node, node + n]).collect();
    for material in [st_venant_kirchhoff(), mooney_rivlin()] {
        let name = material.name();
        let loose = solve(&mesh, material.clone(), &wall, active);
        report(&format!("two pieces, one loose: solver, {name}"), &loose);
        let held = solve(&mesh, material.clone(), &both, active);
        report(&format!("two pieces, both fixed: solver, {name}"), &held);
        let (held, alone) = (held.expect("fixed"), solve(&one, material, &wall, active).expect("fixed"));
        // The matrix of the loose piece is singular with a zero right-hand side: a failure, or the force of
        // the other piece.
        let error = loose.map_or(0.0, |c| relative_error(c.jet().force_n, alone.jet().force_n));
        assert!(error < 1e-9, "{name}: a floating piece changes the force by {error:e}");
        let error = relative_error(held.jet().force_n, alone.jet().force_n);
        assert!(error < 1e-9, "{name}: the other piece changes the force by {error:e}");
        let moved: [f64; 3] =
            std::array::from_fn(|i| held.seed.state[3 * n as usize..6 * n as usize][i..].iter().sum());
        assert!(norm(moved) < 1e-12, "{name}: the other piece moves, {moved:?}");
    }
}
