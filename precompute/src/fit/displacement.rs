//! Surface displacements as the core takes them: a few modes, packed to int16, within the scene's bound at every configuration.
//!
//! 1. **Modes** by the method of snapshots: eigenvectors of the Gram matrix of evenly chosen configurations, in f64, largest first
//!    (proper orthogonal decomposition; no mean is taken off, so that rest stays exactly zero).
//! 2. **Their number** is the one that takes the fewest bytes, where a configuration beyond the bound takes a surface of its own.
//! 3. **Packing**: the modes first; then each configuration's coefficients, one after the other against the modes as packed, so that
//!    what rounding loses in one is mended by the next. What is still beyond the bound becomes an outlier: what the modes miss of it
//!    is stored too, with a scale of its own.
//! 4. **Slopes**: half-way between neighbours a and b tri-linear interpolation errs by (u'_a - u'_b) / 8, derivatives per cell, to third
//!    order. As many of the leading modes get slopes as are needed to keep that within the bound on 95 % of the grid's edges.
//!
//! A corner without a configuration continues its nearest solved neighbours in a straight line: the touched node stays with the tool.

use std::collections::HashSet;

use faer::{Mat, Side};
use palpate_core::displacement::DisplacementPlanes;

use super::fold::Fold;
use super::modes::{Mode, PackedModes, UNITS, dot};
use crate::spec::{DisplacementBound, Domain, GridIndex, SpaceGrid};

impl DisplacementBound {
    /// Whether one surface may stand for the other.
    pub fn allows(&self, found: &Moved, truth: &Moved) -> bool {
        let pairs = found.displacement_m.iter().zip(&truth.displacement_m);
        self.holds(Misfit::of(&pairs.map(|(a, b)| a - b).collect::<Vec<f32>>()))
    }

    fn holds(&self, misfit: Misfit) -> bool {
        misfit.rms_m <= self.rms_m && misfit.max_m <= self.max_m
    }
}

/// Distance of two displacements of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Misfit {
    /// Root mean square over the nodes, m.
    pub rms_m: f64,
    /// Largest, m.
    pub max_m: f64,
}

impl Misfit {
    /// Of the differences x, y, z at each node, m.
    pub fn of<T: Copy + Into<f64>>(differences: &[T]) -> Self {
        let (mut sum, mut largest) = (0.0, 0.0f64);
        let nodes = differences.as_chunks::<3>().0;
        for node in nodes {
            let squared: f64 = node.iter().map(|&x| x.into() * x.into()).sum();
            sum += squared;
            largest = largest.max(squared);
        }
        Self { rms_m: (sum / nodes.len().max(1) as f64).sqrt(), max_m: largest.sqrt() }
    }

    /// The larger of each.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { rms_m: self.rms_m.max(other.rms_m), max_m: self.max_m.max(other.max_m) }
    }
}

/// A solved configuration: x, y, z of every surface node.
#[derive(Debug, Clone, PartialEq)]
pub struct Moved {
    /// Displacement from rest, m.
    pub displacement_m: Vec<f32>,
    /// Its derivatives along x, y and z of the node's displacement.
    pub slopes: [Vec<f32>; 3],
}

/// The planes of the core's table.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DisplacementFit {
    /// Row of every slot of the box; the same as that of [`super::HermiteNodes`].
    pub row: Vec<u32>,
    /// Modes.
    pub modes: Vec<i16>,
    /// Their scales.
    pub scale: Vec<f32>,
    /// How many of them have slopes.
    pub slopes: usize,
    /// Rows of coefficients.
    pub coefficients: Vec<i16>,
    /// Rows that are outliers.
    pub outlier_row: Vec<u32>,
    /// Their scales.
    pub outlier_scale: Vec<f32>,
    /// What the modes miss of them.
    pub outliers: Vec<i16>,
    /// Largest misfits at the configurations.
    pub misfit: Misfit,
}

impl DisplacementFit {
    /// The planes as the core's table borrows them.
    pub fn planes(&self) -> DisplacementPlanes<'_> {
        DisplacementPlanes {
            slopes: self.slopes,
            row: &self.row,
            modes: &self.modes,
            scale: &self.scale,
            coefficients: &self.coefficients,
            outlier_row: &self.outlier_row,
            outlier_scale: &self.outlier_scale,
            outliers: &self.outliers,
        }
    }
}

/// Why there is no such table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DisplacementFault<E> {
    /// A configuration could not be read.
    Read(E),
    /// The modes could not be found.
    Modes,
    /// A configuration cannot be packed within the bound.
    Bound {
        /// The configuration.
        index: GridIndex,
        /// What is left.
        misfit: Misfit,
    },
}

/// Configurations that modes are made of, at most.
const SNAPSHOTS: usize = 1024;
/// Edges of the grid that are asked whether slopes are worth it, at most.
const EDGES: usize = 2000;
/// Share of them that must be within the bound without slopes.
const EDGES_WITHIN: f64 = 0.95;
/// Modes are counted for a bound a little closer than asked: rounding comes on top.
const MARGIN: f64 = 0.98;

/// The table of the configurations at `solved` (sorted, rest among them), each as `read` gives it. All are read twice: those of a
/// large organ do not fit into memory with their slopes.
pub fn fit_displacement<E>(
    grid: &SpaceGrid,
    solved: &[GridIndex],
    folds: &[Fold],
    bound: DisplacementBound,
    mut read: impl FnMut(usize) -> Result<Moved, E>,
) -> Result<DisplacementFit, DisplacementFault<E>> {
    let mut fetch = |at: usize| read(at).map_err(DisplacementFault::Read);
    let mut all: Vec<Vec<f32>> = Vec::with_capacity(solved.len());
    for at in 0..solved.len() {
        all.push(fetch(at)?.displacement_m);
    }
    let domain = Domain::new(grid, true);
    let modes = PackedModes::pack(&choose(all, domain.len(), bound).ok_or(DisplacementFault::Modes)?);

    let mut fit = DisplacementFit { scale: modes.scale.clone(), ..DisplacementFit::default() };
    let mut rows = Vec::with_capacity(solved.len());
    let mut outliers = Vec::new();
    for (at, &index) in solved.iter().enumerate() {
        let Moved { displacement_m, slopes } = fetch(at)?;
        let (values, left) = modes.coefficients(&displacement_m);
        let mut misfit = Misfit::of(&left);
        if !bound.holds(misfit) {
            let outlier = Outlier::pack(&left);
            misfit = Misfit::of(&outlier.left(&left));
            outliers.push((at, outlier));
        }
        if !bound.holds(misfit) {
            return Err(DisplacementFault::Bound { index, misfit });
        }
        fit.misfit = fit.misfit.max(misfit);
        let slopes = slopes.map(|slope| modes.project(&slope, grid.spacing_m));
        rows.push(Row { values: values.iter().map(|&n| f64::from(n)).collect(), slopes });
    }
    fit.slopes = slopes_worth(grid, solved, folds, &modes, &rows, bound);
    fit.modes = modes.numbers;

    fit.row = vec![0; grid.lattice.slots()];
    let mut row_of_sample = vec![0; solved.len()];
    for (row, index) in (0..).zip(domain.points()) {
        let known = solved.binary_search(&index);
        if let Ok(at) = known {
            row_of_sample[at] = row;
        }
        let Some(slot) = grid.lattice.slot(index) else { continue };
        fit.row[slot] = row;
        let ghost;
        let values = match known {
            Ok(at) => &rows[at],
            Err(_) => {
                ghost = Row::ghost(solved, &rows, index);
                &ghost
            }
        };
        values.pack_into(fit.slopes, &mut fit.coefficients);
    }
    let mut outliers: Vec<(u32, Outlier)> =
        outliers.into_iter().map(|(at, outlier)| (row_of_sample[at], outlier)).collect();
    outliers.sort_unstable_by_key(|(row, _)| *row);
    for (row, outlier) in outliers {
        fit.outlier_row.push(row);
        fit.outlier_scale.push(outlier.scale);
        fit.outliers.extend(outlier.numbers);
    }
    Ok(fit)
}

/// The decomposition of evenly chosen displacements.
struct Snapshots {
    /// A column each.
    displacements: Mat<f64>,
    /// Eigenvalues and eigenvectors of their Gram matrix, the smallest first.
    values: Vec<f64>,
    vectors: Mat<f64>,
}

impl Snapshots {
    /// Of these; `None` if the decomposition fails.
    fn of(all: &[Vec<f32>]) -> Option<Self> {
        let count = all.len().min(SNAPSHOTS);
        let length = all.first().map_or(0, Vec::len);
        let displacements = Mat::from_fn(length, count, |i, n| f64::from(all[n * all.len() / count][i]));
        let eigen = (displacements.transpose() * &displacements).self_adjoint_eigen(Side::Lower).ok()?;
        let values: Vec<f64> = eigen.S().column_vector().iter().copied().collect();
        values.iter().all(|x| x.is_finite()).then(|| Self {
            displacements,
            values,
            vectors: eigen.U().to_owned(),
        })
    }

    /// The next mode after these: orthonormal, with its largest component positive; `None` where rounding begins.
    fn next(&self, before: &[Mode]) -> Option<Vec<f64>> {
        let n = self.values.len().checked_sub(before.len() + 1)?;
        if self.values[n] <= 1e-14 * self.values.last()? {
            return None;
        }
        let mode = &self.displacements * self.vectors.col(n);
        let mut mode: Vec<f64> = mode.iter().copied().collect();
        // The small ones have lost their orthogonality to the square root of the machine's rounding.
        for _ in 0..2 {
            for other in before {
                let along = dot(&other.shape, &mode);
                mode.iter_mut().zip(&other.shape).for_each(|(x, o)| *x -= along * o);
            }
        }
        let top = mode.iter().copied().fold(0.0, |top: f64, x| if x.abs() > top.abs() { x } else { top });
        let size = dot(&mode, &mode).sqrt();
        mode.iter_mut().for_each(|x| *x *= top.signum() / size);
        (size > 0.0).then_some(mode)
    }
}

/// As many modes as take the fewest bytes. `left` is what they have to make up.
fn choose(mut left: Vec<Vec<f32>>, rows: usize, bound: DisplacementBound) -> Option<Vec<Mode>> {
    let snapshots = Snapshots::of(&left)?;
    let bound = DisplacementBound { rms_m: MARGIN * bound.rms_m, max_m: MARGIN * bound.max_m };
    let length = left.first().map_or(0, Vec::len);
    let (a_mode, an_outlier) = (2 * length + 2 * rows + 4, 2 * length + 8);
    let mut modes = Vec::new();
    let (mut best, mut fewest) = (0, usize::MAX);
    while let Some(shape) = snapshots.next(&modes) {
        let (mut range, mut outliers) = (0.0f64, 0);
        for left in &mut left {
            let along: f64 = left.iter().zip(&shape).map(|(u, m)| f64::from(*u) * m).sum();
            left.iter_mut().zip(&shape).for_each(|(u, m)| *u = (f64::from(*u) - along * m) as f32);
            range = range.max(along.abs());
            outliers += usize::from(!bound.holds(Misfit::of(left)));
        }
        modes.push(Mode { shape, range });
        let bytes = modes.len() * a_mode + outliers * an_outlier;
        if bytes < fewest {
            (best, fewest) = (modes.len(), bytes);
        }
        if outliers == 0 || (modes.len() + 1) * a_mode >= fewest {
            break;
        }
    }
    modes.truncate(best);
    if modes.is_empty() {
        // Nothing moves; a table has a mode nevertheless.
        modes.push(Mode { shape: vec![1.0; length], range: 0.0 });
    }
    Some(modes)
}

/// What the modes miss of a configuration.
struct Outlier {
    scale: f32,
    numbers: Vec<i16>,
}

impl Outlier {
    fn pack(left: &[f64]) -> Self {
        let top = left.iter().fold(0.0, |top: f64, x| top.max(x.abs()));
        let scale = (top / UNITS).max(f64::from(f32::MIN_POSITIVE)) as f32;
        let number = |x: &f64| (x / f64::from(scale)).round().clamp(-UNITS, UNITS) as i16;
        Self { scale, numbers: left.iter().map(number).collect() }
    }

    fn left(&self, left: &[f64]) -> Vec<f64> {
        left.iter().zip(&self.numbers).map(|(x, &n)| x - f64::from(n) * f64::from(self.scale)).collect()
    }
}

/// Coefficients of a configuration and their slopes per cell.
#[derive(Debug, Clone)]
struct Row {
    values: Vec<f64>,
    slopes: [Vec<f64>; 3],
}

impl Row {
    /// Mean of the straight continuations of the nearest solved configurations.
    fn ghost(solved: &[GridIndex], rows: &[Self], index: GridIndex) -> Self {
        let distance =
            |from: &GridIndex| -> i32 { from.iter().zip(index).map(|(a, b)| (a - b) * (a - b)).sum() };
        let nearest = solved.iter().map(distance).min().unwrap_or(0);
        let modes = rows.first().map_or(0, |row| row.values.len());
        let mut mean = Self { values: vec![0.0; modes], slopes: std::array::from_fn(|_| vec![0.0; modes]) };
        let count = solved.iter().filter(|from| distance(from) == nearest).count().max(1) as f64;
        for (from, row) in solved.iter().zip(rows).filter(|(from, _)| distance(from) == nearest) {
            mean.values.iter_mut().zip(&row.values).for_each(|(sum, value)| *sum += value / count);
            for axis in 0..3 {
                let step = f64::from(index[axis] - from[axis]);
                let slopes = &row.slopes[axis];
                mean.values.iter_mut().zip(slopes).for_each(|(sum, slope)| *sum += step * slope / count);
                mean.slopes[axis].iter_mut().zip(slopes).for_each(|(sum, slope)| *sum += slope / count);
            }
        }
        mean
    }

    fn pack_into(&self, slopes: usize, coefficients: &mut Vec<i16>) {
        pack_whole(&self.values, coefficients);
        for slope in &self.slopes {
            pack_whole(&slope[..slopes], coefficients);
        }
    }
}

/// Rounds to int16. Where one number would not fit all are made smaller by the same factor: a slope that rises by more than its mode's
/// whole range in a cell stands at a fold, and a ghost that far away is never the only corner of a query.
fn pack_whole(numbers: &[f64], packed: &mut Vec<i16>) {
    let top = numbers.iter().fold(0.0, |top: f64, x| top.max(x.abs()));
    let factor = if top > UNITS { UNITS / top } else { 1.0 };
    packed.extend(numbers.iter().map(|x| (factor * x).round() as i16));
}

/// How many leading modes are to have slopes.
fn slopes_worth(
    grid: &SpaceGrid,
    solved: &[GridIndex],
    folds: &[Fold],
    modes: &PackedModes,
    rows: &[Row],
    bound: DisplacementBound,
) -> usize {
    let cuts: HashSet<(GridIndex, GridIndex)> =
        folds.iter().flat_map(|fold| [(fold.from, fold.to), (fold.to, fold.from)]).collect();
    let mut edges: Vec<(usize, usize, usize)> = Vec::new();
    for (at, index) in solved.iter().enumerate().filter(|(_, index)| grid.lattice.slot(**index).is_some()) {
        for axis in 0..3 {
            let mut other = *index;
            other[axis] += 1;
            if let Ok(next) = solved.binary_search(&other)
                && !cuts.contains(&(*index, other))
            {
                edges.push((at, next, axis));
            }
        }
    }
    let length = modes.unpacked.first().map_or(0, Vec::len);
    let count = edges.len().min(EDGES);
    let mut needed: Vec<usize> = (0..count)
        .map(|n| {
            let (a, b, axis) = edges[n * edges.len() / count];
            let mut error = vec![0.0; length];
            // From the last mode to the first, until their errors together are too large.
            let too_many = (0..modes.scale.len()).rev().find(|&k| {
                let factor = (rows[a].slopes[axis][k] - rows[b].slopes[axis][k]) / 8.0;
                error.iter_mut().zip(&modes.unpacked[k]).for_each(|(sum, m)| *sum += factor * m);
                !bound.holds(Misfit::of(&error))
            });
            too_many.map_or(0, |k| k + 1)
        })
        .collect();
    needed.sort_unstable();
    let place = (EDGES_WITHIN * count as f64).ceil() as usize;
    needed.get(place.max(1) - 1).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests;
