//! Fold flags: neighbours that do not lie on one smooth branch, by the measure of [`crate::num::branch`].

use crate::num::branch::Excess;
use crate::num::jet::EnergyJet;
use crate::spec::{GridIndex, neighbours, plus};

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

/// Flagged pairs among the solved neighbours of a space, every pair once; `at` gives the solution that counts at a point.
pub fn flagged_pairs(
    points: impl Iterator<Item = (GridIndex, EnergyJet)>,
    at: impl Fn(GridIndex) -> Option<EnergyJet>,
) -> Vec<Fold> {
    let mut folds = Vec::new();
    for (from, a) in points {
        // Half of the 26 offsets, so that every pair comes once.
        for offset in neighbours().filter(|offset| *offset > [0; 3]) {
            let to = plus(from, offset);
            let Some(b) = at(to) else { continue };
            let excess = Excess::between(&a, &b);
            if excess.is_jump() {
                let Excess { rho_n, rho_h_n, .. } = excess;
                folds.push(Fold { from, to, rho_n, rho_h_n });
            }
        }
    }
    folds
}

/// The folds that tables must not smooth over: [`flagged_pairs`] of one space, without those whose third derivatives show that the
/// branch between them is only strongly curved.
pub fn folds(solved: &[(GridIndex, EnergyJet)]) -> Vec<Fold> {
    let by_index: std::collections::HashMap<GridIndex, EnergyJet> = solved.iter().copied().collect();
    let at = |index| by_index.get(&index).copied();
    let mut folds = flagged_pairs(solved.iter().copied(), at);
    folds.retain(|fold| {
        let (Some(a), Some(b)) = (at(fold.from), at(fold.to)) else { return true };
        Excess::with_thirds(&a, &b).is_jump()
    });
    folds
}
