//! Predicts one active node's space for every reasonable sampling, from the surrogate of its probes, and the
//! possible outcomes of the sampling that the scene specifies.

use crate::adaptive::{Resampled, resample};
use crate::fit::displacement_of_fit;
use crate::num::{distance, norm};
use crate::space::FallbackLattice;
use crate::spec::{DisplacementBound, Lattice, Sampling, SpaceGrid, Tolerance};
use palpate_core::Method;

use super::draws::{self, Fallback, Known, OpenSearch, Outlook, SolveTimes};
use super::error::PlanError;
use super::probe::Probed;
use super::surrogate::{Scattered, Surrogate};
use super::tables::{Error, Place, Tables, VisualModel, percentile_99, space_bytes};

/// Cells along the radius of the paper's grids.
const CELLS: [f64; 4] = [5.0, 7.0, 10.0, 15.0];
/// Lattices with more points are not built. Their values are extrapolated from the coarser ones.
const MAX_POINTS: usize = 2500;
/// Number of positions where tables are compared with the surrogate.
const POSITIONS: u32 = 600;
/// Convergence order of rbf-cubic on a lattice, used if only one lattice was fitted (measured).
const RBF_ORDER: f64 = 3.0;
/// Range to which the observed order of two lattices is limited.
const ORDERS: [f64; 2] = [1.0, 6.0];

/// Methods that are compared, each on a lattice.
pub(super) const METHODS: [Method; 4] = [Method::Trilinear, Method::Hybrid, Method::RbfCubic, Method::Energy];

/// A sampling of one node's space.
#[derive(Debug, Clone)]
pub(super) struct Choice {
    /// Spacing, m; `None` if positions are scattered.
    pub spacing_m: Option<f64>,
    /// Number of solved configurations, including rest.
    pub configurations: f64,
    /// Total seconds of the solves on one thread.
    pub solving_s: f64,
    /// The lattice of its tables.
    pub grid: SpaceGrid,
    /// Number of points of that lattice with a configuration.
    pub solved: usize,
    /// Error and nanoseconds of every method that has a table.
    pub methods: Vec<(Method, Error, f64)>,
    /// Whether the tables were built and not extrapolated from coarser ones.
    pub built: bool,
}

/// Added to the number of probes when their failures are extrapolated.
const MAX_SEPARATE_NODES: f64 = 16.0;
/// A linear body with a smaller share of the positions within the tolerance is not evaluated further.
const MIN_SHARE: f64 = 0.9;

/// All results of one node.
#[derive(Debug)]
pub(super) struct NodePlan {
    /// Results of the probes.
    pub probed: Probed,
    /// Scattered first, then lattices from coarse to fine.
    pub choices: Vec<Choice>,
    /// Error of a linear body.
    pub linear: Error,
    /// Configurations of a scattered space of the linear body; NaN if its error is large.
    pub linear_configurations: f64,
    /// The displacement planes for display; `None` if no display is needed.
    pub eye: Option<VisualModel>,
    /// The possible outcomes of the sampling that the scene specifies.
    pub outlook: Outlook,
}

impl Choice {
    /// Bytes of the space with the tables of these methods.
    pub(super) fn bytes(&self, methods: &[Method], eye: Option<&VisualModel>) -> usize {
        space_bytes(&self.grid, self.solved, methods, eye)
    }

    /// Error and nanoseconds of a method, by its name.
    pub(super) fn of(&self, method: &str) -> Option<(Error, f64)> {
        self.methods.iter().find(|(m, ..)| m.name() == method).map(|&(_, error, ns)| (error, ns))
    }
}

/// The lattices that are compared: the paper's, and the scene's. Every cell is complete unless the scene
/// specifies otherwise.
pub(super) fn lattices(sampling: &Sampling) -> Vec<Lattice> {
    let (radius_m, own) = (sampling.radius_m(), sampling.lattice());
    let complete_cells = own.is_none_or(|own| own.complete_cells);
    let increments = own.and_then(|own| own.increments);
    let mut spacings: Vec<f64> = CELLS.iter().map(|cells| radius_m / cells).collect();
    if let Some(own) = own {
        let spacing_m = own.grid.spacing_m;
        spacings.retain(|s| (s / spacing_m - 1.0).abs() > 0.02);
        spacings.push(spacing_m);
    }
    spacings.sort_by(|a, b| b.total_cmp(a));
    let lattice = |spacing_m| {
        Some(Lattice { grid: SpaceGrid::new(spacing_m, radius_m).ok()?, complete_cells, increments })
    };
    spacings.into_iter().filter_map(lattice).collect()
}

/// Plans the space of a node from its probes.
pub(super) fn plan(
    probed: Probed,
    sampling: &Sampling,
    bound: Option<DisplacementBound>,
) -> Result<NodePlan, PlanError> {
    let truth = Surrogate::of(&probed).ok_or(PlanError::NoFit)?;
    let search = truth.scattered();
    let places = truth.places(&search.fit, POSITIONS);
    let resampled = resample(&search.fit)?;
    let eye = bound.and_then(|bound| eye(&probed, search.fit.fit.length_m, &resampled, bound));
    let mut choices = vec![scattered(&probed, &truth, &search, &resampled, &places)];
    choices.extend(on_lattices(&probed, &truth, sampling, &choices[0], &places));
    let known = match sampling.lattice() {
        None => of_search(&probed, &truth, &search, &choices[0], &resampled, eye.as_ref()),
        Some(own) => {
            let spacing_m = Some(own.grid.spacing_m);
            let choice = choices.iter().find(|choice| choice.spacing_m == spacing_m).unwrap_or(&choices[0]);
            Known::Lattice {
                points: choice.configurations,
                domain: own.grid.points(own.complete_cells).len() as f64,
                search_solves: search.configurations,
                has_lost_probe: probed.lost + probed.elsewhere > 0,
                increments: f64::from(own.increments.unwrap_or(1)),
                blob_bytes: choice.bytes(&[Method::Energy], eye.as_ref()) as f64,
            }
        }
    };
    let (linear, share) = linear_error(&truth, &places, &probed.wanted.tolerance);
    let linear_configurations =
        if share >= MIN_SHARE { truth.linear().scattered().configurations } else { f64::NAN };
    let outlook = Outlook { times: SolveTimes::of(&probed), known };
    Ok(NodePlan { linear, linear_configurations, probed, choices, eye, outlook })
}

/// Error and nanoseconds of every method that has a table.
fn measured(tables: &Tables, places: &[Place], tolerance: &Tolerance) -> Vec<(Method, Error, f64)> {
    let error = |&method: &Method| {
        Some((method, tables.error(method, places, tolerance)?, tables.nanoseconds(method, places)))
    };
    METHODS.iter().filter_map(error).collect()
}

/// The choice of scattered positions.
fn scattered(
    probed: &Probed,
    truth: &Surrogate,
    search: &Scattered,
    resampled: &Resampled,
    places: &[Place],
) -> Choice {
    let wanted = &probed.wanted;
    let tables = Tables::of(&resampled.grid, &resampled.samples);
    let mut methods = measured(&tables, places, &wanted.tolerance);
    // A scattered table is used with `energy` only, because only that method needs its derivatives.
    methods.retain(|(method, ..)| *method == Method::Energy);
    // If adaptive sampling ends within the probes, all its configurations are known: the error is the
    // surrogate's, times the factor for features that the probes do not show. If it needs more, its end is a
    // passed test and gives no error. The estimate is then the geometric mean of that error and the
    // tolerance.
    let configurations = draws::likely_solves(search.configurations);
    let is_open = configurations > probed.jets.len() as f64;
    let mut allowed: Vec<f64> = places.iter().map(|place| wanted.tolerance.at(place.exact)).collect();
    allowed.sort_by(f64::total_cmp);
    let allowed_n = allowed.get(allowed.len() / 2).copied().unwrap_or(wanted.tolerance.absolute_n);
    for (_, error, _) in &mut methods {
        error.p99_n *= truth.doubt();
        if is_open {
            error.p99_n = (error.p99_n * allowed_n).sqrt();
        }
    }
    // If the body needs more configurations than the surrogate, the table is refined in proportion.
    let finer = libm::cbrt((configurations / search.solved as f64).max(1.0));
    let grid = SpaceGrid::new(resampled.grid.spacing_m / finer, resampled.grid.radius_m);
    Choice {
        spacing_m: None,
        configurations,
        solving_s: SolveTimes::of(probed).search_s(configurations),
        grid: grid.unwrap_or(resampled.grid),
        solved: resampled.samples.len(),
        methods,
        built: true,
    }
}

/// What the probes show of the search.
fn of_search(
    probed: &Probed,
    truth: &Surrogate,
    search: &Scattered,
    choice: &Choice,
    resampled: &Resampled,
    eye: Option<&VisualModel>,
) -> Known {
    let tried = 1.0 + probed.far_s.len() as f64;
    if probed.has_ended {
        // A node that the largest force cannot move is omitted.
        let is_packed = probed.too_stiff.is_none();
        let blob_bytes = if is_packed { choice.bytes(&[Method::Energy], eye) as f64 } else { 0.0 };
        return Known::Ended { tried, kept: tried - probed.failed as f64, blob_bytes };
    }
    let of_grid = |grid: &SpaceGrid, solved| space_bytes(grid, solved, &[Method::Energy], eye) as f64;
    let grid = &resampled.grid;
    let with_cells = |cells: u32| {
        let finer = SpaceGrid::new(grid.radius_m / f64::from(cells), grid.radius_m);
        finer.map_or(f64::NAN, |finer| of_grid(&finer, choice.solved))
    };
    let fallback = FallbackLattice::within(probed.wanted.radius_m).map(|FallbackLattice { grid, .. }| {
        let lattice = Lattice { grid, complete_cells: true, increments: None };
        let points = truth.lattice_that_takes_over(&lattice).samples.len();
        Fallback { points: points as f64 - 1.0, blob_bytes: of_grid(&grid, points) }
    });
    Known::Open(OpenSearch {
        tried,
        solves: [search.solved as f64, search.configurations],
        failing: probed.failed as f64 / (tried + MAX_SEPARATE_NODES),
        has_lost_probe: probed.lost + probed.elsewhere > 0,
        cells: grid.radius_m / grid.spacing_m,
        bytes: (2..=12).map(with_cells).filter(|bytes| bytes.is_finite()).collect(),
        fallback,
    })
}

/// The choices of lattices, from coarse to fine.
fn on_lattices(
    probed: &Probed,
    truth: &Surrogate,
    sampling: &Sampling,
    scattered: &Choice,
    places: &[Place],
) -> Vec<Choice> {
    let mut choices: Vec<Choice> = Vec::new();
    let mut shares: Vec<(f64, f64)> = Vec::new();
    for lattice in lattices(sampling) {
        let grid = lattice.grid;
        let points = grid.points(lattice.complete_cells).len();
        let parts = f64::from(lattice.increments.unwrap_or(1));
        let choice = if points <= MAX_POINTS || shares.is_empty() {
            let samples = truth.lattice(&lattice).samples;
            shares.push((grid.spacing_m, samples.len() as f64 / points as f64));
            let methods = measured(&Tables::of(&grid, &samples), places, &probed.wanted.tolerance);
            let (configurations, solved) = (samples.len() as f64, samples.len());
            Choice { configurations, solved, grid, methods, built: true, ..scattered.clone() }
        } else {
            let configurations = points as f64 * share_at(&shares, grid.spacing_m);
            let solved = configurations.round() as usize;
            Choice { configurations, solved, grid, methods: Vec::new(), built: false, ..scattered.clone() }
        };
        let methods = continued(&choices, &choice);
        choices.push(Choice {
            spacing_m: Some(grid.spacing_m),
            solving_s: SolveTimes::of(probed).lattice_s(choice.configurations) * parts,
            methods,
            ..choice
        });
    }
    choices
}

/// Error of a linear body, and the share of the places within the tolerance.
fn linear_error(truth: &Surrogate, places: &[Place], tolerance: &Tolerance) -> (Error, f64) {
    let linear = truth.linear();
    let mut errors = Vec::new();
    let mut within = 0;
    for &Place { at, exact } in places {
        let found = linear.force_n(at);
        let error_n = distance(found, exact);
        within += usize::from(error_n <= tolerance.at(exact));
        errors.push(error_n);
    }
    let share = within as f64 / errors.len().max(1) as f64;
    (Error { p99_n: percentile_99(&mut errors), within: share }, share)
}

/// Size of the displacement planes, by the packer's fit of the surface at the probes.
fn eye(probed: &Probed, length_m: f64, on: &Resampled, bound: DisplacementBound) -> Option<VisualModel> {
    let vertices = probed.moved.first()?.1.displacement_m.len() / 3;
    let fit = displacement_of_fit(length_m, &probed.moved, (&on.grid, &on.samples), bound)?;
    let outliers = fit.outlier_row.len() as f64 / on.samples.len().max(1) as f64;
    Some(VisualModel { vertices, modes: fit.scale.len(), slopes: fit.slopes, outliers })
}

/// The methods of a lattice: as built, or extrapolated from the coarser lattices by their observed order.
fn continued(coarser: &[Choice], choice: &Choice) -> Vec<(Method, Error, f64)> {
    let of = |c: &Choice, method| c.methods.iter().find(|(m, ..)| *m == method).copied();
    METHODS
        .iter()
        .filter_map(|&method| {
            if let Some(built) = of(choice, method) {
                return Some(built);
            }
            let known: Vec<(f64, Error, f64, usize)> = coarser
                .iter()
                .filter_map(|c| of(c, method).map(|(_, error, ns)| (c.grid.spacing_m, error, ns, c.solved)))
                .collect();
            let &(spacing_m, error, ns, solved) = known.first()?;
            let shown = known.get(1).map(|(finer_m, finer, ..)| {
                libm::log(finer.p99_n / error.p99_n) / libm::log(finer_m / spacing_m)
            });
            let order = match method {
                Method::RbfCubic => RBF_ORDER,
                _ => shown.filter(|order| order.is_finite())?.clamp(ORDERS[0], ORDERS[1]),
            };
            let p99_n = error.p99_n * libm::pow(choice.grid.spacing_m / spacing_m, order);
            let within = known.iter().map(|(_, error, ..)| error.within).fold(0.0, f64::max);
            // A sum over all centres takes time in proportion to their number. The other methods evaluate one
            // cell.
            let longer = if method == Method::RbfCubic { choice.solved as f64 / solved as f64 } else { 1.0 };
            Some((method, Error { p99_n, within }, ns * longer))
        })
        .collect()
}

/// Share of a domain's points that are solved. The share of the rim depends on the spacing.
fn share_at(known: &[(f64, f64)], spacing_m: f64) -> f64 {
    match known {
        [.., (coarse_m, coarse), (fine_m, fine)] if coarse_m != fine_m => {
            let slope = (coarse - fine) / (coarse_m - fine_m);
            (fine + slope * (spacing_m - fine_m)).clamp(0.5 * fine, 1.0)
        }
        [.., (_, share)] => *share,
        [] => 1.0,
    }
}

/// Mean; zero for an empty list.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Selects the nodes to probe with large distances: the first node, then always the farthest from those
/// selected.
pub(super) fn spread(positions: &[[f64; 3]], most: usize) -> Vec<usize> {
    let mut taken: Vec<usize> = Vec::new();
    let mut gap = vec![f64::INFINITY; positions.len()];
    while taken.len() < most.min(positions.len()) {
        let next =
            (0..positions.len()).max_by(|&a, &b| gap[a].total_cmp(&gap[b]).then(b.cmp(&a))).unwrap_or(0);
        taken.push(next);
        for (gap, at) in gap.iter_mut().zip(positions) {
            *gap = gap.min(norm(std::array::from_fn(|i| at[i] - positions[next][i])));
        }
    }
    taken.sort_unstable();
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_spread() {
        let line: Vec<[f64; 3]> = (0..11).map(|n| [f64::from(n), 0.0, 0.0]).collect();
        assert_eq!(spread(&line, 3), [0, 5, 10]);
        assert_eq!(spread(&line[..2], 4), [0, 1]);
    }

    #[test]
    fn a_finer_lattice_continues_the_order_of_the_coarser_ones() {
        let choice = |cells: f64, p99_n: Option<f64>| {
            let grid = SpaceGrid::new(0.05 / cells, 0.05).unwrap();
            let error = |p99_n| (Method::Trilinear, Error { p99_n, within: 0.9 }, 10.0);
            Choice {
                spacing_m: Some(grid.spacing_m),
                configurations: 1.0,
                solving_s: 1.0,
                grid,
                solved: 100,
                methods: p99_n.map(error).into_iter().collect(),
                built: p99_n.is_some(),
            }
        };
        let coarser = [choice(5.0, Some(0.1)), choice(10.0, Some(0.025))];
        let [(_, error, ns)] = continued(&coarser, &choice(20.0, None))[..] else { panic!("one method") };
        assert!((error.p99_n - 0.00625).abs() < 1e-6 && error.within == 0.9 && ns == 10.0, "{error:?}");
    }

    #[test]
    fn the_share_of_solved_points_follows_the_spacing() {
        assert_eq!(share_at(&[(0.01, 0.5)], 0.005), 0.5);
        let share = share_at(&[(0.01, 0.5), (0.007, 0.44)], 0.005);
        assert!((share - 0.40).abs() < 1e-12, "{share}");
    }
}
