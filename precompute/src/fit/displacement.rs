//! Surface displacements in the core's form: a few modes in int16, within the scene's bound at every
//! configuration.
//!
//! 1. **Modes** by the method of snapshots: eigenvectors of the Gram matrix of evenly chosen configurations,
//!    in f64, largest first (proper orthogonal decomposition; no mean is subtracted, so that rest is exactly
//!    zero).
//! 2. **Their number** minimises the number of bytes; a configuration beyond the bound costs a surface of its
//!    own.
//! 3. **Packing**: first the modes, then each configuration's coefficients. The coefficients are computed one
//!    after the other against the packed modes, so that each corrects the rounding error of the previous
//!    ones. A configuration that still exceeds the bound becomes an outlier: its remainder is stored too,
//!    with its own scale.
//! 4. **Slopes**: half-way between neighbours a and b the error of tri-linear interpolation is (u'_a - u'_b)
//!    / 8, with derivatives per cell, to third order. The leading modes get slopes, as many as are needed to
//!    keep this error within the bound on 95 % of the grid's edges.
//!
//! A corner without a configuration is the linear extrapolation of its nearest solved neighbours, so that the
//! active node follows the tool.

use std::collections::HashSet;

use faer::{Mat, Side};

use super::branch_jump::BranchJump;
use super::ghosts::mean_of_nearest;
use super::modes::{Mode, PackedModes, UNITS};
use crate::num::vector::inner;
use crate::spec::{DisplacementBound, Domain, GridIndex, SpaceGrid};

impl DisplacementBound {
    /// Whether the difference of two surfaces is within the bound.
    pub(crate) fn allows(&self, found: &SurfaceMotionSample, truth: &SurfaceMotionSample) -> bool {
        let pairs = found.displacement_m.iter().zip(&truth.displacement_m);
        self.holds(Misfit::of(&pairs.map(|(a, b)| a - b).collect::<Vec<f32>>()))
    }

    fn holds(&self, misfit: Misfit) -> bool {
        misfit.rms_m <= self.rms_m && misfit.max_m <= self.max_m
    }
}

/// Difference of two displacements of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Misfit {
    /// Root mean square over the nodes, m.
    pub(crate) rms_m: f64,
    /// Maximum over the nodes, m.
    pub(crate) max_m: f64,
}

impl Misfit {
    /// Norms of the differences, given as x, y, z of each node, m.
    pub(crate) fn of<T: Copy + Into<f64>>(differences: &[T]) -> Self {
        let (mut sum, mut largest) = (0.0, 0.0f64);
        let nodes = differences.as_chunks::<3>().0;
        for node in nodes {
            let squared: f64 = node.iter().map(|&x| x.into() * x.into()).sum();
            sum += squared;
            largest = largest.max(squared);
        }
        Self { rms_m: (sum / nodes.len().max(1) as f64).sqrt(), max_m: largest.sqrt() }
    }
}

/// A solved configuration: x, y, z of every surface node.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SurfaceMotionSample {
    /// Displacement from rest, m.
    pub displacement_m: Vec<f32>,
    /// Derivatives with respect to the x, y and z displacement of the active node.
    pub slopes: [Vec<f32>; 3],
}

/// The planes of the core's table.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct DisplacementFit {
    /// Row of every slot of the box, as in [`super::HermiteNodes`].
    pub row: Vec<u32>,
    /// Packed modes.
    pub modes: Vec<i16>,
    /// Scales of the modes.
    pub scale: Vec<f32>,
    /// Number of modes with slopes.
    pub slopes: usize,
    /// Rows of packed coefficients.
    pub coefficients: Vec<i16>,
    /// Rows that are outliers.
    pub outlier_row: Vec<u32>,
    /// Scales of the outliers.
    pub outlier_scale: Vec<f32>,
    /// Remainders of the outliers.
    pub outliers: Vec<i16>,
}

/// Why the fit failed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum DisplacementFault<E> {
    /// A configuration could not be read.
    Read(E),
    /// The modes cannot be computed.
    Modes,
    /// A configuration cannot be packed within the bound.
    Bound {
        /// The configuration.
        index: GridIndex,
        /// The remaining misfit.
        misfit: Misfit,
    },
}

/// Maximum number of configurations for the modes.
const SNAPSHOTS: usize = 1024;
/// Maximum number of grid edges in the decision about slopes.
const EDGES: usize = 2000;
/// Share of the edges that must be within the bound.
const EDGES_WITHIN: f64 = 0.95;
/// The number of modes is chosen for this share of the bound; the rest covers rounding.
const MARGIN: f64 = 0.98;

/// Fits the table of the configurations at `solved` (sorted, including rest), which `read` returns. Each is
/// read twice, because the configurations of a large organ with their slopes exceed the memory.
pub(crate) fn fit_displacement<E>(
    grid: &SpaceGrid,
    solved: &[GridIndex],
    branch_jumps: &[BranchJump],
    bound: DisplacementBound,
    mut read: impl FnMut(usize) -> Result<SurfaceMotionSample, E>,
) -> Result<DisplacementFit, DisplacementFault<E>> {
    let mut fetch = |at: usize| read(at).map_err(DisplacementFault::Read);
    let mut all: Vec<Vec<f32>> = Vec::with_capacity(solved.len());
    for at in 0..solved.len() {
        all.push(fetch(at)?.displacement_m);
    }
    let domain = Domain::new(grid, true);
    let modes = PackedModes::pack(&choose(all, domain.count(), bound).ok_or(DisplacementFault::Modes)?);

    let mut fit = DisplacementFit { scale: modes.scale.clone(), ..DisplacementFit::default() };
    let mut rows = Vec::with_capacity(solved.len());
    let mut outliers = Vec::new();
    for (at, &index) in solved.iter().enumerate() {
        let SurfaceMotionSample { displacement_m, slopes } = fetch(at)?;
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
        let slopes = slopes.map(|slope| modes.project(&slope, grid.spacing_m));
        rows.push(Row { values: values.iter().map(|&n| f64::from(n)).collect(), slopes });
    }
    fit.slopes = slopes_worth(grid, solved, branch_jumps, &modes, &rows, bound);
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

/// Decomposition of evenly chosen displacements.
struct Snapshots {
    /// One displacement per column.
    displacements: Mat<f64>,
    /// Eigenvalues and eigenvectors of the Gram matrix, in ascending order.
    values: Vec<f64>,
    vectors: Mat<f64>,
}

impl Snapshots {
    /// Decomposes the displacements; `None` if it fails.
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

    /// The next mode: orthonormal to the previous ones, with a positive largest component. `None` at the
    /// rounding level.
    fn next(&self, before: &[Mode]) -> Option<Vec<f64>> {
        let n = self.values.len().checked_sub(before.len() + 1)?;
        if self.values[n] <= 1e-14 * self.values.last()? {
            return None;
        }
        let mode = &self.displacements * self.vectors.col(n);
        let mut mode: Vec<f64> = mode.iter().copied().collect();
        // Modes of small eigenvalues have lost their orthogonality to the square root of the rounding error.
        for _ in 0..2 {
            for other in before {
                let along = inner(&other.shape, &mode);
                mode.iter_mut().zip(&other.shape).for_each(|(x, o)| *x -= along * o);
            }
        }
        let top = mode.iter().copied().fold(0.0, |top: f64, x| if x.abs() > top.abs() { x } else { top });
        let size = inner(&mode, &mode).sqrt();
        mode.iter_mut().for_each(|x| *x *= top.signum() / size);
        (size > 0.0).then_some(mode)
    }
}

/// The number of modes with the fewest bytes; `left` contains the remainders.
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
        // Without any motion the table still needs one mode.
        modes.push(Mode { shape: vec![1.0; length], range: 0.0 });
    }
    Some(modes)
}

/// Remainder of a configuration without the modes.
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
    /// Mean of the linear extrapolations of the nearest solved configurations.
    fn ghost(solved: &[GridIndex], rows: &[Self], index: GridIndex) -> Self {
        let modes = rows.first().map_or(0, |row| row.values.len());
        let mut mean = vec![0.0; 4 * modes];
        let solved = solved.iter().copied().zip(rows);
        mean_of_nearest(solved, index, &mut mean, |row, step, sum| {
            let add = |sum: &mut [f64], factor: f64, numbers: &[f64]| {
                sum.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += factor * number);
            };
            add(sum, 1.0, &row.values);
            for (axis, slopes) in row.slopes.iter().enumerate() {
                add(sum, step[axis], slopes);
                add(&mut sum[(axis + 1) * modes..], 1.0, slopes);
            }
        });
        let part = |n: usize| mean[n * modes..(n + 1) * modes].to_vec();
        Self { values: part(0), slopes: [part(1), part(2), part(3)] }
    }

    fn pack_into(&self, slopes: usize, coefficients: &mut Vec<i16>) {
        pack_whole(&self.values, coefficients);
        for slope in &self.slopes {
            pack_whole(&slope[..slopes], coefficients);
        }
    }
}

/// Rounds to int16. If a number exceeds the range, all are scaled by the same factor. A slope can change by
/// more than its mode's range within a cell only at a branch jump, or at a ghost far from the data.
fn pack_whole(numbers: &[f64], packed: &mut Vec<i16>) {
    let top = numbers.iter().fold(0.0, |top: f64, x| top.max(x.abs()));
    let factor = if top > UNITS { UNITS / top } else { 1.0 };
    packed.extend(numbers.iter().map(|x| (factor * x).round() as i16));
}

/// Number of leading modes that need slopes.
fn slopes_worth(
    grid: &SpaceGrid,
    solved: &[GridIndex],
    branch_jumps: &[BranchJump],
    modes: &PackedModes,
    rows: &[Row],
    bound: DisplacementBound,
) -> usize {
    let cuts: HashSet<(GridIndex, GridIndex)> =
        branch_jumps.iter().flat_map(|jump| [(jump.from, jump.to), (jump.to, jump.from)]).collect();
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
            // From the last mode to the first, until the sum of their errors exceeds the bound.
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
