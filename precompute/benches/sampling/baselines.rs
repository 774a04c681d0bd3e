//! The paper's methods on the reference of a node.

use std::collections::{BTreeMap, HashMap, HashSet};

use palpate_core::{CORNERS, Method};
use palpate_precompute::fit::{Centre, Kernel, KernelFit, RbfFit, Sample, fit_rbf};
use palpate_precompute::num::{EnergyJet, distance, in_ball, norm};
use palpate_precompute::space::expand_model;
use palpate_precompute::spec::{GridIndex, Lattice, Requirements, SpaceGrid};

use super::Case;
use super::reach::{is_inside, is_reached};
use super::search::SingleSolverSearch;
use super::tables::{Place, Tables};

/// Required share of the positions within the tolerance.
const REQUIRED_SHARE: f64 = 0.99;
/// Refinement factor from one lattice, or set of centres, to the next.
const REFINEMENT: f64 = 1.08;
const CENTRE_GROWTH: f64 = 1.15;
/// Largest number of points, or centres, that is tried.
const MAX_POINTS: usize = 20_000;
const MAX_CENTRES: usize = 1_500;
/// Candidate positions for centres.
const CANDIDATES: u32 = 6000;

/// Configurations that one method needs.
#[derive(Debug)]
pub(crate) struct Need {
    pub(crate) way: &'static str,
    /// Number of configurations; `None` if it exceeds the largest number tried.
    pub(crate) configurations: Option<usize>,
    /// Share of the positions within the tolerance.
    pub(crate) within: f64,
    /// The same share with solved configurations, if requested; `None` if some could not be solved.
    pub(crate) within_real: Option<f64>,
}

/// The paper's methods, and the data for their tables.
pub(crate) struct Baselines<'p> {
    pub(crate) reference: KernelFit,
    pub(crate) wanted: Requirements,
    pub(crate) places: &'p [Place],
}

/// The solver for real configurations, if requested.
pub(crate) type Real<'r> = Option<(&'r Case<'r>, &'r SingleSolverSearch)>;

impl Baselines<'_> {
    /// The need of every method; `rest` is the configuration at rest.
    pub(crate) fn all(&self, rest: EnergyJet, real: Real<'_>) -> Vec<Need> {
        let whole = |complete_cells: bool| {
            move |grid: SpaceGrid| {
                let jet = |index: GridIndex| match index {
                    [0, 0, 0] => rest,
                    _ => self.reference.jet(grid.displacement_m(index)),
                };
                expand_model(&Lattice { grid, complete_cells, increments: None }, &self.wanted, false, jet)
            }
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
        let inside: HashSet<GridIndex> = grid.points(true).into_iter().collect();
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

/// A configuration in the packer's format.
fn sample(index: GridIndex, jet: &EnergyJet, terminating: bool) -> Sample {
    Sample { index, attempt: 0, jet: *jet, derivatives: None, terminating, inverted: false }
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
