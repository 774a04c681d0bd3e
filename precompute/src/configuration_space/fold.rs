//! Fold flags: neighbours that do not lie on one smooth branch.
//!
//! Along the edge d from a to b, with W, h = dW/dd and S = dh/dd at both ends, the quintic through the data of W and the cubic
//! through those of h leave
//!
//! rho   = |W_b - W_a - (h_a + h_b).d/2 + d.(S_b - S_a).d/12| / |d|,
//!
//! rho_h = |h_b - h_a - (S_a + S_b) d/2|,
//!
//! both of higher order in |d| on a smooth branch and of the order of the jump across a fold, a change of branch or a wrong
//! solution. rho is blind to a jump of h at mid-edge, where its energy cancels; rho_h sees it. Source: INTERPOLATION
//! study; no counterpart in the paper.

use nalgebra::Vector3;

use super::domain::neighbours;
use super::{GridIndex, Record, SpaceGrid};

/// Excess over the smooth law beyond which a pair is flagged, N ...
pub const LEAST_N: f64 = 0.1;
/// ... and as a share of the larger |h| of the two. A jump smaller than the just noticeable difference of force, some 7 %,
/// is none for the hand.
pub const SHARE: f64 = 0.1;

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

/// (rho, rho_h) of the pair `a`, `b`, N.
pub fn excess(grid: &SpaceGrid, a: &Record, b: &Record) -> (f64, f64) {
    let d = Vector3::from(grid.displacement_m(b.index)) - Vector3::from(grid.displacement_m(a.index));
    let (ha, hb) = (Vector3::from(a.force_n), Vector3::from(b.force_n));
    let bend = d.dot(&((b.stiffness_n_m - a.stiffness_n_m) * d));
    let rho = (b.energy_j - a.energy_j - 0.5 * (ha + hb).dot(&d) + bend / 12.0).abs() / d.norm();
    let rho_h = (hb - ha - (a.stiffness_n_m + b.stiffness_n_m) * d * 0.5).norm();
    (rho, rho_h)
}

/// Whether an excess marks a fold, for a pair with these forces.
fn is_fold((rho, rho_h): (f64, f64), a: &Record, b: &Record) -> bool {
    let limit = LEAST_N.max(SHARE * a.force_norm_n().max(b.force_norm_n()));
    // A NaN is no smooth branch either.
    !(rho <= limit && rho_h <= limit)
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
            let both = excess(grid, a, b);
            if is_fold(both, a, b) {
                folds.push(Fold { from: a.index, to: b.index, rho_n: both.0, rho_h_n: both.1 });
            }
        }
    }
    folds
}

/// [`flagged_pairs`] of the records of one space.
pub fn folds(grid: &SpaceGrid, records: &[Record]) -> Vec<Fold> {
    let by_index: std::collections::HashMap<GridIndex, &Record> =
        records.iter().map(|r| (r.index, r)).collect();
    flagged_pairs(grid, records.iter(), |index| by_index.get(&index).copied())
}
