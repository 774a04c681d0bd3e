//! A scattered space on a lattice, as the core's tables want it.

use std::collections::BTreeMap;

use palpate_core::hermite::HermiteTable;
use palpate_core::lanes::Baseline;

use super::{Search, difference, norm};
use crate::configuration_space::{Domain, GridIndex, SpaceGrid};
use crate::fit::{Derivatives, Sample, hermite_nodes_known};

/// Cells along the radius that are tried, the coarsest first.
const CELLS: [u32; 8] = [3, 4, 5, 6, 7, 8, 10, 12];
/// Share of the tolerance that the table may take.
const SHARE: f64 = 0.1;
/// A finer lattice is worth its bytes where it adds less than this share of the error.
const GAIN: f64 = 0.7;
/// Lattices in a row that were not.
const IN_VAIN: u32 = 2;
/// Places where the table is compared with the fit.
const PLACES: u32 = 600;
/// The lattice ends so much beyond the farthest configuration.
const MARGIN: f64 = 1.05;

/// What a fit says at the points of a lattice.
#[derive(Debug, Clone)]
pub struct Resampled {
    /// The lattice.
    pub grid: SpaceGrid,
    /// Its points where the fit knows something, sorted by index; the rest point has exactly no force.
    pub samples: Vec<Sample>,
    /// All derivatives that the energy's table takes there.
    pub derivatives: BTreeMap<GridIndex, Derivatives>,
    /// What the energy's table adds to the error of the fit, 99th percentile, as a share of the tolerance.
    pub added: f64,
}

/// The coarsest lattice whose table adds no more than a tenth of the tolerance to the fit's error. Where none does, because the fit itself is
/// ragged or its rim is, the coarsest that finer ones are no better than.
pub fn resample(search: &Search) -> Resampled {
    let farthest = search.jets().iter().map(|jet| norm(jet.displacement_m)).fold(0.0, f64::max);
    let radius_m = (MARGIN * farthest).min(search.wanted().radius_m).max(super::UNIT_M);
    let (mut best, mut in_vain): (Option<Resampled>, u32) = (None, 0);
    for cells in CELLS {
        let Ok(grid) = SpaceGrid::new(radius_m / f64::from(cells), radius_m) else { continue };
        let mut on = on_lattice(search, grid);
        on.added = added(search, &on);
        let is_better = best.as_ref().is_none_or(|best| on.added < GAIN * best.added);
        in_vain = if is_better { 0 } else { in_vain + 1 };
        if is_better {
            best = Some(on);
        }
        if in_vain == IN_VAIN || best.as_ref().is_some_and(|best| best.added <= SHARE) {
            break;
        }
    }
    best.expect("a ball of a few cells is a lattice")
}

fn on_lattice(search: &Search, grid: SpaceGrid) -> Resampled {
    let (fit, limit_n) = (search.fit(), search.wanted().max_force_n);
    let (mut samples, mut derivatives) = (Vec::new(), BTreeMap::new());
    let mut points: Vec<GridIndex> = Domain::new(&grid, true).points().collect();
    points.sort_unstable();
    for index in points {
        let at = grid.displacement_m(index);
        if grid.lattice.slot(index).is_none() || !search.knows(at) {
            continue;
        }
        let jet = fit.jet(at);
        let is_rest = index == [0; 3];
        samples.push(Sample {
            index,
            attempt: 0,
            energy_j: if is_rest { 0.0 } else { jet.energy_j },
            force_n: if is_rest { [0.0; 3] } else { jet.force_n },
            stiffness_n_m: std::array::from_fn(|i| std::array::from_fn(|j| jet.stiffness_n_m[(i, j)])),
            third_n_m2: jet.third_n_m2,
            terminating: norm(jet.force_n) > limit_n,
            inverted: false,
        });
        let mut all = fit.derivatives(at);
        if is_rest {
            (all[0][0][0], all[1][0][0], all[0][1][0], all[0][0][1]) = (0.0, 0.0, 0.0, 0.0);
        }
        derivatives.insert(index, all);
    }
    Resampled { grid, samples, derivatives, added: f64::INFINITY }
}

/// 99th percentile of the distance of table and fit, as a share of the tolerance, over places within reach.
fn added(search: &Search, on: &Resampled) -> f64 {
    let nodes = hermite_nodes_known(&on.grid, &on.samples, &on.derivatives);
    let lattice = &on.grid.lattice;
    let Ok(table) = HermiteTable::new(lattice.slots(), &nodes.row, &nodes.nodes) else {
        return f64::INFINITY;
    };
    let mut shares: Vec<f64> = search
        .places(PLACES)
        .into_iter()
        .map(|at| {
            let place = lattice.locate(at.map(|x| x as f32));
            let found = table.energy_gradient(Baseline, lattice.strides(), place.slot, place.t);
            let exact = search.fit().force_n(at);
            norm(difference(found.map(f64::from), exact)) / search.wanted().tolerance.at(exact)
        })
        .collect();
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() * 99 / 100).copied().unwrap_or(0.0)
}
