//! An adaptive search by one solver, with its solved states in memory.

use palpate_precompute::adaptive::{Search, SolveResult, Verdict};
use palpate_precompute::fem::{Seed, SolveFailure, Solver};
use palpate_precompute::num::distance;
use palpate_precompute::spec::Requirements;

/// A completed search.
#[derive(Debug)]
pub(super) struct SingleSolverSearch {
    pub(super) search: Search,
    pub(super) verdict: Verdict,
    /// Number of solved configurations, including rest and those that the fit does not use.
    pub(super) solved: usize,
    /// Displacement, m, and state of each configuration on the branch of its parent; rest is the first.
    seeds: Vec<([f64; 3], Seed)>,
}

/// Runs a search with one solver to its end.
pub(super) fn search_alone(
    solver: &mut Solver,
    wanted: Requirements,
) -> Result<SingleSolverSearch, SolveFailure> {
    let rest = solver.rest()?;
    let mut search = Search::new(wanted, rest.jet());
    let (mut seeds, mut solved) = (vec![([0.0; 3], rest.seed)], 1);
    let verdict = search.run(|search, target| {
        let (parent, at) = (search.fitted.jets[target.parent].control_m, target.displacement_m);
        let outcome = solver.advance(nearest(&seeds, parent), at);
        solved += usize::from(outcome.is_ok());
        match outcome {
            Ok(c) if !c.switched => {
                let jet = *c.jet();
                seeds.push((at, c.seed));
                SolveResult::Solved(jet)
            }
            Ok(c) => SolveResult::OtherBranch(*c.jet()),
            Err(_) => SolveResult::Failed,
        }
    });
    Ok(SingleSolverSearch { search, verdict, solved, seeds })
}

impl SingleSolverSearch {
    /// The state nearest to a displacement in m.
    pub(super) fn nearest(&self, to: [f64; 3]) -> &Seed {
        nearest(&self.seeds, to)
    }
}

fn nearest(seeds: &[([f64; 3], Seed)], to: [f64; 3]) -> &Seed {
    let away = |(at, _): &&([f64; 3], Seed)| distance(*at, to);
    &seeds.iter().min_by(|a, b| away(a).total_cmp(&away(b))).expect("rest is there").1
}
