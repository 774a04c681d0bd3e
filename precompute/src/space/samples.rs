//! Solved configurations as input of the fits.

use super::record::Record;
use crate::fit::{self, BranchJump, Sample};
use crate::spec::{Quantity, SpaceGrid};

/// The solved points among `records`, sorted by grid index.
pub(crate) fn samples(grid: &SpaceGrid, records: &[Record]) -> Vec<Sample> {
    let mut samples: Vec<Sample> = records
        .iter()
        .filter(|r| grid.lattice.slot(r.index).is_some())
        .filter_map(|r| {
            let at = r.equilibrium()?;
            Some(Sample {
                index: r.index,
                attempt: r.attempt,
                jet: r.jet_for_fit(grid.displacement_m(r.index), Quantity::Energy)?,
                derivatives: None,
                terminating: at.terminating,
                inverted: at.inverted > 0,
            })
        })
        .collect();
    samples.sort_unstable_by_key(|s| s.index);
    samples
}

/// The branch jumps between solutions of a space, across which tables must not interpolate.
pub fn branch_jumps(grid: &SpaceGrid, records: &[Record]) -> Vec<BranchJump> {
    let solved = records.iter().filter_map(|r| Some((r.index, r.jet(grid.displacement_m(r.index))?)));
    fit::branch_jumps(&solved.collect::<Vec<_>>())
}
