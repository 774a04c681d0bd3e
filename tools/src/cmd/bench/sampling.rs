//! `palpate bench sampling`: number of configurations until a scene's force error is below the
//! just-noticeable difference, for uniform and adaptive sampling.
//!
//! Every method is queried at the same new positions, solved by finite elements and used by no fit. For
//! adaptive sampling the configurations are solved. A lattice may need thousands of solves, so the baselines
//! use the forces of a reference: a fit with a quarter of the tolerance over more than the tool's reach. Its
//! own error at the same positions is shown. `--real` also solves the configurations of a baseline at the
//! count found.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::{CORNERS, Method};
use palpate_precompute::adaptive::resample;
use palpate_precompute::fem::Solver;
use palpate_precompute::fit::{Centre, Kernel, KernelFit, RbfFit, Sample, fit_rbf};
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::{EnergyJet, distance, in_ball, in_parallel, norm};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::spec::{GridIndex, Lattice, Requirements, SpaceGrid, Tolerance};
use serde::Serialize;

use super::search::{SingleSolverSearch, search_alone};
use crate::analysis::{self, threads};
use crate::cmd::plan::surrogate::{Surrogate, sample};
use crate::cmd::plan::tables::{Place, Tables};
use crate::failure::Failure;
use crate::output;

/// Count the configurations that a scene needs until the error is imperceptible.
///
/// Lattices and radial basis functions are compared with adaptive sampling. All methods are evaluated at the
/// same new random reachable positions. The counts of the lattices and of the centres are given with and
/// without restriction to the reachable set.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scenes with adaptive sampling
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Number of new positions per node
    #[arg(long, value_name = "N", default_value_t = 299)]
    uniform: usize,
    /// Also solve the configurations of the baselines at the counts found
    #[arg(long)]
    real: bool,
    /// Worker threads; one per core if not given
    #[arg(long)]
    threads: Option<usize>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Required share of the positions within the tolerance.
const REQUIRED_SHARE: f64 = 0.99;
/// Refinement factor from one lattice, or set of centres, to the next.
const REFINEMENT: f64 = 1.08;
const CENTRE_GROWTH: f64 = 1.15;
/// Largest number of points, or centres, that is tried.
const MAX_POINTS: usize = 20_000;
const MAX_CENTRES: usize = 1_500;
/// Ratios of the reference's force limit to that of the scene; the first sufficiently accurate one is used.
const LIMIT_RATIOS: [f64; 3] = [1.5, 1.2, 1.0];
/// Sufficient accuracy: the 99th percentile of its error relative to the tolerance.
const MAX_REFERENCE_ERROR: f64 = 0.2;
/// Candidate positions for centres.
const CANDIDATES: u32 = 6000;

/// A node of a scene.
pub(super) struct Case<'b> {
    pub(super) bench: &'b Analysis,
    pub(super) active: usize,
}

/// Configurations that one method needs.
#[derive(Debug, Clone, Serialize)]
struct Need {
    way: &'static str,
    /// Number of configurations; `None` if it exceeds the largest number tried.
    configurations: Option<usize>,
    /// Share of the positions within the tolerance.
    within: f64,
    /// The same share with solved configurations, if requested; `None` if some could not be solved.
    within_real: Option<f64>,
}

/// Results of a node.
#[derive(Debug, Clone, Serialize)]
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
    needs: Vec<Need>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let benches = args.scenes.iter().map(|path| analysis::load(path)).collect::<Result<Vec<_>, _>>()?;
    let cases: Vec<Case<'_>> = benches
        .iter()
        .flat_map(|bench| (0..bench.scene.active.len()).map(move |active| Case { bench, active }))
        .collect();
    let rows =
        in_parallel(&cases, threads(args.threads)?, |case| case.measured(args)).map_err(Failure::work)?;
    let rows = rows.into_iter().collect::<Result<Vec<Row>, Failure>>()?;
    if args.json {
        return output::line(serde_json::to_string_pretty(&rows).map_err(Failure::work)?);
    }
    rows.iter().try_for_each(|row| output::line(row.in_words()))
}

impl Case<'_> {
    pub(super) fn wanted(&self) -> Result<Requirements, Failure> {
        let scene = &self.bench.scene;
        let sampling = self.bench.sampling()?;
        let Some(scattered) = sampling.scattered() else {
            let path = self.bench.path.display();
            return Err(Failure::input(format!("{path}: give [grid] `cannot_be_felt` instead of a lattice")));
        };
        let node = scene.active[self.active].node;
        let normal = Surface::of(&scene.mesh).normal(node).unwrap_or_default();
        Ok(scattered.wanted(scene.max_force_n, self.bench.body.rest_position_m(node), normal))
    }

    pub(super) fn solver(&self) -> Solver {
        Solver::new(self.bench.problem(&self.bench.scene.active[self.active]))
    }

    fn searched(&self, wanted: Requirements) -> Result<SingleSolverSearch, Failure> {
        search_alone(&mut self.solver(), wanted).map_err(Failure::work)
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
        let on = resample(&own.search.fitted).map_err(Failure::work)?;
        let table = Tables::of(&on.grid, &on.samples);
        let within = table.share_within(Method::Energy, &places, &wanted.tolerance).unwrap_or(0.0);
        let baselines = Baselines { reference: reference.search.fitted.fit.clone(), wanted, places: &places };
        let real = args.real.then_some((self, &reference));
        let scene = &self.bench.scene;
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
    pub(super) fn truths(
        &self,
        reference: &SingleSolverSearch,
        wanted: &Requirements,
        count: usize,
    ) -> Vec<Place> {
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

/// The paper's methods, and the data for their tables.
struct Baselines<'p> {
    reference: KernelFit,
    wanted: Requirements,
    places: &'p [Place],
}

/// The solver for real configurations, if requested.
type Real<'r> = Option<(&'r Case<'r>, &'r SingleSolverSearch)>;

impl Baselines<'_> {
    fn all(&self, rest: EnergyJet, real: Real<'_>) -> Vec<Need> {
        let body = Surrogate::exact(self.reference.clone(), rest, self.wanted);
        let whole = |complete_cells: bool| {
            let body = &body;
            move |grid: SpaceGrid| body.lattice(&Lattice { grid, complete_cells, increments: None }).samples
        };
        let region = |grid: SpaceGrid| self.in_region(&grid);
        vec![
            self.on_lattice("tri-linear, lattice", Method::Trilinear, &whole(true), real),
            self.on_lattice("tri-linear, region", Method::Trilinear, &region, real),
            self.on_lattice("tri-cubic, lattice", Method::Tricubic, &whole(true), real),
            self.on_lattice("tri-cubic, region", Method::Tricubic, &region, real),
            self.on_lattice("rbf-cubic, lattice", Method::RbfCubic, &whole(false), real),
            self.by_centres("rbf-cubic, region", real),
        ]
    }

    /// The coarsest lattice that is sufficient.
    fn on_lattice(
        &self,
        way: &'static str,
        method: Method,
        samples: &dyn Fn(SpaceGrid) -> Vec<Sample>,
        real: Real<'_>,
    ) -> Need {
        let (mut cells, mut last, mut before) = (1.0_f64, 0.0, 0);
        let most = if method == Method::RbfCubic { MAX_CENTRES } else { MAX_POINTS };
        loop {
            let grid = SpaceGrid::new(self.wanted.radius_m / cells, self.wanted.radius_m);
            cells *= REFINEMENT;
            let Ok(grid) = grid else { continue };
            let samples = samples(grid);
            if samples.len() > most {
                return Need { way, configurations: None, within: last, within_real: None };
            }
            if samples.len() <= before {
                continue;
            }
            before = samples.len();
            last = self.share(&grid, &samples, method);
            if last >= REQUIRED_SHARE {
                let solved = real.map(|real| solved(real, &grid, &samples));
                let within_real = solved.flatten().map(|solved| self.share(&grid, &solved, method));
                return Need { way, configurations: Some(samples.len()), within: last, within_real };
            }
        }
    }

    fn share(&self, grid: &SpaceGrid, samples: &[Sample], method: Method) -> f64 {
        if method == Method::RbfCubic {
            let centres: Vec<Centre> = samples.iter().map(Centre::from).collect();
            return self.share_of_centres(&centres, grid.spacing_m).unwrap_or(0.0);
        }
        let tables = Tables::of_forces(grid, samples);
        tables.share_within(method, self.places, &self.wanted.tolerance).unwrap_or(0.0)
    }

    /// Corners of the cells within the tool's reach.
    fn in_region(&self, grid: &SpaceGrid) -> Vec<Sample> {
        let reach = grid.lattice.reach();
        let mut known: HashMap<GridIndex, bool> = HashMap::new();
        let mut corners: BTreeMap<GridIndex, ()> = BTreeMap::from([([0; 3], ())]);
        let is_there = |at: [f64; 3]| {
            norm(at) <= self.wanted.radius_m
                && is_inside(&self.wanted, at)
                && is_reached(&self.wanted, self.reference.force_n(at))
        };
        let range = || -reach..reach;
        for i in range() {
            for j in range() {
                for k in range() {
                    let all = CORNERS.map(|[x, y, z]| [i + x, j + y, k + z]);
                    let middle = [i, j, k].map(|n| (f64::from(n) + 0.5) * grid.spacing_m);
                    let mut at_corner =
                        |n: GridIndex| *known.entry(n).or_insert_with(|| is_there(grid.displacement_m(n)));
                    if all.iter().any(|&corner| at_corner(corner)) || is_there(middle) {
                        corners.extend(all.map(|corner| (corner, ())));
                    }
                }
            }
        }
        let inside: std::collections::HashSet<GridIndex> = grid.points(true).into_iter().collect();
        let of = |index: GridIndex| self.sample(grid, index);
        corners.into_keys().filter(|index| inside.contains(index)).map(of).collect()
    }

    fn sample(&self, grid: &SpaceGrid, index: GridIndex) -> Sample {
        let jet = self.reference.jet(grid.displacement_m(index));
        let mut sample = sample(index, &jet, norm(jet.force_n) > self.wanted.max_force_n);
        if index == [0; 3] {
            sample.jet.force_n = [0.0; 3];
        }
        sample
    }

    /// Centres within reach, each the farthest from those before it, until their number is sufficient.
    fn by_centres(&self, way: &'static str, real: Real<'_>) -> Need {
        let candidates: Vec<[f64; 3]> = (0..CANDIDATES)
            .map(|n| in_ball(n, 0.5, self.wanted.radius_m))
            .filter(|&at| is_inside(&self.wanted, at) && is_reached(&self.wanted, self.reference.force_n(at)))
            .collect();
        let mut gaps = vec![f64::INFINITY; candidates.len()];
        let mut chosen = vec![[0.0; 3]];
        let (mut next, mut last) = (8.0_f64, 0.0);
        let unit_m = self.wanted.radius_m / 5.0;
        let centre = |at: [f64; 3], force_n| Centre { position: at.map(|x| x / unit_m), force_n };
        while chosen.len() < MAX_CENTRES.min(candidates.len()) {
            let taken = chosen[chosen.len() - 1];
            for (gap, &at) in gaps.iter_mut().zip(&candidates) {
                *gap = gap.min(distance(at, taken));
            }
            let farthest = (0..gaps.len()).max_by(|&a, &b| gaps[a].total_cmp(&gaps[b])).unwrap_or(0);
            chosen.push(candidates[farthest]);
            if (chosen.len() as f64) < next {
                continue;
            }
            next *= CENTRE_GROWTH;
            let said =
                |&at: &[f64; 3]| centre(at, if norm(at) == 0.0 { at } else { self.reference.force_n(at) });
            let centres: Vec<Centre> = chosen.iter().map(said).collect();
            last = self.share_of_centres(&centres, unit_m).unwrap_or(0.0);
            if last >= REQUIRED_SHARE {
                let within_real = real.and_then(|real| {
                    let forces = solve_all(real, &chosen)?;
                    let pairs = chosen.iter().zip(forces);
                    let centres: Vec<Centre> = pairs.map(|(&at, jet)| centre(at, jet.force_n)).collect();
                    self.share_of_centres(&centres, unit_m)
                });
                return Need { way, configurations: Some(chosen.len()), within: last, within_real };
            }
        }
        Need { way, configurations: None, within: last, within_real: None }
    }

    /// Share of the positions within the tolerance, by the paper's sum of cubes; `None` if there is no
    /// solution for the weights.
    fn share_of_centres(&self, centres: &[Centre], unit_m: f64) -> Option<f64> {
        let RbfFit { centres, weights, .. } = fit_rbf(Kernel::Cubic, centres, 1).ok()?;
        let is_within = |place: &&Place| {
            let x = place.at.map(|p| p / unit_m);
            let mut found = [0.0; 3];
            for n in 0..centres[0].len() {
                let r = distance(x, [centres[0][n], centres[1][n], centres[2][n]]);
                (0..3).for_each(|i| found[i] += weights[i][n] * r * r * r);
            }
            distance(found, place.exact) <= self.wanted.tolerance.at(place.exact)
        };
        Some(self.places.iter().filter(is_within).count() as f64 / self.places.len().max(1) as f64)
    }
}

/// Solves the same samples by finite elements, each from the nearest known state.
fn solved(
    real: (&Case<'_>, &SingleSolverSearch),
    grid: &SpaceGrid,
    samples: &[Sample],
) -> Option<Vec<Sample>> {
    let places: Vec<[f64; 3]> = samples.iter().map(|s| grid.displacement_m(s.index)).collect();
    let jets = solve_all(real, &places)?;
    let of = |(old, jet): (&Sample, EnergyJet)| sample(old.index, &jet, old.terminating);
    Some(samples.iter().zip(jets).map(of).collect())
}

fn solve_all(
    (case, searched): (&Case<'_>, &SingleSolverSearch),
    places: &[[f64; 3]],
) -> Option<Vec<EnergyJet>> {
    let mut solver = case.solver();
    let mut jets = Vec::new();
    for &at in places {
        if norm(at) == 0.0 {
            jets.push(searched.search.fitted.jets[0]);
            continue;
        }
        jets.push(*solver.advance(searched.nearest(at), at).ok()?.jet());
    }
    Some(jets)
}

fn is_inside(wanted: &Requirements, at: [f64; 3]) -> bool {
    wanted.workspace_m.is_none_or(|[low, high]| (0..3).all(|i| (low[i]..=high[i]).contains(&at[i])))
}

/// Whether the tool can cause this force.
fn is_reached(wanted: &Requirements, force_n: [f64; 3]) -> bool {
    let along = |normal: [f64; 3]| force_n.iter().zip(normal).map(|(h, n)| h * n).sum::<f64>();
    norm(force_n) <= wanted.max_force_n && wanted.push.is_none_or(|normal| along(normal) <= 0.0)
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
        for Need { way, configurations, within, within_real } in &self.needs {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_fill_the_ball_and_what_a_tool_meets_has_a_side() {
        let inside = (0..4000).filter(|&n| norm(in_ball(n, 0.5, 1.0)) < 0.5).count();
        assert!((450..550).contains(&inside), "{inside}: an eighth is in the inner half");
        let tolerance = Tolerance::IMPERCEPTIBLE;
        let push = Some([0.0, 0.0, 1.0]);
        let wanted = Requirements {
            tolerance,
            radius_m: 1.0,
            max_force_n: 2.0,
            push,
            workspace_m: None,
            max_configurations: 9,
        };
        assert!(is_reached(&wanted, [0.0, 0.0, -1.0]) && !is_reached(&wanted, [0.0, 0.0, 1.0]));
        assert!(!is_reached(&wanted, [0.0, 0.0, -2.1]));
    }
}
