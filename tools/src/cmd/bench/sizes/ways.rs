//! `palpate bench fem-sizes --ways`: what each part of the preconditioner of a large body saves, and what a solve consists of.

use std::sync::Arc;

use palpate_precompute::fem::{NewtonOptions, Solver};

use super::{Cube, TRANSITION_M};
use crate::failure::Failure;
use crate::output;

pub(super) const HEADER: &str = "body                 equations  way                                  steps (increments)  configuration s";

/// Rounds; the time of a way is the median of them.
const ROUNDS: usize = 3;

/// Changes the options of the solver.
type Change = fn(&mut NewtonOptions);

/// The ways from a solved configuration to the next one. The last ones differ in the share near the tool.
const WAYS: [(&str, Change); 7] = [
    ("a factor of every tangent", |newton| newton.large_flops = f64::INFINITY),
    ("the factor at rest", |newton| (newton.near_share, newton.turns) = (0.0, false)),
    ("the factor at rest, turned", |newton| newton.near_share = 0.0),
    ("the factor at rest, 5 % anew", |newton| newton.turns = false),
    ("turned, 5 % anew (as built)", |_| ()),
    ("turned, 2 % anew", |newton| newton.near_share = 0.02),
    ("turned, 10 % anew", |newton| newton.near_share = 0.1),
];

/// Prints the ways of a large body, and the parts of a solve; nothing for a small one.
pub(super) fn print(cube: &Cube) -> Result<(), Failure> {
    let problem = cube.free.at(cube.pad.clone());
    if !problem.is_large() {
        return Ok(());
    }
    let equations = problem.unknowns();
    let mut solver = Solver::new(Arc::new(problem));
    let neighbour = cube.neighbour(&mut solver)?.0;
    let mut ways = WAYS.map(|(name, change)| (name, change, Vec::new(), String::new()));
    for _ in 0..ROUNDS {
        for (_, change, seconds, steps) in &mut ways {
            let mut problem = cube.free.at(cube.pad.clone());
            change(&mut problem.newton);
            let mut solver = Solver::new(Arc::new(problem));
            // What is made once is not measured: the factor at rest, and the analysis near the tool.
            cube.advance(&mut solver, &neighbour, cube.depth_m - TRANSITION_M)?;
            let (reached, time_s) = cube.advance(&mut solver, &neighbour, cube.depth_m)?;
            *steps = format!("{} ({})", reached.iterations, reached.increments);
            seconds.push(time_s);
        }
    }
    for (way, _, mut seconds, steps) in ways {
        seconds.sort_by(f64::total_cmp);
        let (name, median_s) = (cube.name, seconds[ROUNDS / 2]);
        output::line(format!("{name:20} {equations:>9}  {way:35} {steps:>19} {median_s:>16.3}"))?;
    }
    let profile = solver.profile(&neighbour).map_err(|error| cube.failed(error))?;
    output::line(format!(
        "{:20} {equations:>9}  parts, s: tangent {:.3}, residual {:.4}, factor near the tool and turns {:.4}, preconditioner \
         {:.4}, derivatives {:.3}",
        cube.name,
        profile.assembly_s,
        profile.residual_s,
        profile.factorisation_s,
        profile.bare_solve_s,
        profile.derivatives_s,
    ))
}
