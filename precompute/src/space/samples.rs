//! Solved configurations as input of the fits.

use palpate_core::ConfigTag;

use super::record::Record;
use crate::fit::{self, Fold, Sample};
use crate::spec::SpaceGrid;

/// The solved points among `records`, sorted by grid index.
pub fn samples(grid: &SpaceGrid, records: &[Record]) -> Vec<Sample> {
    let mut samples: Vec<Sample> = records
        .iter()
        .filter(|r| r.tag.is_solved() && grid.lattice.slot(r.index).is_some())
        .map(|r| Sample {
            index: r.index,
            attempt: r.attempt,
            jet: r.jet_for_fit(grid.displacement_m(r.index)),
            terminating: r.tag == ConfigTag::Terminating,
            inverted: r.inverted > 0,
        })
        .collect();
    samples.sort_unstable_by_key(|s| s.index);
    samples
}

/// The branch jumps between solutions of a space, across which tables must not interpolate.
pub fn folds(grid: &SpaceGrid, records: &[Record]) -> Vec<Fold> {
    let solved = records.iter().filter(|r| r.tag.is_solved());
    fit::folds(&solved.map(|r| (r.index, r.jet(grid.displacement_m(r.index)))).collect::<Vec<_>>())
}
