//! Lattice tables with ghosts: every slot of the box has a force, so that the interpolated force is
//! continuous.
//!
//! A slot without a configuration (outside the ball, beyond a terminating point, or failed) gets the mean of
//! the first-order extrapolations h + S d of its nearest solved points. Flags mark the solved slots. The core
//! reports a query that uses a ghost as extrapolated.

use palpate_core::{CORNERS, flags};

use super::Sample;
use super::branch_jump::BranchJump;
use crate::num::vector::norm;
use crate::spec::{GridIndex, SpaceGrid};

/// Force and flags of every slot of the box.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeValues {
    /// h of every slot, N.
    pub force_n: Vec<[f32; 3]>,
    /// Flags of `palpate_core::flags`.
    pub flags: Vec<u8>,
}

/// Limit of a ghost's force as a multiple of the largest solved force, because an extrapolation over many
/// cells can diverge.
pub(super) const GHOST_FORCE_LIMIT: f64 = 2.0;

/// Flags of every slot of the box for `samples` (one per solved grid point, including the rest point), with the
/// branch-jump flag in every cell that has a flagged pair among its corners.
pub(crate) fn lattice_flags(grid: &SpaceGrid, samples: &[Sample], branch_jumps: &[BranchJump]) -> Vec<u8> {
    let mut found = vec![0; grid.lattice.slots()];
    for sample in samples {
        let Some(slot) = grid.lattice.slot(sample.index) else { continue };
        found[slot] = flags::SOLVED;
        if sample.terminating {
            found[slot] |= flags::TERMINATING;
        }
        if sample.inverted {
            found[slot] |= flags::INVERTED;
        }
    }
    for slot in branch_jumps.iter().flat_map(cells_with_jumps).filter_map(|cell| grid.lattice.slot(cell)) {
        found[slot] |= flags::BRANCH_JUMP;
    }
    flags::derive(&grid.lattice, &mut found);
    found
}

/// Table of `samples`, one per solved grid point, including the rest point.
pub fn lattice_values(grid: &SpaceGrid, samples: &[Sample], branch_jumps: &[BranchJump]) -> LatticeValues {
    let largest = samples.iter().map(|s| norm(s.jet.force_n)).fold(0.0, f64::max);
    let mut solved = vec![None; grid.lattice.slots()];
    for sample in samples {
        if let Some(slot) = grid.lattice.slot(sample.index) {
            solved[slot] = Some(sample.jet.force_n);
        }
    }
    let force = |(slot, solved): (usize, Option<[f64; 3]>)| {
        let ghost = || ghost(grid, samples, grid.lattice.ijk(slot), GHOST_FORCE_LIMIT * largest);
        solved.unwrap_or_else(ghost).map(|component| component as f32)
    };
    let force_n = solved.into_iter().enumerate().map(force).collect();
    LatticeValues { force_n, flags: lattice_flags(grid, samples, branch_jumps) }
}

/// The cells with both ends of a flagged pair among their corners, including the lower cell on axes where the
/// ends have the same index.
pub(super) fn cells_with_jumps(jump: &BranchJump) -> impl Iterator<Item = GridIndex> {
    let (from, to) = (jump.from, jump.to);
    CORNERS
        .into_iter()
        .filter(move |shift| (0..3).all(|axis| shift[axis] == 0 || from[axis] == to[axis]))
        .map(move |shift| std::array::from_fn(|axis| from[axis].min(to[axis]) - shift[axis]))
}

/// Mean of the linear extrapolations of the nearest solved points, limited to `limit`.
fn ghost(grid: &SpaceGrid, samples: &[Sample], index: GridIndex, limit: f64) -> [f64; 3] {
    let mut mean = [0.0; 3];
    let solved = samples.iter().map(|sample| (sample.index, sample));
    mean_of_nearest(solved, index, &mut mean, |sample, step, sum| {
        for (i, total) in sum.iter_mut().enumerate() {
            let change: f64 =
                (0..3).map(|j| sample.jet.stiffness_n_m[(i, j)] * (step[j] * grid.spacing_m)).sum();
            *total += sample.jet.force_n[i] + change;
        }
    });
    let size = norm(mean);
    if size > limit { mean.map(|f| f * limit / size) } else { mean }
}

/// The ghost of every table: sets `mean` to the mean of the continuations of the solved points nearest to
/// `index`. `add` adds the continuation of a point by a step in cells.
pub(super) fn mean_of_nearest<T>(
    solved: impl Iterator<Item = (GridIndex, T)> + Clone,
    index: GridIndex,
    mean: &mut [f64],
    add: impl Fn(T, [f64; 3], &mut [f64]),
) {
    let squared = |from: GridIndex| -> i32 { from.iter().zip(index).map(|(a, b)| (a - b) * (a - b)).sum() };
    let nearest = solved.clone().map(|(from, _)| squared(from)).min();
    let mut count = 0;
    for (from, point) in solved.filter(|(from, _)| Some(squared(*from)) == nearest) {
        add(point, std::array::from_fn(|axis| f64::from(index[axis] - from[axis])), mean);
        count += 1;
    }
    mean.iter_mut().for_each(|sum| *sum /= f64::from(count.max(1)));
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::num::jet::EnergyJet;

    /// A linear field: every extrapolation is exact, so every ghost must be exact too.
    fn linear(index: GridIndex, spacing: f64) -> Sample {
        let s = [[300.0, 20.0, 0.0], [20.0, 200.0, -10.0], [0.0, -10.0, 100.0]];
        let d = index.map(|n| f64::from(n) * spacing);
        Sample {
            index,
            attempt: 0,
            jet: EnergyJet {
                control_m: d,
                energy_j: 0.0,
                force_n: std::array::from_fn(|i| s[i].iter().zip(d).map(|(s, d)| s * d).sum()),
                stiffness_n_m: Matrix3::from_fn(|i, j| s[i][j]),
                third_n_m2: [0.0; 10],
            },
            derivatives: None,
            terminating: false,
            inverted: false,
        }
    }

    #[test]
    fn ghosts_continue_a_linear_field_exactly() {
        let grid = SpaceGrid::new(0.01, 0.03).unwrap();
        let holes = [[1, 0, 0], [0, -2, 1]];
        let samples: Vec<Sample> = grid
            .lattice
            .points()
            .chain([[0; 3]])
            .filter(|p| !holes.contains(p))
            .map(|p| linear(p, grid.spacing_m))
            .collect();
        let values = lattice_values(&grid, &samples, &[]);
        for hole in holes.into_iter().chain([[4, 0, 0], [-3, 2, 0]]) {
            let slot = grid.lattice.slot(hole).unwrap();
            assert_eq!(values.flags[slot] & flags::SOLVED, 0);
            let want = linear(hole, grid.spacing_m).jet.force_n;
            for (found, want) in values.force_n[slot].into_iter().zip(want) {
                assert!((f64::from(found) - want).abs() < 1e-5, "{hole:?}");
            }
        }
        // A corner of the box is far from all data: its force has the limit's magnitude and the extrapolated
        // direction.
        let slot = grid.lattice.slot([4, 4, 4]).unwrap();
        let force: f64 = norm(values.force_n[slot].map(f64::from));
        let largest = samples.iter().map(|s| norm(s.jet.force_n)).fold(0.0, f64::max);
        assert!(force <= GHOST_FORCE_LIMIT * largest * (1.0 + 1e-6));
    }
}
