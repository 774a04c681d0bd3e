//! An adaptive search by one solver in memory, for measurements.

use super::{Search, SolveResult, Step, Verdict};
use crate::fem::solve::{Seed, SolveFailure, Solver};
use crate::num::jet::EnergyJet;
use crate::num::vector::{difference, norm};
use crate::spec::Requirements;

/// A completed search with its solved states.
#[derive(Debug)]
pub struct SingleSolverSearch {
    /// The search.
    pub search: Search,
    /// Result of the search.
    pub verdict: Verdict,
    /// Number of solved configurations, including rest and those that the fit does not use.
    pub solved: usize,
    /// Displacement, m, and state of each configuration on the branch of its parent; rest is the first.
    pub seeds: Vec<([f64; 3], Seed)>,
}

/// The configuration at rest, with zero force by definition.
pub(crate) fn at_rest(solver: &mut Solver) -> Result<(EnergyJet, Seed), SolveFailure> {
    let rest = solver.rest()?;
    Ok((rest.jet().as_rest(), rest.seed))
}

/// Runs a search with one solver to its end.
pub fn search_alone(solver: &mut Solver, wanted: Requirements) -> Result<SingleSolverSearch, SolveFailure> {
    let (rest, seed) = at_rest(solver)?;
    let mut search = Search::new(wanted, &rest);
    let (mut seeds, mut solved) = (vec![([0.0; 3], seed)], 1);
    loop {
        let targets = match search.step() {
            Step::Done(verdict) => return Ok(SingleSolverSearch { search, verdict, solved, seeds }),
            Step::Solve(targets) => targets,
        };
        let parents: Vec<[f64; 3]> = search.jets().iter().map(|jet| jet.control_m).collect();
        let mut found = Vec::new();
        for target in &targets {
            let at = target.displacement_m();
            let outcome = solver.advance(nearest(&seeds, parents[target.parent]), at);
            solved += usize::from(outcome.is_ok());
            found.push(match outcome {
                Ok(c) if !c.switched => {
                    let jet = *c.jet();
                    seeds.push((at, c.seed));
                    SolveResult::Solved(jet)
                }
                Ok(c) => SolveResult::OtherBranch(*c.jet()),
                Err(_) => SolveResult::Failed,
            });
        }
        search.take(&found);
    }
}

impl SingleSolverSearch {
    /// The state nearest to a displacement in m.
    pub fn nearest(&self, to: [f64; 3]) -> &Seed {
        nearest(&self.seeds, to)
    }
}

fn nearest(seeds: &[([f64; 3], Seed)], to: [f64; 3]) -> &Seed {
    let away = |(at, _): &&([f64; 3], Seed)| norm(difference(*at, to));
    &seeds.iter().min_by(|a, b| away(a).total_cmp(&away(b))).expect("rest is there").1
}
