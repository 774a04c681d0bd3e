//! One configuration of a user's mesh: mesh -> body -> problem -> solve -> energy, force, stiffness.
//!
//! cargo run --release -p palpate-precompute --example configuration

use std::error::Error;
use std::sync::Arc;

use palpate_precompute::fem::material::{Lame, NeoHookean};
use palpate_precompute::fem::{Body, Model, Problem, Solver};
use palpate_precompute::mesh::TetMesh;

fn main() -> Result<(), Box<dyn Error>> {
    // Nodes in metres and four node indices for each tetrahedron. `mesh::read` reads Gmsh, VTK and TetGen
    // files. This beam measures 80 x 20 x 20 mm and has 64 cubes of six tetrahedra.
    let mesh = TetMesh::cuboid([16, 2, 2], 0.005);
    let at_x =
        |x_m: f64| (0..).zip(&mesh.nodes_m).filter(move |(_, p)| (p[0] - x_m).abs() < 1e-9).map(|(n, _)| n);
    let fixed: Vec<u32> = at_x(0.0).collect();
    let tip = at_x(0.08).last().ok_or("the beam has a tip")?;

    let law = NeoHookean { lame: Lame::from_young_poisson(15_480.0, 0.45) };
    let body = Arc::new(Body::new(&mesh, &Model::uniform(law.into(), &fixed))?);
    let mut solver = Solver::new(Arc::new(Problem::new(body, tip)));

    // The rest state, and from there the tip displaced by 15 mm, with as many load steps as convergence
    // needs.
    let rest = solver.rest()?;
    let configuration = solver.advance(&rest.seed, [0.0, 0.0, -0.015])?;

    let jet = configuration.jet();
    println!("displacement  {:?} m", jet.control_m);
    println!("energy        {:.6e} J", jet.energy_j);
    println!("force         {:?} N by the tool on the body", jet.force_n);
    println!("stiffness     {} N/m", jet.stiffness_n_m);
    println!("smallest J    {:.3}", configuration.min_jacobian);
    Ok(())
}
