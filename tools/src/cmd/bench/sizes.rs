//! `palpate bench fem-sizes`: time and memory of a solve as functions of the number of equations.

use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::fem::material::{Material, MooneyRivlin, NeoHookean};
use palpate_precompute::fem::{Body, Model, Order, Problem, Solver};
use palpate_precompute::mesh::TetMesh;

use crate::failure::Failure;
use crate::memory::{forget_peak, peak_mb, shown};
use crate::output;

/// Measure time and memory of a Newton iteration for increasing numbers of equations.
///
/// The bodies are cubes of 0.1 m, touched at the top.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Stop before the first body with more equations than this
    #[arg(long, value_name = "N", default_value_t = 110_000)]
    largest: usize,
}

/// Runs the command and prints a line after each body.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let law = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 });
    let barrier = Material::NeoHookean(NeoHookean {
        lame: palpate_precompute::fem::material::Lame::from_young_poisson(15480.0, 0.45),
    });
    output::line(
        "body                 equations  entries of factor  symbolic s  assembly s  factor s  iteration s  MB (peak)",
    )?;
    for (name, law, order, cells) in [
        ("neo-hookean P1", barrier, Order::Linear, &[8, 12, 16, 22, 28, 31][..]),
        ("mooney-rivlin P1/P1", law.clone(), Order::Linear, &[8, 12, 16, 22, 28]),
        ("mooney-rivlin P2/P1", law, Order::Quadratic, &[4, 6, 8, 10, 12, 14, 15]),
    ] {
        for &n in cells {
            let mesh = TetMesh::cuboid([n; 3], 0.1 / n as f64);
            let fixed: Vec<u32> =
                (0..mesh.nodes_m.len() as u32).filter(|&i| mesh.nodes_m[i as usize][2] == 0.0).collect();
            let top = [0.05, 0.05, 0.1];
            let away = |x: &[f64; 3]| -> f64 { x.iter().zip(top).map(|(a, b)| (a - b) * (a - b)).sum() };
            let active = (0..mesh.nodes_m.len())
                .min_by(|&a, &b| away(&mesh.nodes_m[a]).total_cmp(&away(&mesh.nodes_m[b])))
                .expect("a cube has nodes");
            let model = Model { order, ..Model::uniform(law.clone(), &fixed) };
            forget_peak();
            let start = Instant::now();
            let body = Arc::new(Body::new(&mesh, &model)?);
            let problem = Arc::new(Problem::new(body, active as u32));
            let symbolic_s = start.elapsed().as_secs_f64();
            if problem.unknowns() > args.largest {
                break;
            }
            let mut solver = Solver::new(problem.clone());
            let failed = |error| Failure::work(format!("{name}, {n} cells: {error}"));
            let rest = solver.rest().map_err(failed)?;
            let one = solver.advance(&rest.seed, [0.0, 0.0, 1e-3]).map_err(failed)?;
            let profile = solver.profile(&one.seed).map_err(failed)?;
            output::line(format!(
                "{name:20} {:>9} {:>18} {symbolic_s:>11.2} {:>11.4} {:>9.3} {:>12.3} {:>10}",
                problem.unknowns(),
                problem.entries().1,
                profile.assembly_s,
                profile.factorisation_s,
                profile.iteration_s,
                shown(peak_mb()),
            ))?;
        }
    }
    Ok(())
}
