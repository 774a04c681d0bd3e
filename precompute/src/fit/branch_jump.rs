//! Branch jumps: neighbouring points on different branches, by the test of [`crate::num::branch`].

use crate::num::branch::Excess;
use crate::num::jet::EnergyJet;
use crate::spec::{GridIndex, neighbours, plus};

/// A flagged pair of neighbouring points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchJump {
    /// First point.
    pub from: GridIndex,
    /// Second point.
    pub to: GridIndex,
    /// Residual rho of the energy, divided by the distance, N.
    pub rho_n: f64,
    /// Residual rho_h of the force, N.
    pub rho_h_n: f64,
}

/// Flagged pairs among the solved neighbours of a space, each pair once. `at` returns the solution used at a
/// point.
pub(crate) fn flagged_pairs(
    points: impl Iterator<Item = (GridIndex, EnergyJet)>,
    at: impl Fn(GridIndex) -> Option<EnergyJet>,
) -> Vec<BranchJump> {
    let mut branch_jumps = Vec::new();
    for (from, a) in points {
        // Half of the 26 offsets, so that each pair occurs once.
        for offset in neighbours().filter(|offset| *offset > [0; 3]) {
            let to = plus(from, offset);
            let Some(b) = at(to) else { continue };
            let excess = Excess::between(&a, &b);
            if excess.is_jump() {
                let Excess { rho_n, rho_h_n, .. } = excess;
                branch_jumps.push(BranchJump { from, to, rho_n, rho_h_n });
            }
        }
    }
    branch_jumps
}

/// The branch jumps at which tables must not be smooth: [`flagged_pairs`] of one space, without the pairs
/// whose third derivatives show a strongly curved but continuous branch.
pub(crate) fn branch_jumps(solved: &[(GridIndex, EnergyJet)]) -> Vec<BranchJump> {
    let by_index: std::collections::HashMap<GridIndex, EnergyJet> = solved.iter().copied().collect();
    let mut branch_jumps = flagged_pairs(solved.iter().copied(), |index| by_index.get(&index).copied());
    branch_jumps.retain(|jump| Excess::with_thirds(&by_index[&jump.from], &by_index[&jump.to]).is_jump());
    branch_jumps
}
