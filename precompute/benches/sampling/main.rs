//! The number of configurations until a scene's force error is below the just-noticeable difference, for uniform
//! and adaptive sampling: `cargo bench -p palpate-precompute --bench sampling -- SCENE.toml ...`. The results are in
//! docs/measurements.md.
//!
//! Every method is queried at the same new positions, solved by finite elements and used by no fit. For
//! adaptive sampling the configurations are solved. A lattice may need thousands of solves, so the baselines
//! use the forces of a reference: a fit with a quarter of the tolerance over more than the tool's reach. Its
//! own error at the same positions is shown. `--real` also solves the configurations of a baseline at the
//! count found.

mod baselines;
mod reach;
mod search;
mod tables;

use std::path::PathBuf;

use baselines::Baselines;
use clap::Parser;
use palpate_core::Method;
use palpate_precompute::adaptive::resample;
use palpate_precompute::fem::Solver;
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::{distance, in_ball, in_parallel, norm};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::spec::{Requirements, Tolerance};
use reach::{is_inside, is_reached};
use search::{SingleSolverSearch, search_alone};
use tables::{Place, Tables};

/// Count the configurations that a scene needs until the error is imperceptible.
///
/// Lattices and radial basis functions are compared with adaptive sampling. All methods are evaluated at the
/// same new random reachable positions. The counts of the lattices and of the centres are given with and
/// without restriction to the reachable set.
#[derive(Debug, Parser)]
struct Args {
    /// Scenes with adaptive sampling
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Number of new positions per node
    #[arg(long, value_name = "N", default_value_t = 299)]
    uniform: usize,
    /// Also solve the configurations of the baselines at the counts found
    #[arg(long)]
    real: bool,
    /// Worker threads
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Passed by cargo
    #[arg(long, hide = true)]
    bench: bool,
}

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Ratios of the reference's force limit to that of the scene; the first sufficiently accurate one is used.
const LIMIT_RATIOS: [f64; 3] = [1.5, 1.2, 1.0];
/// Sufficient accuracy: the 99th percentile of its error relative to the tolerance.
const MAX_REFERENCE_ERROR: f64 = 0.2;

/// A node of a scene.
struct Case<'b> {
    analysis: &'b Analysis,
    active: usize,
}

/// Results of a node.
#[derive(Debug)]
struct Row {
    scene: String,
    active: String,
    positions: usize,
    verdict: &'static str,
    /// Adaptive sampling: the number of solves, and the error of the packed table.
    solved: usize,
    within: f64,
    /// The reference: number of configurations, ratio of its force limit to f_max, and the 99th percentile of
    /// its error relative to the tolerance.
    reference: (usize, f64, f64),
    needs: Vec<baselines::Need>,
}

fn main() -> Result<(), Failure> {
    let args = Args::parse();
    let scenes = args.scenes.iter().map(|path| Analysis::load(path)).collect::<Result<Vec<_>, _>>()?;
    let cases: Vec<Case<'_>> = scenes
        .iter()
        .flat_map(|analysis| (0..analysis.scene.active.len()).map(move |active| Case { analysis, active }))
        .collect();
    for row in in_parallel(&cases, args.threads, |case| case.measured(&args))? {
        println!("{}", row?.in_words());
    }
    Ok(())
}

impl Case<'_> {
    fn wanted(&self) -> Result<Requirements, Failure> {
        let scene = &self.analysis.scene;
        let sampling = self.analysis.sampling()?;
        let Some(scattered) = sampling.scattered() else {
            let path = self.analysis.path.display();
            return Err(format!("{path}: give [grid] `cannot_be_felt` instead of a lattice").into());
        };
        let node = scene.active[self.active].node;
        let normal = Surface::of(&scene.mesh).normal(node).unwrap_or_default();
        Ok(scattered.wanted(scene.max_force_n, self.analysis.body.rest_position_m(node), normal))
    }

    fn solver(&self) -> Solver {
        Solver::new(self.analysis.problem(&self.analysis.scene.active[self.active]))
    }

    fn searched(&self, wanted: Requirements) -> Result<SingleSolverSearch, Failure> {
        Ok(search_alone(&mut self.solver(), wanted)?)
    }

    fn measured(&self, args: &Args) -> Result<Row, Failure> {
        let wanted = self.wanted()?;
        let own = self.searched(wanted)?;
        let mut best: Option<(SingleSolverSearch, f64, Vec<Place>, f64)> = None;
        for wider in LIMIT_RATIOS {
            let Tolerance { relative, absolute_n } = wanted.tolerance;
            let tolerance = Tolerance { relative: 0.25 * relative, absolute_n: 0.25 * absolute_n };
            let (max_force_n, radius_m) = (wider * wanted.max_force_n, wider.cbrt() * wanted.radius_m);
            let reference =
                self.searched(Requirements { tolerance, max_force_n, radius_m, push: None, ..wanted })?;
            let places = self.truths(&reference, &wanted, args.uniform);
            let fit = &reference.search.fitted.fit;
            let error = |place: &Place| {
                distance(fit.force_n(place.at), place.exact) / wanted.tolerance.at(place.exact)
            };
            let mut errors: Vec<f64> = places.iter().map(error).collect();
            errors.sort_by(f64::total_cmp);
            let p99 = errors.get(errors.len() * 99 / 100).copied().unwrap_or(f64::INFINITY);
            if best.as_ref().is_none_or(|(.., least)| p99 < *least) {
                best = Some((reference, wider, places, p99));
            }
            if p99 <= MAX_REFERENCE_ERROR {
                break;
            }
        }
        let (reference, wider, places, p99) = best.expect("there is at least one reference");
        let on = resample(&own.search.fitted)?;
        let table = Tables::of(&on.grid, &on.samples);
        let within = table.share_within(Method::Energy, &places, &wanted.tolerance).unwrap_or(0.0);
        let baselines = Baselines { reference: reference.search.fitted.fit.clone(), wanted, places: &places };
        let real = args.real.then_some((self, &reference));
        let scene = &self.analysis.scene;
        Ok(Row {
            scene: scene.name.clone(),
            active: scene.active[self.active].name.clone(),
            positions: places.len(),
            verdict: own.verdict.name(),
            solved: own.solved,
            within,
            reference: (reference.solved, wider, p99),
            needs: baselines.all(reference.search.fitted.jets[0], real),
        })
    }

    /// Solves new positions within reach.
    fn truths(&self, reference: &SingleSolverSearch, wanted: &Requirements, count: usize) -> Vec<Place> {
        let mut solver = self.solver();
        let mut places = Vec::new();
        // Sequence numbers that the candidates do not use.
        for n in 1_000_000..1_000_000 + 400 * count as u32 {
            let at = in_ball(n, 0.5, wanted.radius_m);
            let said = reference.search.fitted.fit.force_n(at);
            if norm(said) > 1.1 * wanted.max_force_n || !is_inside(wanted, at) {
                continue;
            }
            let Ok(c) = solver.advance(reference.nearest(at), at) else { continue };
            if !c.switched && is_reached(wanted, c.jet().force_n) {
                places.push(Place { at, exact: c.jet().force_n });
            }
            if places.len() == count {
                break;
            }
        }
        places
    }
}

impl Row {
    fn in_words(&self) -> String {
        let (solves, wider, p99) = self.reference;
        let mut text = format!(
            "{} {}: {} new positions; adaptive sampling {}: {} configurations, {:.1} % within tolerance\n  reference: {solves} configurations to \
             {wider} f_max, p99 of its error {:.0} % of the tolerance",
            self.scene,
            self.active,
            self.positions,
            self.verdict,
            self.solved,
            100.0 * self.within,
            100.0 * p99
        );
        for baselines::Need { way, configurations, within, within_real } in &self.needs {
            let count = configurations.map_or("more".into(), |n| n.to_string());
            let times = configurations.map_or(String::new(), |n| {
                format!("{:.1} times adaptive sampling", n as f64 / self.solved as f64)
            });
            let real =
                within_real.map_or(String::new(), |real| format!(", {:.1} % when solved", 100.0 * real));
            text += &format!("\n  {way:<20} {count:>6}  {:.1} % within{real}  {times}", 100.0 * within);
        }
        text
    }
}
