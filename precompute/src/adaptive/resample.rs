//! Resampling of a scattered space on a lattice, for the core's tables.

use std::collections::HashSet;

use palpate_core::{HermitePlanes, LatticeError};

use super::fitted::AdaptiveFit;
use super::local::Fits;
use super::prediction::Verdict;
use crate::fit::{Derivatives, KernelFit, LEAST_ROOT_J, Sample, hermite_nodes, root_nodes};
use crate::num::jet::EnergyJet;
use crate::num::vector::{distance, dot, norm};
use crate::spec::{Domain, GridIndex, MAX_RADIUS_M, MIN_RADIUS_M, Quantity, SpaceGrid, corners};

/// Numbers of cells along the radius, in the order of the attempts.
const CELLS: [u32; 9] = [2, 3, 4, 5, 6, 7, 8, 10, 12];
/// Number of cells of the lattice of a chart along the length of its kernel: at least, and at most where the body is stiff.
const CELLS_A_LENGTH: [f64; 2] = [3.75, 8.0];
/// Number of cells along the way from the first touch to the force limit.
const CELLS_A_PRESS: f64 = 2.5;
/// Largest error of the table, as a share of the tolerance.
const SHARE: f64 = 0.1;
/// A finer lattice counts as better if its error is below this share of the best one.
const IMPROVEMENT: f64 = 0.7;
/// Number of consecutive lattices that are not better before the search ends.
const MAX_NOT_BETTER: u32 = 2;
/// Number of positions for the comparison with the fit, and of positions that select the reachable cells.
const POSITIONS: u32 = 600;
/// A cell of a chart is stored if a corner has at most this multiple of the force limit.
const TABLE_FORCE: f64 = 1.3;
/// Factor of the lattice's radius on the distance of the farthest configuration.
const MARGIN: f64 = 1.05;

/// Way of a sphere from the first touch to the force limit, m: f_max / |ds/dd|^2, whose mean is that of the chart's own
/// configurations.
fn press_m(search: &AdaptiveFit) -> f64 {
    let slopes: Vec<f64> =
        search.own().filter_map(|jet| Some(norm(jet.root(LEAST_ROOT_J)?.force_n).powi(2))).collect();
    search.wanted.max_force_n * slopes.len() as f64 / slopes.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

/// A fit evaluated at the points of a lattice.
#[derive(Debug, Clone)]
pub struct Resampled {
    /// The lattice.
    pub grid: SpaceGrid,
    /// Lattice points at which the fit is valid, sorted by index; the force at rest is exactly zero.
    pub samples: Vec<Sample>,
    /// Error that the energy's table adds to the fit: the 99th percentile, as a share of the tolerance.
    pub added: f64,
}

/// The coarsest lattice whose table adds at most a tenth of the tolerance to the fit's error. If no lattice
/// does because the fit itself is not smooth, the coarsest lattice that finer ones do not improve. A search
/// without configurations, or with all of them close to rest, has the smallest ball.
///
/// # Errors
///
/// If the smallest ball is not a valid lattice of the core.
pub fn resample(search: &AdaptiveFit) -> Result<Resampled, LatticeError> {
    let farthest = search.jets.iter().map(|jet| norm(jet.control_m)).fold(0.0, f64::max);
    let radius_m = (MARGIN * farthest).min(search.wanted.radius_m).clamp(MIN_RADIUS_M, MAX_RADIUS_M);
    if let Some(linear) = linear_table(search, radius_m) {
        return Ok(linear);
    }
    let [asked, reached] = places(search);
    let fits = Fits::of(search);
    let measured = |grid: SpaceGrid| {
        let on = on_lattice(search, &fits, grid, &reached);
        Resampled { added: added(search, &fits, &on, &asked), ..on }
    };
    let grid = |cells: u32| SpaceGrid::new(radius_m / f64::from(cells), radius_m);
    if let Some(column) = search.wanted.column {
        // Beside the body the table differs from the fits on purpose, so that a comparison would not find its lattice.
        let [least, most] = CELLS_A_LENGTH;
        let cells = (CELLS_A_PRESS * column.length_m / press_m(search)).clamp(least, most);
        return Ok(measured(grid((cells * radius_m / column.length_m).ceil() as u32)?));
    }
    let [coarsest, finer @ ..] = CELLS;
    let (mut best, mut not_better) = (measured(grid(coarsest)?), 0);
    for grid in finer.into_iter().filter_map(|cells| grid(cells).ok()) {
        if not_better == MAX_NOT_BETTER || best.added <= SHARE {
            break;
        }
        let on = measured(grid);
        let is_better = on.added < IMPROVEMENT * best.added;
        not_better = if is_better { 0 } else { not_better + 1 };
        if is_better {
            best = on;
        }
    }
    Ok(best)
}

/// The table of the linear model with the fewest bytes, if the search ended with it, up to `radius_m`.
///
/// A quintic Hermite interpolation reproduces a quadratic energy for any cell size, and a tri-linear one its
/// linear force. The cells are therefore as large as the ball.
fn linear_table(search: &AdaptiveFit, radius_m: f64) -> Option<Resampled> {
    if search.verdict != Some(Verdict::Linear) {
        return None;
    }
    let grid = SpaceGrid::new(radius_m, radius_m).ok()?;
    let quadratic = KernelFit::quadratic(radius_m, search.jets.first()?.stiffness_n_m);
    let mut points: Vec<_> = Domain::new(&grid, true).points().collect();
    points.sort_unstable();
    let sample = |&index: &_| {
        let at = grid.displacement_m(index);
        let jet = quadratic.jet(at);
        let terminating = norm(jet.force_n) > search.wanted.max_force_n;
        let derivatives = Some(quadratic.derivatives(at));
        Sample { index, attempt: 0, jet, derivatives, terminating, inverted: false }
    };
    Some(Resampled { grid, samples: points.iter().map(sample).collect(), added: 0.0 })
}

/// Two disjoint sets of reachable positions: one measures the table, the other selects its cells. A cell that
/// only the second set misses thus counts as an error.
fn places(search: &AdaptiveFit) -> [Vec<[f64; 3]>; 2] {
    let all = search.places(2 * POSITIONS);
    let of = |part: usize| all.iter().copied().skip(part).step_by(2).collect();
    [of(0), of(1)]
}

/// The corners of the cells that contain a position.
fn cell_corners(grid: &SpaceGrid, places: &[[f64; 3]]) -> HashSet<GridIndex> {
    let reach = grid.lattice.reach();
    let low = |at: &[f64; 3]| at.map(|x| ((x / grid.spacing_m).floor() as i32).clamp(-reach, reach - 1));
    let cells: HashSet<GridIndex> = places.iter().map(low).collect();
    cells.into_iter().flat_map(corners).collect()
}

/// The corners of the cells of a chart in which a sphere touches the body with a force within reach, and of the cells
/// beside them: there the root falls below zero.
fn touched_corners(search: &AdaptiveFit, fits: &Fits<'_>, grid: &SpaceGrid) -> HashSet<GridIndex> {
    let wanted = &search.wanted;
    let is_wide = |at: [f64; 3]| {
        wanted.column.zip(wanted.push).is_none_or(|(column, normal)| {
            let beyond_m = column.whole_m - column.core_m + grid.spacing_m;
            column.contains(normal, at, beyond_m) && dot(at, normal) <= column.top_m + grid.spacing_m
        })
    };
    let is_touched = |index: &GridIndex| {
        let at = grid.displacement_m(*index);
        let is_within = || {
            let (value, slope) = fits.beside(at).unwrap_or_else(|| fits.at(at).value_and_slope(at));
            let away_m = value / slope.norm().max(f64::MIN_POSITIVE);
            away_m > -grid.spacing_m && value.max(0.0) * slope.norm() <= TABLE_FORCE * wanted.max_force_n
        };
        is_wide(at) && fits.reach(at) && is_within()
    };
    let points = Domain::new(grid, true).points().collect::<Vec<_>>();
    let cell = |index: GridIndex| [-1, 0].map(|k| index.map(|n| n + k));
    let lows = points.into_iter().filter(is_touched).flat_map(cell);
    let cells: HashSet<GridIndex> = lows.collect();
    cells.into_iter().flat_map(corners).collect()
}

/// Evaluates the fit at the points where it is valid, and at all corners of reachable cells. A corner beyond
/// the boundary of the reachable set has a force far above the limit. It still needs the fit's own
/// derivatives, because other values would change the interpolated force inside the set.
fn on_lattice(search: &AdaptiveFit, fits: &Fits<'_>, grid: SpaceGrid, reached: &[[f64; 3]]) -> Resampled {
    let limit_n = search.wanted.max_force_n;
    let is_root = search.wanted.quantity == Quantity::Root;
    let corners = if is_root { touched_corners(search, fits, &grid) } else { cell_corners(&grid, reached) };
    let mut samples = Vec::new();
    let mut points: Vec<GridIndex> = Domain::new(&grid, true).points().collect();
    points.sort_unstable();
    for index in points {
        let at = grid.displacement_m(index);
        let is_valid = corners.contains(&index) || !is_root && search.is_valid_at(at);
        if grid.lattice.slot(index).is_none() || !is_valid {
            continue;
        }
        let (mut jet, mut all) = match fits.beside(at) {
            Some((value, slope)) => {
                let mut all = Derivatives::default();
                (all[0][0][0], all[1][0][0], all[0][1][0], all[0][0][1]) = (value, slope.x, slope.y, slope.z);
                (EnergyJet::from_numbers(at, &[0.0; 20]), all)
            }
            None => {
                let fit = fits.at(at);
                (fit.jet(at), fit.derivatives(at))
            }
        };
        let terminating = norm(jet.force_n) > limit_n;
        if index == [0; 3] && !is_root {
            jet = jet.as_rest();
            (all[0][0][0], all[1][0][0], all[0][1][0], all[0][0][1]) = (0.0, 0.0, 0.0, 0.0);
        }
        samples.push(Sample { index, attempt: 0, jet, derivatives: Some(all), terminating, inverted: false });
    }
    Resampled { grid, samples, added: f64::INFINITY }
}

/// 99th percentile of the difference between table and fit over these reachable positions, as a share of the
/// tolerance.
fn added(search: &AdaptiveFit, fits: &Fits<'_>, on: &Resampled, places: &[[f64; 3]]) -> f64 {
    let is_root = search.wanted.quantity == Quantity::Root;
    let nodes =
        if is_root { root_nodes(&on.grid, &on.samples) } else { hermite_nodes(&on.grid, &on.samples, &[]) };
    let lattice = &on.grid.lattice;
    let table = HermitePlanes { row: &nodes.row, nodes: &nodes.nodes };
    if table.check(lattice).is_err() {
        return f64::INFINITY;
    }
    let mut shares: Vec<f64> = places
        .iter()
        .map(|&at| {
            let located = lattice.locate(at.map(|x| x as f32));
            let found = if is_root {
                table.root_force(lattice, &located)
            } else {
                table.energy_gradient(lattice, &located)
            };
            let exact = fits.at(at).force_n(at);
            distance(found.map(f64::from), exact) / search.wanted.tolerance.at(exact)
        })
        .collect();
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() * 99 / 100).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adaptive::{Search, SolveResult};
    use crate::fit::synthetic::jet;
    use crate::spec::{Requirements, Tolerance};

    /// A body whose stiffness grows by e every 9 mm on one side; an extrapolating polynomial has a large
    /// error after one cell.
    fn steep(p: [f64; 3]) -> EnergyJet {
        const TIMES: f64 = 4.0;
        let jet = jet(p.map(|x| TIMES * x));
        EnergyJet {
            control_m: p,
            energy_j: jet.energy_j / (TIMES * TIMES),
            force_n: jet.force_n.map(|h| h / TIMES),
            third_n_m2: jet.third_n_m2.map(|w| TIMES * w),
            ..jet
        }
    }

    /// A completed search in a ball that is far larger than the reachable set.
    fn searched() -> AdaptiveFit {
        let wanted = Requirements {
            tolerance: Tolerance::IMPERCEPTIBLE,
            radius_m: 0.05,
            max_force_n: 5.0,
            push: None,
            workspace_m: None,
            column: None,
            quantity: Quantity::Energy,
            max_configurations: 100,
        };
        let mut search = Search::new(wanted, &steep([0.0; 3]));
        search.run(|_, target| SolveResult::Solved(steep(target.displacement_m)));
        search.fitted
    }

    #[test]
    fn a_coarse_table_holds_to_the_rim_because_its_corners_are_the_fits_own() {
        let search = searched();
        let on = resample(&search).expect("a lattice");
        let cells = (on.grid.radius_m / on.grid.spacing_m).round();
        println!("{cells} cells add {:.4} of the tolerance", on.added);
        assert!(cells <= 5.0 && on.added <= SHARE, "{cells} cells, {}", on.added);
        // Without the corners that only the cells at the boundary need; they lie beyond the limit.
        let [asked, reached] = places(&search);
        let fits = Fits::of(&search);
        let bare = on_lattice(&search, &fits, on.grid, &[]);
        let whole = on_lattice(&search, &fits, on.grid, &reached);
        assert!(bare.samples.len() < whole.samples.len());
        let (without, with) = (added(&search, &fits, &bare, &asked), added(&search, &fits, &whole, &asked));
        println!("{without:.4} without them, {with:.4} with them");
        assert!(without > 3.0 * with, "{without} {with}");
        assert_eq!(with, on.added);
    }
}
