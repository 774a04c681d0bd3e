//! `palpate bench fem-sizes`: time and memory of a solve as functions of the number of equations.

mod ways;

use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::fem::material::{Lame, Material, MooneyRivlin, NeoHookean};
use palpate_precompute::fem::{
    Body, Configuration, Constraints, Fingertip, Model, Order, Pad, PadProfile, Problem, Seed, Solver,
};
use palpate_precompute::mesh::TetMesh;

use crate::failure::Failure;
use crate::memory::{forget_peak, peak_mb, shown};
use crate::output;

/// Measure time and memory of a configuration for increasing numbers of equations.
///
/// The bodies are cubes of 0.1 m, pressed on top by a fingertip of 15 mm. A configuration starts from the one 10 mm
/// less deep. "with factors" makes a factor of every tangent, which large bodies do without. With `--ways`, what each part
/// of their preconditioner saves, and what a solve consists of.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Leave out bodies with fewer equations than this
    #[arg(long, value_name = "N", default_value_t = 0)]
    smallest: usize,
    /// Stop before the first body with more equations than this
    #[arg(long, value_name = "N", default_value_t = 110_000)]
    largest: usize,
    /// Depth of the configuration, mm; more than 10
    #[arg(long, value_name = "MM", default_value_t = 12.0)]
    depth_mm: f64,
    /// Elements and laws, separated by commas: p1, p1p1, p2p1; all if not given
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    elements: Vec<String>,
    /// Compare preconditioners of large bodies instead, and time the parts of a solve
    #[arg(long)]
    ways: bool,
}

const HEADER: &str = "body                 equations  entries of factor  factor s  first s  steps (increments)  configuration s  with factors s  MB (peak)";
/// Bodies with fewer equations have no part in the exponents: they fit into the cache.
const FITTED_FROM: usize = 5_000;
/// Edge of the cube, m.
const EDGE_M: f64 = 0.1;
/// How far a configuration is from its neighbour, m.
const TRANSITION_M: f64 = 0.01;

/// A cube and the fingertip on it.
struct Cube {
    name: &'static str,
    cells: usize,
    free: Problem,
    pad: Pad,
    depth_m: f64,
}

/// One body of the table.
struct Row {
    equations: usize,
    entries: usize,
    factor_s: f64,
    iterations: u32,
    increments: u32,
    configuration_s: f64,
    /// The same with factors, for a large body.
    with_factors_s: Option<f64>,
    first_s: f64,
    peak_mb: Option<u64>,
}

/// Runs the command and prints a line after each body.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let law = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 });
    let barrier = Material::NeoHookean(NeoHookean { lame: Lame::from_young_poisson(15480.0, 0.45) });
    let all = [
        ("p1", "neo-hookean P1", barrier, Order::Linear, &[8, 12, 16, 19, 22, 25, 28, 31, 32][..]),
        ("p1p1", "mooney-rivlin P1/P1", law.clone(), Order::Linear, &[8, 12, 16, 19, 22, 25, 28, 29]),
        ("p2p1", "mooney-rivlin P2/P1", law, Order::Quadratic, &[4, 6, 8, 10, 11, 12, 13, 14, 15, 16]),
    ];
    if let Some(unknown) = args.elements.iter().find(|name| !all.iter().any(|(key, ..)| key == name)) {
        return Err(Failure::input(format!("no elements `{unknown}`; give p1, p1p1 or p2p1")));
    }
    let depth_m = 1e-3 * args.depth_mm;
    if !(depth_m > TRANSITION_M && depth_m < EDGE_M) {
        return Err(Failure::input(format!("--depth-mm is {}; give one between 10 and 100", args.depth_mm)));
    }
    output::line(if args.ways { ways::HEADER } else { HEADER })?;
    for (key, name, law, order, cells) in all {
        if !args.elements.is_empty() && !args.elements.iter().any(|wanted| wanted == key) {
            continue;
        }
        let mut rows = Vec::new();
        for &n in cells {
            let Some(cube) = Cube::new(name, &law, order, n, depth_m, args.largest)? else { break };
            if cube.free.unknowns() < args.smallest {
                continue;
            }
            if args.ways {
                ways::print(&cube)?;
            } else {
                let row = measure(&cube)?;
                row.print(name)?;
                rows.push(row);
            }
        }
        print_exponents(name, &rows)?;
    }
    Ok(())
}

/// Prints the exponents of the equations: with a factor of every tangent, and of the bodies that do without.
fn print_exponents(name: &str, rows: &[Row]) -> Result<(), Failure> {
    let with = rows.iter().filter(|row| row.equations >= FITTED_FROM);
    let with = with.map(|row| (row.equations as f64, row.with_factors_s.unwrap_or(row.configuration_s)));
    let large = rows.iter().filter(|row| row.with_factors_s.is_some());
    let large = large.map(|row| (row.equations as f64, row.configuration_s));
    for (points, of) in
        [(with.collect::<Vec<_>>(), "with factors"), (large.collect(), "of a large body, without")]
    {
        if let Some(exponent) = exponent(&points) {
            output::line(format!(
                "{name:20} a configuration {of} costs equations^{exponent:.2} ({} bodies)",
                points.len()
            ))?;
        }
    }
    Ok(())
}

/// Slope of the least-squares line through the logarithms; `None` with fewer than three points.
fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (libm::log(x), libm::log(y))).collect();
    if logs.len() < 3 {
        return None;
    }
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / logs.len() as f64;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let over: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    Some(over / logs.iter().map(|p| (p.0 - x) * (p.0 - x)).sum::<f64>())
}

impl Cube {
    /// That of `cells` along an edge; `None` if it has more equations than `largest`.
    fn new(
        name: &'static str,
        law: &Material,
        order: Order,
        cells: usize,
        depth_m: f64,
        largest: usize,
    ) -> Result<Option<Self>, Failure> {
        let mesh = TetMesh::cuboid([cells; 3], EDGE_M / cells as f64);
        let fixed: Vec<u32> =
            (0..mesh.nodes_m.len() as u32).filter(|&i| mesh.nodes_m[i as usize][2] == 0.0).collect();
        forget_peak();
        let body = Arc::new(Body::new(&mesh, &Model { order, ..Model::uniform(law.clone(), &fixed) })?);
        let free = Problem::with(body.clone(), None, Constraints::Elimination);
        if free.unknowns() > largest {
            return Ok(None);
        }
        let tip = Fingertip { radius_m: 0.015, stiffness_pa_m: 2e6, profile: PadProfile::Quartic };
        let top_m = [0.5 * EDGE_M, 0.5 * EDGE_M, EDGE_M];
        let pad = Pad::new(&body, tip, top_m).expect("the top of a cube is free");
        Ok(Some(Self { name, cells, free, pad, depth_m }))
    }

    /// The configuration at a depth from a solved one, and the seconds.
    fn advance(
        &self,
        solver: &mut Solver,
        from: &Seed,
        depth_m: f64,
    ) -> Result<(Configuration, f64), Failure> {
        let start = Instant::now();
        let reached = solver.advance(from, [0.0, 0.0, -depth_m]).map_err(|error| self.failed(error))?;
        Ok((reached, start.elapsed().as_secs_f64()))
    }

    /// The neighbour of the configuration, solved from rest, and the seconds of the first solution.
    fn neighbour(&self, solver: &mut Solver) -> Result<(Seed, f64), Failure> {
        let start = Instant::now();
        let rest = solver.rest().map_err(|error| self.failed(error))?.seed;
        let first_s = start.elapsed().as_secs_f64();
        Ok((self.advance(solver, &rest, self.depth_m - TRANSITION_M)?.0.seed, first_s))
    }

    fn failed(&self, error: impl std::fmt::Display) -> Failure {
        Failure::work(format!("{}, {} cells: {error}", self.name, self.cells))
    }
}

/// Measures a body.
fn measure(cube: &Cube) -> Result<Row, Failure> {
    let problem = Arc::new(cube.free.at(cube.pad.clone()));
    let mut solver = Solver::new(problem.clone());
    let (neighbour, first_s) = cube.neighbour(&mut solver)?;
    let (reached, configuration_s) = cube.advance(&mut solver, &neighbour, cube.depth_m)?;
    let peak = peak_mb();
    drop(solver);
    let mut exact = cube.free.at(cube.pad.clone());
    exact.newton.large_flops = f64::INFINITY;
    let mut solver = Solver::new(Arc::new(exact));
    let with_factors_s = match problem.is_large() {
        true => Some(cube.advance(&mut solver, &neighbour, cube.depth_m)?.1),
        false => None,
    };
    let factor_s = solver.profile(&neighbour).map_err(|error| cube.failed(error))?.factorisation_s;
    Ok(Row {
        equations: problem.unknowns(),
        entries: problem.entries().1,
        factor_s,
        iterations: reached.iterations,
        increments: reached.increments,
        configuration_s,
        with_factors_s,
        first_s,
        peak_mb: peak,
    })
}

impl Row {
    fn print(&self, name: &str) -> Result<(), Failure> {
        let seconds = |s: Option<f64>| s.map_or_else(|| "-".into(), |s| format!("{s:.3}"));
        output::line(format!(
            "{name:20} {:>9} {:>18} {:>9.3} {:>8.2} {:>19} {:>16.3} {:>15} {:>10}",
            self.equations,
            self.entries,
            self.factor_s,
            self.first_s,
            format!("{} ({})", self.iterations, self.increments),
            self.configuration_s,
            seconds(self.with_factors_s),
            shown(self.peak_mb),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponent_of_a_power_is_found() {
        let fitted = exponent(&[2.0, 5.0, 11.0, 23.0].map(|x: f64| (x, 3.0 * libm::pow(x, 1.7))));
        assert!((fitted.expect("four points") - 1.7).abs() < 1e-12);
        assert_eq!(exponent(&[(1.0, 1.0), (2.0, 2.0)]), None);
    }
}
