//! Fold flags: neighbours that do not lie on one smooth branch, by the measure of [`crate::solve::branch`].

use super::domain::neighbours;
use super::{GridIndex, Record, SpaceGrid};
use crate::solve::{Excess, Potential};

/// A flagged pair of neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fold {
    /// One end.
    pub from: GridIndex,
    /// The other.
    pub to: GridIndex,
    /// Excess of the energy over its quintic, by length, N.
    pub rho_n: f64,
    /// Excess of the force over its trapezium, N.
    pub rho_h_n: f64,
}

/// The excess of the pair `a`, `b`.
pub fn excess(grid: &SpaceGrid, a: &Record, b: &Record) -> Excess {
    Excess::between(&potential(grid, a), &potential(grid, b))
}

fn potential(grid: &SpaceGrid, record: &Record) -> Potential {
    Potential {
        displacement_m: grid.displacement_m(record.index),
        energy_j: record.energy_j,
        force_n: record.force_n,
        stiffness_n_m: record.stiffness_n_m,
    }
}

/// Flagged pairs among the solved neighbours of a space, every pair once; `at` gives the kept record of a point.
pub fn flagged_pairs<'r>(
    grid: &SpaceGrid,
    points: impl Iterator<Item = &'r Record>,
    at: impl Fn(GridIndex) -> Option<&'r Record>,
) -> Vec<Fold> {
    let mut folds = Vec::new();
    for a in points.filter(|r| r.tag.is_solved()) {
        // Half of the 26 offsets, so that every pair comes once.
        for offset in neighbours().filter(|offset| *offset > [0; 3]) {
            let Some(b) = at(super::domain::plus(a.index, offset)).filter(|b| b.tag.is_solved()) else {
                continue;
            };
            let excess = excess(grid, a, b);
            if excess.is_jump() {
                let Excess { rho_n, rho_h_n, .. } = excess;
                folds.push(Fold { from: a.index, to: b.index, rho_n, rho_h_n });
            }
        }
    }
    folds
}

/// The folds that tables must not smooth over: [`flagged_pairs`] of the records of one space, without those whose third derivatives
/// show that the branch between them is only strongly curved.
pub fn folds(grid: &SpaceGrid, records: &[Record]) -> Vec<Fold> {
    let by_index: std::collections::HashMap<GridIndex, &Record> =
        records.iter().map(|r| (r.index, r)).collect();
    let at = |index| by_index.get(&index).copied();
    let mut folds = flagged_pairs(grid, records.iter(), at);
    folds.retain(|fold| {
        let (Some(a), Some(b)) = (at(fold.from), at(fold.to)) else { return true };
        let ends = [a, b].map(|r| potential(grid, r));
        Excess::with_thirds((&ends[0], &a.third_n_m2), (&ends[1], &b.third_n_m2)).is_jump()
    });
    folds
}
